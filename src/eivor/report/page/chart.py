"""Series over time that a page can zoom into, packed so that an hour of flight still is a file to send.

Values are rounded to one part in 65,534 of their range, which no screen shows. Longer series than a page has
room for are drawn as the least and the greatest value of each of many short stretches.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from eivor.report.printable import printable
from eivor.shapes import Bool, Float, Int

#: Code of a value that is not there, and the largest of one that is.
MISSING, LARGEST = 65535, 65534
#: Samples further apart than so many steps are not joined by a line.
BROKEN_AFTER = 1.5


@dataclass(frozen=True)
class Line:
    """One series.

    Parameters
    ----------
    label : str
        What it is.
    look : str
        How it is drawn, a word of the page's style: "measured", "predicted", "residual", "asked".
    values : ndarray, shape (n,)
        Not a number where there is none.
    """

    label: str
    look: str
    values: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Chart:
    """Series over one time.

    Parameters
    ----------
    group : str
        Charts of one group are zoomed together.
    unit : str
        Of all lines.
    time_s : ndarray, shape (n,)
        Increasing [s].
    lines : tuple of Line
        With values at these times.
    over_s, view_s : tuple of float
        First and last second of the flight, and of what is shown at first [s].
    left_out_s : tuple of (float, float)
        Stretches of it that the estimate does not use.
    """

    group: str
    unit: str
    time_s: Float[np.ndarray, " n"]
    lines: tuple[Line, ...]
    over_s: tuple[float, float]
    view_s: tuple[float, float]
    left_out_s: tuple[tuple[float, float], ...]

    def packed(self, most: int) -> dict[str, object]:
        """Return it for the page's script, in about `most` samples."""
        values = np.stack([line.values for line in self.lines], axis=1)
        stretches, kept = _thinned(self.time_s, values, most)
        return {
            "group": self.group,
            "unit": printable(self.unit),
            "over": list(self.over_s),
            "view": list(self.view_s),
            "leftOut": [list(pair) for pair in self.left_out_s],
            "stretches": stretches,
            "lines": [
                {"label": printable(line.label), "look": line.look, **_coded(kept[:, place])}
                for place, line in enumerate(self.lines)
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
        return [[float(one), 0.0, 1] for one in time_s], values
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
