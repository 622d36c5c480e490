"""A page as a browser's parser would see it: elements with their attributes and text, in order."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser

VOID = {"br", "col", "hr", "img", "input", "link", "meta"}


@dataclass
class Element:
    tag: str
    attributes: dict[str, str]
    children: list[Element | str] = field(default_factory=list)

    @property
    def text(self):
        return "".join(child if isinstance(child, str) else child.text for child in self.children)

    @property
    def classes(self):
        return self.attributes.get("class", "").split()

    def all(self, tag="", **wanted):
        """Elements below this one with a tag and with attributes; `class_` is one of the classes."""
        results = []
        for child in self.children:
            if isinstance(child, str):
                continue
            if child._is(tag, wanted):
                results.append(child)
            results += child.all(tag, **wanted)
        return results

    def _is(self, tag, wanted):
        known = {**self.attributes, "class_": ""}
        classes = wanted.get("class_")
        return (
            (not tag or self.tag == tag)
            and (classes is None or classes in self.classes)
            and all(known.get(name) == value for name, value in wanted.items() if name != "class_")
        )


class _Builder(HTMLParser):
    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.root = Element("", {})
        self.open = [self.root]

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), f"an attribute twice in {tag}: {names}"
        made = Element(tag, {name: value or "" for name, value in attrs})
        self.open[-1].children.append(made)
        if tag not in VOID:
            self.open.append(made)

    def handle_endtag(self, tag):
        closed = self.open.pop()
        assert closed.tag == tag, f"{closed.tag} is closed by {tag}"

    def handle_data(self, data):
        self.open[-1].children.append(data)


def parsed(page):
    """Root of a page, every element of which is closed in order."""
    builder = _Builder()
    builder.feed(page)
    builder.close()
    assert builder.open == [builder.root]
    return builder.root


def numbers_in(text):
    """Numbers of a text, each with half a unit of its last digit."""
    results = []
    for mantissa, exponent in re.findall(r"(?<![\w.])([-−]?\d+(?:\.\d+)?)(?:e([-−]?\d+))?(?!\w)", text):
        power = int(exponent.replace("−", "-") or 0)
        whole, point, decimals = mantissa.partition(".")
        digits = len(decimals) if point else len(whole.rstrip("0")) - len(whole)
        results.append((float(mantissa.replace("−", "-")) * 10.0**power, 0.5 * 10.0 ** (power - digits)))
    return results
