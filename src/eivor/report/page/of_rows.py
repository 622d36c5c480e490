"""Pictures of several flights or methods side by side, and of predictions ahead."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import cycle

import numpy as np

from eivor.flights.ahead import Ahead
from eivor.report.ahead_parts import shown_in
from eivor.report.page.forest import Forest, ForestRow
from eivor.report.page.picture import Picture, Pictures
from eivor.report.page.plot import Curve, Dots, Mark, Plot
from eivor.report.page.scale import Linear, margined
from eivor.report.told import ToldFlight, ToldQuantity, ToldRow

LOOKS = ("predicted", "second", "third", "fourth")


def forests(told: ToldFlight, rows: tuple[ToldRow, ...], whole: str) -> Pictures:
    """Forest of each quantity that the rows have; below them the result itself, named `whole`, if any."""
    pictures = []
    for one in told.reported:
        if one.name not in told.rows:
            continue
        beside = [
            _row(row.label, found) for row in rows for found in row.quantities if found.name == one.name
        ]
        if whole:
            beside.append(_row(whole, one, whole=True))
        wording = one.wording
        axis = f"{wording.words} {wording.symbol} [{wording.shown_unit or '-'}]"
        title = f"{wording.words[0].upper()}{wording.words[1:]}"
        pictures.append(Picture(title, "", Forest(axis, tuple(beside)), None))
    return Pictures("", tuple(pictures))


def _row(label: str, told: ToldQuantity, *, whole: bool = False) -> ForestRow:
    quantity, scale = told.quantity, told.wording.scale
    low, high = (end * scale for end in quantity.interval)
    known = math.isfinite(quantity.value) and not (math.isnan(low) or math.isnan(high))
    pieces = ((low, high),) if known else ()
    numbers = " ".join(dict.fromkeys(told.shown))
    return ForestRow(label, numbers, quantity.value * scale, pieces, quantity.verdict, whole)


def pictures_ahead(ahead: Ahead) -> Pictures:
    """Errors by horizon, of every quantity."""
    return Pictures("", tuple(_by_horizon(ahead)))


def _by_horizon(ahead: Ahead) -> Iterator[Picture]:
    horizons = np.array(ahead.horizons_s)
    for models in ahead.by_quantity:
        unit, times = shown_in(models[0].unit)
        quantity = models[0].quantity
        marks: list[Mark] = []
        every = [0.0]
        for one, look in zip(models, cycle(LOOKS), strict=False):
            errors = times * np.array(one.rms)
            marks += [Curve(one.words, look, horizons, errors), Dots("", look, horizons, errors)]
            every += errors.tolist()
        x = margined("predicted so far ahead [s]", horizons)
        y = Linear(f"RMS error [{unit}]", 0.0, 1.08 * max(every) or 1.0)
        title = f"Error of {quantity} by horizon"
        yield Picture(title, "", Plot(x, y, tuple(marks)), None)
