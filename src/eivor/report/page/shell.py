"""The page around what it tells: its policy, its style and script, and data that stay data.

Nothing is fetched: the policy allows the style and the scripts of the page by their hashes, and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass

from eivor.report.page.markup import Markup, element, joined
from eivor.report.page.vendored import own, uplot

#: Characters that could end a script or open a comment, as JSON writes them otherwise.
UNSAFE = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"}
#: What is said where no script runs.
UNSCRIPTED = "This browser runs no scripts: they draw the charts over time, and answer buttons."


@dataclass(frozen=True, slots=True)
class Sources:
    """What a page is made of beside its body.

    Parameters
    ----------
    style, script : str
        The only ones that its policy allows.
    framed : tuple of Sources
        Those of pages that it shows within itself, which its policy is for too.
    directives : tuple of str
        What else its policy says.
    """

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
                f"script-src {' '.join(_hash(one.script) for one in every)}",
                f"style-src {' '.join(_hash(one.style) for one in every)}",
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
    """Text of a page.

    Parameters
    ----------
    title : str
        Of the window.
    body : Markup
        What is shown.
    data : mapping of str to object
        What scripts read and users save, as JSON, by the identifier of its element.
    sources : Sources, optional
        Default: those of a report.
    """
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
    scripts = [embedded(name, one) for name, one in data.items()]
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
