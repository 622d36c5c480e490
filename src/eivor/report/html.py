"""HTML of pages: templates, escaping, policies and vendored scripts."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

from markupsafe import Markup

from eivor.inference.verdict import Status
from eivor.report.document import Look
from eivor.strict_toml import package_tables
from eivor.tools import printable

if TYPE_CHECKING:
    from jinja2 import Template

#: A shape for each verdict and look, drawn in a square of 20: colour is never alone.
SHAPES = {
    Status.IDENTIFIED.value: "M4.5 10.5l3.6 3.8 7.4-8.6",
    Status.WEAK.value: "M5 11.5c2-3.2 3.6-3.2 5-1.2s3 2 5-1.2",
    Status.PROVISIONAL.value: "M10 5.2v5.4M10 14.2v.8",
    Status.REFUSED.value: "M5.5 10h9",
    Look.CONTRADICTED.value: "M6 6l8 8M14 6l-8 8",
}
#: Numbers with a power of ten, which a browser would break after their hyphen.
_POWERS = re.compile(r"(\[?-?[\d.]{1,20}e-\d{1,3}[\],]?)")
#: What stands below the line in a symbol, such as the u of K_u.
_SUBSCRIPTS = re.compile(r"(?<=\b[A-Za-zα-ω])_(\w{1,4})\b(?![.\w])")


@cache
def template(name: str) -> Template:
    """Template, without its line breaks and indents; values are escaped, and made visible."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    folder = resources.files("eivor.report").joinpath("templates")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.finalize = lambda value: (
        printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value
    )
    environment.loader = FunctionLoader(
        lambda file: re.sub(r"\s*\n\s*", "", folder.joinpath(file).read_text(encoding="utf-8"))
    )
    environment.filters |= {
        "kind": lambda part: type(part).__name__,
        "powers": _POWERS.split,
        "subscripts": _SUBSCRIPTS.split,
    }
    environment.globals["shapes"] = SHAPES
    return environment.get_template(name)


def rendered(file: str, /, **values: object) -> Markup:
    """HTML of a template."""
    return Markup(template(file).render(values))  # noqa: S704 - the template has escaped it


def uplot() -> dict[str, str]:
    """uPlot, which draws series over time: name and version, and texts of script, style and licence."""
    folder = resources.files("eivor.report").joinpath("vendored", "uplot")
    release = package_tables("eivor.report", "vendored/uplot/release.toml")
    files = dict(zip(("script", "style", "licence"), (*release["sha256"], release["licence"]), strict=True))
    texts = {kind: folder.joinpath(file).read_text(encoding="utf-8") for kind, file in files.items()}
    return {"name": release["name"], "version": release["version"], **texts}


def asset(name: str) -> str:
    """Source of a file of the page itself."""
    return resources.files("eivor.report").joinpath("static", name).read_text(encoding="utf-8")


#: Characters that could end a script or open a comment, as JSON writes them otherwise.
UNSAFE = str.maketrans({"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"})


@dataclass(frozen=True, slots=True)
class Sources:
    """What a page is made of beside its body."""

    style: str
    script: str
    framed: tuple[Sources, ...] = ()
    directives: tuple[str, ...] = ()

    @property
    def policy(self) -> str:
        every = (self, *self.framed)
        scripts = " ".join(_hash(item.script) for item in every)
        styles = " ".join(_hash(item.style) for item in every)
        sources = "default-src 'none'", f"script-src {scripts}", f"style-src {styles}", "img-src data:"
        never = "base-uri 'none'", "form-action 'none'", "require-trusted-types-for 'script'"
        return "; ".join((*sources, *self.directives, *never))


def report_sources() -> Sources:
    """Those of a report."""
    drawing = uplot()
    return Sources(f"{drawing['style']}\n{asset('page.css')}", f"{drawing['script']}\n{asset('page.js')}")


def whole_page(title: str, body: Markup, data: Mapping[str, object], sources: Sources | None = None) -> str:
    """Text of a page; its data are JSON in elements that no browser runs."""
    made_of, compact = sources or report_sources(), (",", ":")
    # JSON in ASCII, without a character that HTML has a use for
    texts = {name: json.dumps(item, allow_nan=False, separators=compact) for name, item in data.items()}
    page = rendered(
        "page.html",
        title=title,
        policy=made_of.policy,
        style=Markup(made_of.style),  # noqa: S704 - the package's own files
        script=Markup(made_of.script),  # noqa: S704
        data={name: Markup(text.translate(UNSAFE)) for name, text in texts.items()},  # noqa: S704
        body=body,
    )
    return f"{page}\n"


def _hash(source: str) -> str:
    digest = hashlib.sha256(source.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
