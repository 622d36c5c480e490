"""Pictures as HTML: a heading, the picture, its legend, how to read it, and its numbers to unfold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from eivor.report.page.chart import Chart
from eivor.report.page.markup import Markup, element, joined
from eivor.report.page.parts import table_html
from eivor.report.page.picture import Picture, Pictures
from eivor.report.page.plot import Band, Curve, Dots, Mark, Plot, Rule
from eivor.report.printable import printable

#: Samples of all lines of a page together; each chart has its share.
SAMPLES = 160_000
#: What a chart has in any case, and what no screen has any use for.
FEWEST, MOST = 1_000, 20_000


@dataclass
class Figures:
    """Figures of one page: they are numbered, so that no two have one name, and share its room."""

    lines: int
    charts: dict[str, dict[str, object]] = field(default_factory=dict)
    count: int = 0

    def html(self, groups: Iterable[Pictures]) -> Markup:
        """Groups of pictures."""
        return joined(piece for group in groups for piece in self._group(group))

    def _group(self, group: Pictures) -> Iterator[Markup]:
        if group.heading:
            yield element("h3", {"class": "flight"}, group.heading)
        over_time = [one for one in group.pictures if isinstance(one.drawn, Chart)]
        others = [one for one in group.pictures if not isinstance(one.drawn, Chart)]
        if over_time:
            made = [self._figure(one) for one in over_time]
            name = over_time[0].drawn.group if isinstance(over_time[0].drawn, Chart) else ""
            yield element("div", {"class": "charts", "data-group": name}, _tools(), *made)
        if others:
            yield element("div", {"class": "plots"}, *(self._figure(one) for one in others))

    def _figure(self, picture: Picture) -> Markup:
        self.count += 1
        name = f"picture-{self.count}"
        heading = element("h4", {"id": f"{name}-heading"}, picture.title)
        words = [element("p", {"class": "words"}, picture.words)] if picture.words else []
        table = []
        if picture.table is not None:
            numbers = table_html(picture.table, f"Numbers of: {picture.title}")
            summary = element(
                "summary", None, "Numbers", element("span", {"class": "unseen"}, f" of: {picture.title}")
            )
            table = [element("details", None, summary, numbers)]
        drawn = picture.drawn
        if isinstance(drawn, Chart):
            most = min(max(SAMPLES // max(self.lines, 1), FEWEST), MOST)
            self.charts[name] = {**drawn.packed(most), "title": printable(picture.title)}
            keys = "Arrow keys move, plus and minus zoom, zero shows the whole flight."
            box = {"class": "chart", "id": name, "tabindex": "0", "role": "group"}
            pieces = [element("div", {**box, "aria-label": f"{picture.title}. {keys}"})]
            legend = _lines_legend(drawn)
        else:
            pieces = [drawn.drawn(name, picture.title)]
            legend = _marks_legend(drawn.marks) if isinstance(drawn, Plot) else joined(())
        return element(
            "figure", {"aria-labelledby": f"{name}-heading"}, heading, *pieces, legend, *words, *table
        )


def lines_of(groups: Iterable[Pictures]) -> int:
    """Number of lines over time."""
    drawn = (picture.drawn for group in groups for picture in group.pictures)
    return sum(len(one.lines) for one in drawn if isinstance(one, Chart))


def _tools() -> Markup:
    """What zooms with a pointer or a finger; keys do the same."""
    buttons = [
        element("button", {"type": "button", "data-zoom": action, "aria-label": words, "title": words}, sign)
        for action, words, sign in (
            ("in", "Zoom in", "+"),
            ("out", "Zoom out", "−"),
            ("left", "Move to the left", "←"),
            ("right", "Move to the right", "→"),
            ("whole", "Show the whole flight", "whole flight"),
            ("used", "Show what is used", "what is used"),
        )
    ]
    shown = element("output", {"class": "shown"})
    how = element("p", {"class": "how"}, "Draw over a chart to zoom into it; all charts follow.")
    return element("div", {"class": "tools"}, *buttons, shown, how)


def _lines_legend(chart: Chart) -> Markup:
    """Samples of the lines with their words, and room for the value under the cursor."""
    entries = [
        element(
            "li",
            None,
            _sample("curve", line.look),
            element("span", None, line.label),
            element("output", {"class": "at-cursor"}),
        )
        for line in chart.lines
    ]
    if chart.left_out_s:
        entries.append(element("li", None, _sample("band", "hatched"), "left out"))
    return element("ul", {"class": "legend"}, *entries)


def _marks_legend(marks: tuple[Mark, ...]) -> Markup:
    entries = []
    for mark in marks:
        if not mark.label:
            continue
        kind = {Band: "band", Rule: "rule", Curve: "curve", Dots: "dot"}.get(type(mark), "stem")
        entries.append(element("li", None, _sample(kind, mark.look), element("span", None, mark.label)))
    return element("ul", {"class": "legend"}, *entries)


def _sample(kind: str, look: str) -> Markup:
    """A piece of what is drawn."""
    box = {"viewBox": "0 0 28 12", "class": "sample", "aria-hidden": "true"}
    if look == "hatched":
        lines = [_line(f"M{x} 12L{x + 12} 0", "hatch") for x in range(-6, 28, 6)]
        return element("svg", box, *lines)
    shapes = {
        "band": element("rect", {"x": "1", "y": "1", "width": "26", "height": "10", "class": f"band {look}"}),
        "dot": element("circle", {"cx": "14", "cy": "6", "r": "3", "class": f"dot {look}"}),
    }
    return element("svg", box, shapes.get(kind, _line("M0 6H28", f"{kind} {look}")))


def _line(path: str, look: str) -> Markup:
    return element("path", {"d": path, "class": look})
