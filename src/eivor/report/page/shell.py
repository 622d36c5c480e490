"""The page around what it tells: its policy, its style and script, and data that stay data.

Nothing is fetched: the policy allows the style and the scripts of the page by their hashes, and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping

from eivor.report.page.markup import Markup, element, joined
from eivor.report.page.vendored import own, uplot

#: Characters that could end a script or open a comment, as JSON writes them otherwise.
UNSAFE = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"}


def whole_page(title: str, body: Markup, data: Mapping[str, object]) -> str:
    """Text of a page.

    Parameters
    ----------
    title : str
        Of the window.
    body : Markup
        What is shown.
    data : mapping of str to object
        What scripts read and users save, as JSON, by the identifier of its element.
    """
    drawing = uplot()
    style = f"{drawing.style}\n{own('page.css')}"
    script = f"{drawing.script}\n{own('page.js')}"
    head = joined(
        [
            element("meta", {"charset": "utf-8"}),
            element("meta", {"http-equiv": "Content-Security-Policy", "content": policy(style, script)}),
            element("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}),
            element("meta", {"name": "color-scheme", "content": "light dark"}),
            element("meta", {"name": "referrer", "content": "no-referrer"}),
            element("link", {"rel": "icon", "href": "data:,"}),
            element("title", None, title),
            element("style", None, Markup(style)),
        ]
    )
    scripts = [embedded(name, one) for name, one in data.items()]
    whole = joined([body, *scripts, element("script", None, Markup(script))])
    page = element("html", {"lang": "en"}, element("head", None, head), element("body", None, whole))
    return f"<!DOCTYPE html>\n{page.html}\n"


def policy(style: str, script: str) -> str:
    """Content security policy of a page with this style and this script in it, and nothing besides."""
    return "; ".join(
        (
            "default-src 'none'",
            f"script-src {_hash(script)}",
            f"style-src {_hash(style)}",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
            "require-trusted-types-for 'script'",
        )
    )


def embedded(name: str, value: object) -> Markup:
    """JSON in an element that no browser runs, in characters of ASCII without any that HTML has a use for."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character, code in UNSAFE.items():
        text = text.replace(character, code)
    return element("script", {"type": "application/json", "id": name}, Markup(text))


def _hash(source: str) -> str:
    digest = hashlib.sha256(source.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
