"""HTTP server and page."""

from __future__ import annotations

from importlib import resources

from eivor.report.html import SHAPES, Markup, Sources, element, joined, own, report_sources, whole_page

#: Parts of the script, in the order in which they stand in it.
PARTS = (
    "base",
    "talk",
    "folders",
    "flights",
    "course",
    "choices",
    "downloads",
    "result",
    "compare",
    "start",
)
#: Shapes of stages, drawn as those of verdicts are: gone by, at it, to come.
STAGES = {"over": "M6 10.4l2.8 2.9 5.4-6.4", "now": "M6 10h7.6M10.4 6.6l3.4 3.4-3.4 3.4", "ahead": ""}
#: What the script may ask: its own server, and reports within the page, which it makes itself.
DIRECTIVES = ("connect-src 'self'", "frame-src blob:")
TITLE = "Drop a flight log"
PRIVACY = "The log stays on this machine: the page talks to the Eivor that runs on it, and to nobody else."
#: What comes back, shown while nothing was dropped.
COMES_BACK = (
    ("A verdict first", "Identified, weak, provisional or refused, in a sentence, and why."),
    ("Numbers with intervals", "Friction, gain, hover input, lag: each with a verdict of its own."),
    ("What to do with it", "The next flight to fly, and files for autopilots and simulators."),
)
FORMATS = "ULog, ArduPilot, ROS bags and MCAP, Crazyflie, CSV, Parquet. Several logs are compared."


def page_text() -> str:
    """Text of the page: HTML with its style, its script and a policy that allows nothing else."""
    shapes = {status.value: path for status, path in SHAPES.items()} | STAGES
    return whole_page("Eivor", _body(), {"shapes": shapes}, _sources())


def _sources() -> Sources:
    """The report's style with what is this page's own; its policy is for the reports in it, too."""
    folder = resources.files("eivor.serve").joinpath("static")
    scripts = [folder.joinpath(f"{name}.js").read_text(encoding="utf-8") for name in PARTS]
    style = f"{own('page.css')}\n{folder.joinpath('serve.css').read_text(encoding='utf-8')}"
    script = "\n".join(['"use strict";', "(() => {", *scripts, "})();"])
    return Sources(style, script, (report_sources(),), DIRECTIVES)


def _body() -> Markup:
    theme = element("button", {"type": "button", "id": "theme"}, "Dark")
    about = element("p", {"class": "about"}, "Eivor · on this machine")
    return joined(
        [
            element("header", None, element("div", None, about, element("h1", None, TITLE)), theme),
            element(
                "main",
                {"id": "main"},
                _drop(),
                element("div", {"class": "comes"}, *(_promise(*item) for item in COMES_BACK)),
                element("p", {"id": "status", "role": "status", "class": "unseen"}),
                _flights(),
                element(
                    "section",
                    {"id": "comparison", "aria-labelledby": "comparison-heading", "hidden": ""},
                    element("h2", {"id": "comparison-heading"}, "Flights compared"),
                    element("div", {"id": "compared"}),
                ),
                element("section", {"id": "result", "aria-labelledby": "result-heading", "hidden": ""}),
            ),
        ]
    )


def _drop() -> Markup:
    """Where logs are dropped, or chosen with a button."""
    box = {"viewBox": "0 0 48 48", "class": "arrow", "aria-hidden": "true"}
    arrow = element("svg", box, element("path", {"d": "M24 6v24M14 21l10 10 10-10M7 35v6h34v-6"}))
    one_or_more = {"type": "file", "multiple": "", "class": "unseen"}
    files = element("input", {**one_or_more, "id": "files"})
    folder = element("input", {**one_or_more, "id": "folder", "webkitdirectory": ""})
    words = element(
        "p",
        {"class": "call"},
        "Drop flight logs here, or ",
        element("label", {"class": "button"}, "Choose files", files),
        " ",
        element("label", {"class": "button second"}, "Choose a folder", folder),
    )
    notes = element("div", {"class": "notes"}, element("p", None, PRIVACY), element("p", None, FORMATS))
    example = element("button", {"type": "button", "id": "example"}, "Try the example flight")
    none_at_hand = element("p", {"class": "example"}, "No log at hand? ", example)
    return element("div", {"id": "drop", "class": "drop"}, arrow, words, notes, none_at_hand)


def _promise(title: str, words: str) -> Markup:
    return element("div", None, element("h2", None, title), element("p", None, words))


def _flights() -> Markup:
    """One card for each flight, and what can be done with all of them."""
    compare = element("button", {"type": "button", "id": "compare", "aria-pressed": "false"}, "Compare")
    pool = element("button", {"type": "button", "id": "pool"}, "Pool as one vehicle")
    together = element("p", {"id": "together", "class": "together", "hidden": ""}, compare, pool)
    head = element("div", {"class": "head"}, element("h2", {"id": "flights-heading"}, "Flights"), together)
    cards = element("ul", {"id": "cards", "class": "cards"})
    return element(
        "section", {"id": "flights", "aria-labelledby": "flights-heading", "hidden": ""}, head, cards
    )
