"""The verdict of a report and its numbers as they are shown, for a page that shows several reports."""

from __future__ import annotations

import math

from eivor.inference.verdict import Status
from eivor.report.document import Document
from eivor.report.printable import printable
from eivor.report.told import ToldFlight, ToldQuantity


def more_said(told: ToldFlight) -> tuple[str, ...]:
    """What is said below the verdict: what is told and what is not, or the first ground against it."""
    if told.summary:
        return (told.summary,)
    if told.verdict.status is Status.IDENTIFIED or not told.reasons:
        return ()
    return (told.reasons[0].sentence,)


def verdict_data(document: Document, told: ToldFlight) -> dict[str, object]:
    """The verdict, what is said of it, and the quantities that it is about.

    Parameters
    ----------
    document : Document
        Of the result.
    told : ToldFlight
        What it was made of.
    """
    return {
        "status": told.verdict.status.value,
        "about": printable(document.about),
        "more": [printable(one) for one in more_said(told)],
        "logs": [printable(one) for one in told.logs],
        "readings": [_reading(one) for one in told.brief],
    }


def _reading(told: ToldQuantity) -> dict[str, object]:
    """A quantity in its shown unit: as it is written, and as numbers to draw; null for no bound."""
    wording, quantity = told.wording, told.quantity
    value, interval = told.shown
    at, low, high = (one * wording.scale for one in (quantity.value, *quantity.interval))
    return {
        "name": told.name,
        "words": wording.words,
        "symbol": wording.symbol,
        "unit": wording.shown_unit,
        "shown": [value, interval],
        "status": quantity.verdict.value,
        "at": at if math.isfinite(at) else None,
        "interval": [end if math.isfinite(end) else None for end in (low, high)],
    }
