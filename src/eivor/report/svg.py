"""SVG plots, charts and forest plots."""

from __future__ import annotations

import base64
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from eivor.inference.verdict import Status
from eivor.report.document import TableOf, printable
from eivor.report.html import Markup, element, joined
from eivor.tools import Bool, Float, Int

# -- Chart --

#: Code of a value that is not there, and the largest of one that is.
MISSING, LARGEST = 65535, 65534
#: Samples further apart than so many steps are not joined by a line.
BROKEN_AFTER = 1.5


@dataclass(frozen=True)
class Line:
    """One series."""

    label: str
    look: str
    values: Float[np.ndarray, " n"]  # Not a number where there is none


@dataclass(frozen=True)
class Chart:
    """Series over one time."""

    group: str
    unit: str
    time_s: Float[np.ndarray, " n"]
    lines: tuple[Line, ...]  # With values at these times
    over_s: tuple[float, float]
    view_s: tuple[float, float]
    omitted_s: tuple[tuple[float, float], ...]

    def packed(self, most: int) -> dict[str, object]:
        """Return it for the page's script, in about `most` samples."""
        values = np.stack([line.values for line in self.lines], axis=1)
        stretches, kept = _thinned(self.time_s, values, most)
        return {
            "group": self.group,
            "unit": printable(self.unit),
            "over": list(self.over_s),
            "view": list(self.view_s),
            "leftOut": [list(pair) for pair in self.omitted_s],
            "stretches": stretches,
            "lines": [
                {"label": printable(line.label), "look": line.look, **_coded(kept[:, index])}
                for index, line in enumerate(self.lines)
            ],
        }


def stretches_of(
    mask: Bool[np.ndarray, " n"], time_s: Float[np.ndarray, " n"]
) -> tuple[tuple[float, float], ...]:
    """First and last time of each stretch of a mask."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return tuple(
        (float(time_s[first]), float(time_s[end - 1]))
        for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    )


def _thinned(
    time_s: Float[np.ndarray, " n"], values: Float[np.ndarray, "n lines"], most: int
) -> tuple[list[list[float]], Float[np.ndarray, "kept lines"]]:
    """Start, step and count of each unbroken stretch, and its values: all, or the ends of their ranges."""
    if time_s.size < 2:
        return [[float(item), 0.0, 1] for item in time_s], values
    steps = np.diff(time_s)
    step = float(np.median(steps))
    edges = [0, *(np.flatnonzero(steps > BROKEN_AFTER * step) + 1).tolist(), time_s.size]
    together = max(1, -(-2 * time_s.size // most)) if time_s.size > most else 1
    stretches, kept = [], []
    for first, end in pairwise(edges):
        part = values[first:end] if together == 1 else _ranges(values[first:end], together)
        stretches.append([float(time_s[first]), step * max(together / 2.0, 1.0), len(part)])
        kept.append(part)
    return stretches, np.concatenate(kept)


def _ranges(values: Float[np.ndarray, "n lines"], together: int) -> Float[np.ndarray, "kept lines"]:
    """Least and greatest of so many values at a time, in the order in which they come."""
    short = -len(values) % together
    padded = np.concatenate([values, np.repeat(values[-1:], short, axis=0)])
    blocks = padded.reshape(-1, together, values.shape[1])
    least, most = np.fmin.reduce(blocks, axis=1), np.fmax.reduce(blocks, axis=1)
    rising = _first(blocks, least) <= _first(blocks, most)
    both = np.stack([np.where(rising, least, most), np.where(rising, most, least)], axis=1)
    return both.reshape(-1, values.shape[1])


def _first(
    blocks: Float[np.ndarray, "blocks together lines"], wanted: Float[np.ndarray, "blocks lines"]
) -> Int[np.ndarray, "blocks lines"]:
    return np.argmax(blocks == wanted[:, None, :], axis=1)


def _coded(values: Float[np.ndarray, " n"]) -> dict[str, object]:
    """Values as integers of two bytes in base64, and how to turn them back."""
    there = np.isfinite(values)
    low, high = (float(values[there].min()), float(values[there].max())) if there.any() else (0.0, 0.0)
    step = (high - low) / LARGEST
    codes = np.full(values.size, MISSING, dtype="<u2")
    codes[there] = np.rint((values[there] - low) / step) if step > 0.0 else 0
    return {"low": low, "step": step, "codes": base64.b64encode(codes.tobytes()).decode("ascii")}


# -- Scale --

#: Steps between ticks are these times a power of ten.
ROUND_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


@dataclass(frozen=True, slots=True)
class Tick:
    """A value that is written at an axis."""

    value: float
    words: str


class Scale(ABC):
    """How values of an axis are placed."""

    words: str
    """What the axis shows, with its unit."""

    @abstractmethod
    def share(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Place of values: 0 at the low end, 1 at the high one, no further than these."""

    @abstractmethod
    def ticks(self, most: int) -> list[Tick]:
        """Up to about so many values to write."""


@dataclass(frozen=True, slots=True)
class Linear(Scale):
    """Equal steps."""

    words: str
    low: float
    high: float

    def share(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Place of values, see `Scale.share`."""
        return np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0)

    def ticks(self, most: int) -> list[Tick]:
        """Round values, see `Scale.ticks`."""
        raw = (self.high - self.low) / most
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(power * item for item in ROUND_STEPS if power * item >= raw * (1.0 - 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        values = [number * step for number in range(first, last + 1)]
        return [Tick(item, words) for item, words in zip(values, _written(values, step), strict=True)]


@dataclass(frozen=True, slots=True)
class Logarithmic(Scale):
    """Equal ratios."""

    words: str
    low: float
    high: float

    def share(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Place of values, see `Scale.share`."""
        inside = np.clip(values, self.low, self.high)
        return np.log(inside / self.low) / math.log(self.high / self.low)

    def ticks(self, most: int) -> list[Tick]:
        """Powers of ten, with others between them where there are few, see `Scale.ticks`."""
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        for between in ((1, 2, 5), (1, 3), (1,)):
            values = [item * 10.0**decade for decade in decades for item in between]
            inside = [
                item for item in values if self.low <= item * (1 + 1e-9) and item <= self.high * (1 + 1e-9)
            ]
            if len(inside) <= most:
                break
        if len(inside) < 2:
            return Linear(self.words, self.low, self.high).ticks(most)
        inside = inside[:: -(-len(inside) // most)]
        return [Tick(item, _power(item)) for item in inside]


@dataclass(frozen=True, slots=True)
class LinearBelow(Scale):
    """Equal steps up to a value, equal ratios above it, from zero on."""

    words: str
    bend: float
    high: float

    def share(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Place of values, see `Scale.share`."""
        return np.clip(self._bent(np.maximum(values, 0.0)) / self._bent(np.array([self.high])), 0.0, 1.0)

    def _bent(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        above = 1.0 + np.log10(np.maximum(values, self.bend) / self.bend)
        return np.where(values < self.bend, values / self.bend, above)

    def ticks(self, most: int) -> list[Tick]:
        """Zero, and powers of ten above the bend, see `Scale.ticks`."""
        first = math.floor(math.log10(self.bend)) + 1
        powers = [10.0**power for power in range(first, math.floor(math.log10(self.high)) + 1)]
        return [Tick(item, _power(item)) for item in (0.0, *powers[:: -(-len(powers) // most) or 1])]


def margined(words: str, values: Float[np.ndarray, " n"], share: float = 0.06) -> Linear:
    """Linear scale over all finite values, with a margin; never empty."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    margin = share * (high - low) if high > low else 0.1 * abs(high) or 0.1
    return Linear(words, low - margin, high + margin)


def _written(values: list[float], step: float) -> list[str]:
    """Values with the decimals that their step needs; with a power of ten where they are tiny or huge."""
    largest = max((abs(item) for item in values), default=0.0)
    plain = not largest or 1e-3 <= largest < 1e6
    power = 0 if plain else math.floor(math.log10(largest))
    decimals = next(
        n for n in range(12) if n == 11 or math.isclose(round(step / 10.0**power, n), step / 10.0**power)
    )
    tail = f"e{power}" if power else ""
    return [
        f"{item / 10.0**power + 0.0:.{decimals}f}{tail if item else ''}".replace("-", "−") for item in values
    ]


def _power(value: float) -> str:
    if value == 0.0 or 1e-3 <= value < 1e5:
        return f"{value:g}"
    digit, power = f"{value:.0e}".split("e")
    return f"{digit}e{int(power)}".replace("-", "−")


# -- Plot --

#: Size of a drawing, and of what is left for words around it; it is shown at most at this width.
WIDTH, HEIGHT = 440.0, 300.0
TOP, RIGHT, BOTTOM = 30.0, 14.0, 46.0
#: Width of a letter, and height above the line of what is written at an axis.
LETTER, RISE = 7.4, 4.5
MOST_TICKS = 6


@dataclass(frozen=True)
class Points:
    """Places in a drawing."""

    label: str
    look: str
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]


class Curve(Points):
    """A line through points."""


class Dots(Points):
    """Points."""


class Stems(Points):
    """Points with lines to zero."""


@dataclass(frozen=True)
class Band:
    """A range of one axis, over all of the other."""

    label: str
    look: str
    low: float
    high: float
    upright: bool


@dataclass(frozen=True)
class Rule:
    """One value of an axis, over all of the other."""

    label: str
    look: str
    value: float
    upright: bool


Mark = Curve | Dots | Stems | Band | Rule


@dataclass(frozen=True)
class Plot:
    """A drawing."""

    x: Scale
    y: Scale
    marks: tuple[Mark, ...]

    def drawn(self, name: str, title: str) -> Markup:
        """SVG, with identifiers that begin with a name of its own."""
        return _Frame(self).svg(name, title)


class _Frame:
    """Where the axes of a plot stand on the paper."""

    def __init__(self, plot: Plot) -> None:
        self.plot = plot
        self.y_ticks = plot.y.ticks(MOST_TICKS)
        longest = max((len(tick.words) for tick in self.y_ticks), default=1)
        self.left = 14.0 + LETTER * longest
        self.right, self.bottom = WIDTH - RIGHT, HEIGHT - BOTTOM

    def across(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return self.left + (self.right - self.left) * self.plot.x.share(np.asarray(values, dtype=np.float64))

    def up(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return self.bottom - (self.bottom - TOP) * self.plot.y.share(np.asarray(values, dtype=np.float64))

    def svg(self, name: str, title: str) -> Markup:
        heading = element("title", {"id": f"{name}-title"}, title)
        marks = [self._mark(mark) for mark in self.plot.marks]
        box = {"viewBox": f"0 0 {WIDTH:g} {HEIGHT:g}", "class": "plot", "role": "img"}
        content = (heading, *self._grid(), *marks, *self._words())
        return element("svg", {**box, "aria-labelledby": f"{name}-title"}, *content)

    def _grid(self) -> list[Markup]:
        """Lines at the ticks, and the ticks' words, those left out that would touch."""
        pieces = []
        for tick in self.y_ticks:
            height = float(self.up(np.array([tick.value]))[0])
            pieces.append(_straight_line("grid", self.left, height, self.right, height))
            position = {"x": f"{self.left - 7:.1f}", "y": f"{height + RISE:.1f}", "class": "tick end"}
            pieces.append(element("text", position, tick.words))
        free = 0.0
        for tick in self.plot.x.ticks(MOST_TICKS):
            index = float(self.across(np.array([tick.value]))[0])
            pieces.append(_straight_line("grid", index, TOP, index, self.bottom))
            half = 0.5 * LETTER * len(tick.words)
            if index - half >= free and index + half <= WIDTH:
                position = {"x": f"{index:.1f}", "y": f"{self.bottom + 18:.1f}", "class": "tick middle"}
                pieces.append(element("text", position, tick.words))
                free = index + half + LETTER
        return pieces

    def _words(self) -> list[Markup]:
        middle = 0.5 * (self.left + self.right)
        below = {"x": f"{middle:.1f}", "y": f"{HEIGHT - 8:.1f}", "class": "axis middle"}
        above = {"x": "4", "y": "16", "class": "axis"}
        return [element("text", below, self.plot.x.words), element("text", above, self.plot.y.words)]

    def _mark(self, mark: Mark) -> Markup:
        match mark:
            case Curve():
                return element("path", {"d": self._path(mark.x, mark.y), "class": f"curve {mark.look}"})
            case Dots():
                return joined(self._dots(mark.x, mark.y, mark.look))
            case Stems():
                foot = float(self.up(np.zeros(1))[0])
                index = zip(self.across(mark.x).tolist(), self.up(mark.y).tolist(), strict=True)
                stems = [_straight_line(f"stem {mark.look}", x, foot, x, y) for x, y in index]
                return joined([*stems, *self._dots(mark.x, mark.y, mark.look)])
            case Band():
                return self._band(mark)
            case Rule():
                return self._rule(mark)

    def _path(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> str:
        there = np.isfinite(x) & np.isfinite(y)
        pieces, started = [], False
        for across, up, known in zip(
            self.across(x).tolist(), self.up(y).tolist(), there.tolist(), strict=True
        ):
            if known:
                pieces.append(f"{'L' if started else 'M'}{across:.1f} {up:.1f}")
            started = known
        return "".join(pieces)

    def _dots(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], look: str) -> list[Markup]:
        index = zip(self.across(x).tolist(), self.up(y).tolist(), strict=True)
        return [
            element("circle", {"cx": f"{across:.1f}", "cy": f"{up:.1f}", "r": "3", "class": f"dot {look}"})
            for across, up in index
            if np.isfinite(across) and np.isfinite(up)
        ]

    def _band(self, band: Band) -> Markup:
        ends = np.array([band.low, band.high])
        if band.upright:
            first, last = self.across(ends).tolist()
            box = (first, TOP, last - first, self.bottom - TOP)
        else:
            low, high = self.up(ends).tolist()
            box = (self.left, high, self.right - self.left, low - high)
        keys = ("x", "y", "width", "height")
        sides = {key: f"{value:.1f}" for key, value in zip(keys, box, strict=True)}
        return element("rect", {**sides, "class": f"band {band.look}"})

    def _rule(self, rule: Rule) -> Markup:
        index = np.array([rule.value])
        if rule.upright:
            x = float(self.across(index)[0])
            return _straight_line(f"rule {rule.look}", x, TOP, x, self.bottom)
        y = float(self.up(index)[0])
        return _straight_line(f"rule {rule.look}", self.left, y, self.right, y)


def _straight_line(look: str, *ends: float) -> Markup:
    keys = ("x1", "y1", "x2", "y2")
    positions = {key: f"{value:.1f}" for key, value in zip(keys, ends, strict=True)}
    return element("line", {**positions, "class": look})


# -- Forest --

ROW, FOOT, SIDE = 44.0, 44.0, 14.0
#: Letters of eleven pixels.
SMALL_LETTER = 7.4
#: Half-widths over so many times the middle one are not what the scale is made for: they are cut.
WIDEST = 6.0


@dataclass(frozen=True)
class ForestRow:
    """One row."""

    label: str
    numbers: str  # Value and interval as tables show them
    value: float
    pieces: tuple[tuple[float, float], ...]  # The interval, or the pieces of a set
    status: Status | None = None
    whole: bool = False


@dataclass(frozen=True)
class Forest:
    """Rows over one axis."""

    words: str
    rows: tuple[ForestRow, ...]

    def drawn(self, name: str, title: str) -> Markup:
        """SVG, with identifiers that begin with a name of its own."""
        height = ROW * len(self.rows) + FOOT
        scale = self._scale()
        box = {"viewBox": f"0 0 {WIDTH:g} {height:g}", "class": "plot forest", "role": "img"}
        content = [element("title", {"id": f"{name}-title"}, title)]
        content += _axis(scale, ROW * len(self.rows) + 4.0)
        for index, row in enumerate(self.rows):
            content += _forest_markup(row, scale, ROW * index)
        return element("svg", {**box, "aria-labelledby": f"{name}-title"}, *content)

    def _scale(self) -> Linear:
        """Scale over what is estimated well; the rest is cut, and its cut ends are arrows."""
        halves = [
            0.5 * (high - low) for row in self.rows for low, high in row.pieces if math.isfinite(high - low)
        ]
        middle = float(np.median(halves)) if halves else 0.0
        ends = [
            end
            for row in self.rows
            for piece in row.pieces
            if 0.5 * (piece[1] - piece[0]) <= WIDEST * middle
            for end in (*piece, row.value)
        ]
        return margined(self.words, np.array(ends or [0.0]))


def _across(scale: Linear, value: float) -> float:
    return SIDE + (WIDTH - 2.0 * SIDE) * float(scale.share(np.array([value]))[0])


def _axis(scale: Linear, top: float) -> list[Markup]:
    pieces, free = [], 0.0
    for tick in scale.ticks(5):
        text = f"{_across(scale, tick.value):.1f}"
        pieces.append(
            element("line", {"x1": text, "y1": "0", "x2": text, "y2": f"{top:.1f}", "class": "grid"})
        )
        half = 0.5 * LETTER * len(tick.words)
        if float(text) - half >= free and float(text) + half <= WIDTH:
            pieces.append(
                element("text", {"x": text, "y": f"{top + 16:.1f}", "class": "tick middle"}, tick.words)
            )
            free = float(text) + half + LETTER
    middle = {"x": f"{WIDTH / 2:.1f}", "y": f"{top + 35:.1f}", "class": "axis middle"}
    return [*pieces, element("text", middle, scale.words)]


def _forest_markup(row: ForestRow, scale: Linear, top: float) -> list[Markup]:
    room = int((WIDTH - 2.0 * SIDE - SMALL_LETTER * (len(row.numbers) + 2)) / SMALL_LETTER)
    label = row.label if len(row.label) <= room else f"{row.label[: max(room - 1, 1)]}…"
    look = "whole" if row.whole else row.status.value if row.status is not None else "plain"
    words = {"x": f"{SIDE:g}", "y": f"{top + 15:.1f}", "class": "row"}
    numbers = {"x": f"{WIDTH - SIDE:g}", "y": f"{top + 15:.1f}", "class": "row end numbers"}
    height = top + 30.0
    pieces = [element("text", words, label), element("text", numbers, row.numbers)]
    for low, high in row.pieces:
        pieces += _whisker(scale, (low, high), height, look)
    if math.isfinite(row.value) and scale.low <= row.value <= scale.high:
        pieces.append(_point(_across(scale, row.value), height, look))
    return pieces


def _whisker(scale: Linear, ends: tuple[float, float], y: float, look: str) -> list[Markup]:
    """Interval with caps at its ends, and arrows where it goes on beyond the scale."""
    low, high = ends
    left, right = _across(scale, low), _across(scale, high)
    positions = {"x1": f"{left:.1f}", "y1": f"{y:.1f}", "x2": f"{right:.1f}", "y2": f"{y:.1f}"}
    pieces = [element("line", {**positions, "class": f"whisker {look}"})]
    for item, beyond, turn in ((left, low < scale.low, -1.0), (right, high > scale.high, 1.0)):
        path = f"M{item - 6 * turn:.1f} {y - 5:.1f}L{item:.1f} {y:.1f}L{item - 6 * turn:.1f} {y + 5:.1f}"
        path = path if beyond else f"M{item:.1f} {y - 5:.1f}L{item:.1f} {y + 5:.1f}"
        pieces.append(element("path", {"d": path, "class": f"whisker {look}"}))
    return pieces


def _point(x: float, y: float, look: str) -> Markup:
    """A shape for each verdict, so that colour is not alone, and a diamond for a whole."""
    shapes = {
        "whole": f"M{x - 7:.1f} {y:.1f}L{x:.1f} {y - 6:.1f}L{x + 7:.1f} {y:.1f}L{x:.1f} {y + 6:.1f}Z",
        "provisional": f"M{x - 4:.1f} {y - 4:.1f}h8v8h-8Z",
        "refused": f"M{x - 4:.1f} {y - 4:.1f}l8 8M{x + 4:.1f} {y - 4:.1f}l-8 8",
    }
    if look in shapes:
        return element("path", {"d": shapes[look], "class": f"point {look}"})
    return element("circle", {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": "4.5", "class": f"point {look}"})


# -- Picture --


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture."""

    title: str
    words: str
    drawn: Chart | Plot | Forest  # Series over time to zoom into, a drawing, or intervals side by side
    table: TableOf | None


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures that belong together: those over time share their axis."""

    heading: str  # May be empty
    pictures: tuple[Picture, ...]
