"""The page of the server, with its style and its script."""

from __future__ import annotations

from importlib import resources

from eivor.report.html import SHAPES, Sources, own, rendered, report_sources, whole_page

#: Parts of the script, in the order in which they stand in it.
PARTS = ("base", "talk", "folders", "flights", "course", "choices", "downloads", "result", "compare", "start")
#: Shapes of stages, drawn as those of verdicts are: gone by, at it, to come.
STAGES = {"over": "M6 10.4l2.8 2.9 5.4-6.4", "now": "M6 10h7.6M10.4 6.6l3.4 3.4-3.4 3.4", "ahead": ""}
#: What the script may ask: its own server, and reports within the page, which it makes itself.
DIRECTIVES = ("connect-src 'self'", "frame-src blob:")


def page_text() -> str:
    """Text of the page: HTML with its style, its script and a policy that allows nothing else."""
    shapes = {status.value: path for status, path in SHAPES.items()} | STAGES
    return whole_page("Eivor", rendered("serve.html"), {"shapes": shapes}, page_sources())


def page_sources() -> Sources:
    """The report's style with what is this page's own; its policy is for the reports in it, too."""
    folder = resources.files("eivor.serve").joinpath("static")
    scripts = [folder.joinpath(f"{name}.js").read_text(encoding="utf-8") for name in PARTS]
    style = f"{own('page.css')}\n{folder.joinpath('serve.css').read_text(encoding='utf-8')}"
    script = "\n".join(['"use strict";', "(() => {", *scripts, "})();"])
    return Sources(style, script, (report_sources(),), DIRECTIVES)
