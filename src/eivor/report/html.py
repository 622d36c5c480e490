"""HTML: escaped markup, parts of documents, the shell of a page and vendored scripts."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources

from eivor.inference.verdict import Status
from eivor.report.document import (
    Bullets,
    Cell,
    Fact,
    Facts,
    Figure,
    Part,
    Section,
    Statement,
    TableColumn,
    TableOf,
    printable,
)

# -- Markup --

#: Elements without an end.
VOID = frozenset({"br", "col", "hr", "link", "meta"})


@dataclass(frozen=True, slots=True)
class Markup:
    """A piece of HTML."""

    html: str


#: What goes into an element: HTML, or text that is escaped.
Content = Markup | str


def element(name: str, attributes: Mapping[str, str] | None = None, *content: Content) -> Markup:
    """Element with its attributes and what is in it."""
    reported = "".join(f' {key}="{escaped(value)}"' for key, value in (attributes or {}).items())
    if name in VOID:
        return Markup(f"<{name}{reported}>")
    return Markup(f"<{name}{reported}>{joined(content).html}</{name}>")


def joined(content: Iterable[Content]) -> Markup:
    """Pieces, one after the other."""
    return Markup("".join(item.html if isinstance(item, Markup) else escaped(item) for item in content))


def escaped(text: str) -> str:
    """Text as HTML source: what a browser would act on is escaped, what it would not show is made visible."""
    return html.escape(printable(text), quote=True)


# -- Parts --

#: A shape for each verdict, drawn in a square of 20: colour is never alone.
SHAPES = {
    Status.IDENTIFIED: "M4.5 10.5l3.6 3.8 7.4-8.6",
    Status.WEAK: "M5 11.5c2-3.2 3.6-3.2 5-1.2s3 2 5-1.2",
    Status.PROVISIONAL: "M10 5.2v5.4M10 14.2v.8",
    Status.REFUSED: "M6 6l8 8M14 6l-8 8",
}
#: Numbers with a power of ten, which a browser would break after their hyphen.
_POWERS = re.compile(r"(\[?-?[\d.]{1,20}e-\d{1,3}[\],]?)")


def section_html(section: Section, name: str, figures: Mapping[str, Markup]) -> Markup:
    """Section with its heading, and figures where the document has a place for them."""
    parts = [part_html(part, figures) for part in section.parts]
    if not section.heading:
        return element("section", {"id": name}, *parts)
    heading = element("h2", {"id": f"{name}-heading"}, section.heading)
    return element("section", {"id": name, "aria-labelledby": f"{name}-heading"}, heading, *parts)


def part_html(part: Part, figures: Mapping[str, Markup]) -> Markup:
    """One part."""
    match part:
        case Facts():
            return element("dl", {"class": "facts"}, *(_fact(fact) for fact in part.facts))
        case TableOf():
            return table_html(part)
        case Bullets():
            return element("ul", None, *(element("li", None, sentence) for sentence in part.sentences))
        case Statement():
            return element("p", None, badge(part.status, part.text), part.more)
        case Figure():
            return figures.get(part.name, joined(()))


def _fact(fact: Fact) -> Markup:
    reported = part_html(fact.text, {}) if isinstance(fact.text, Bullets) else fact.text
    return element("div", None, element("dt", None, fact.label), element("dd", None, reported))


def badge(status: Status, words: str) -> Markup:
    """A verdict as a word with its shape."""
    return element("span", {"class": f"badge {status.value}"}, shape(status), words)


def shape(status: Status) -> Markup:
    """The shape of a verdict; a screen reader reads the word beside it."""
    box = {"viewBox": "0 0 20 20", "class": "shape", "aria-hidden": "true"}
    ring = element("circle", {"cx": "10", "cy": "10", "r": "8.6"})
    return element("svg", box, ring, element("path", {"d": SHAPES[status]}))


def table_html(table: TableOf, caption: str = "") -> Markup:
    """Table whose rows become blocks where columns have no room; with a caption it may be scrolled."""
    heads = [_head(column) for column in table.columns]
    rows = [
        element(
            "tr",
            None,
            *(
                _cell(*pair, first=not index)
                for index, pair in enumerate(zip(row, table.columns, strict=True))
            ),
        )
        for row in table.rows
    ]
    head = element("thead", None, element("tr", None, *heads))
    whole = element("table", None, head, element("tbody", None, *rows))
    scrolled = {"tabindex": "0", "role": "region", "aria-label": caption} if caption else {}
    return element("div", {"class": "table", **scrolled}, whole)


def _head(column: TableColumn) -> Markup:
    look = {"class": "right"} if column.right else {}
    if not column.title:
        return element("td", look)
    return element("th", {"scope": "col", **look}, column.title)


def _cell(cell: Cell, column: TableColumn, *, first: bool) -> Markup:
    words = {"right": column.right, "strong": column.strong, "whole": column.whole, column.below.value: True}
    look = {"class": " ".join(word for word, wanted in words.items() if wanted), "data-title": column.title}
    first_line: Markup | str = _unbroken(cell.text)
    below = [element("span", {"class": "below"}, _unbroken(cell.below))] if cell.below else []
    if cell.status is not None and below:
        below = [badge(cell.status, cell.below)]
    elif cell.status is not None:
        first_line = badge(cell.status, cell.text)
    elif cell.link:
        first_line = element("a", {"href": cell.link}, cell.text)
    name, extra = ("th", {"scope": "row"}) if first and cell.text else ("td", {})
    return element(name, {**look, **extra}, element("span", {"class": "text"}, first_line), *below)


def _unbroken(text: str) -> Markup:
    """Text whose numbers stay in one line each."""
    pieces = enumerate(_POWERS.split(text))
    return joined(element("span", {"class": "one"}, item) if entry % 2 else item for entry, item in pieces)


# -- Vendored --


@dataclass(frozen=True, slots=True)
class Vendored:
    """A release of another project."""

    name: str
    version: str
    script: str
    style: str
    licence: str


def uplot() -> Vendored:
    """uPlot, which draws series over time."""
    folder = resources.files("eivor.report").joinpath("vendored", "uplot")
    release = tomllib.loads(folder.joinpath("release.toml").read_text(encoding="utf-8"))
    script, style, licence = (
        folder.joinpath(name).read_text(encoding="utf-8") for name in (*release["sha256"], release["licence"])
    )
    return Vendored(release["name"], release["version"], script, style, licence)


def own(name: str) -> str:
    """Source of a file of the page itself."""
    return resources.files("eivor.report").joinpath("static", name).read_text(encoding="utf-8")


# -- Shell --

#: Characters that could end a script or open a comment, as JSON writes them otherwise.
UNSAFE = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"}
#: What is said where no script runs.
UNSCRIPTED = "This browser runs no scripts: they draw the charts over time, and answer buttons."


@dataclass(frozen=True, slots=True)
class Sources:
    """What a page is made of beside its body."""

    style: str
    script: str
    framed: tuple[Sources, ...] = ()
    directives: tuple[str, ...] = ()

    @property
    def policy(self) -> str:
        """Content security policy of a page with this style and this script in it, and nothing besides."""
        every = (self, *self.framed)
        return "; ".join(
            (
                "default-src 'none'",
                f"script-src {' '.join(_hash(item.script) for item in every)}",
                f"style-src {' '.join(_hash(item.style) for item in every)}",
                "img-src data:",
                *self.directives,
                "base-uri 'none'",
                "form-action 'none'",
                "require-trusted-types-for 'script'",
            )
        )


def report_sources() -> Sources:
    """Those of a report."""
    drawing = uplot()
    return Sources(f"{drawing.style}\n{own('page.css')}", f"{drawing.script}\n{own('page.js')}")


def whole_page(title: str, body: Markup, data: Mapping[str, object], sources: Sources | None = None) -> str:
    """Text of a page."""
    made_of = sources or report_sources()
    head = joined(
        [
            element("meta", {"charset": "utf-8"}),
            element("meta", {"http-equiv": "Content-Security-Policy", "content": made_of.policy}),
            element("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}),
            element("meta", {"name": "color-scheme", "content": "light dark"}),
            element("meta", {"name": "referrer", "content": "no-referrer"}),
            element("link", {"rel": "icon", "href": "data:,"}),
            element("title", None, title),
            element("style", None, Markup(made_of.style)),
        ]
    )
    scripts = [embedded(name, item) for name, item in data.items()]
    unscripted = element("noscript", None, element("p", {"class": "unscripted"}, UNSCRIPTED))
    whole = joined([unscripted, body, *scripts, element("script", None, Markup(made_of.script))])
    page = element("html", {"lang": "en"}, element("head", None, head), element("body", None, whole))
    return f"<!DOCTYPE html>\n{page.html}\n"


def embedded(name: str, value: object) -> Markup:
    """JSON in an element that no browser runs, in characters of ASCII without any that HTML has a use for."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character, code in UNSAFE.items():
        text = text.replace(character, code)
    return element("script", {"type": "application/json", "id": name}, Markup(text))


def _hash(source: str) -> str:
    digest = hashlib.sha256(source.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
