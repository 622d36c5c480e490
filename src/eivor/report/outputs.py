"""Outputs of a flight's result: JSON, the saved fit that exports read, and the figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from eivor.checks import described
from eivor.errors import UsageError
from eivor.flights.result import FlightEstimate, LogEstimate
from eivor.report.flight import result_card
from eivor.report.flight_figures import flight_figure
from eivor.report.html import asset, rendered
from eivor.report.json_document import json_document, json_text, log_document
from eivor.report.saved_fit import SavedFit, fit_among, fit_of, load_fits


def saved_fit(result: FlightEstimate) -> SavedFit:
    """Return what `eivor.load_fit` would read of a result's document."""
    return fit_of(json_document(result))


def saved_of(source: object, expected: str, remedy: str, preferred: Sequence[str] = ()) -> SavedFit:
    """Saved result of a motion's or a log's result, of one, or of the path of its file."""
    if isinstance(source, FlightEstimate):
        return saved_fit(source)
    if isinstance(source, LogEstimate):
        fits = {name: saved_fit(result) for name, result in source.motions.items()}
        return fit_among(fits, preferred=preferred)
    if isinstance(source, str | Path):
        return fit_among(load_fits(source), preferred=preferred)
    if not isinstance(source, SavedFit):
        raise UsageError(expected, described(source), remedy)
    return source


class FlightOutputs:
    """What a flight's result asks for; an entry point registers it."""

    saved, figure = staticmethod(saved_fit), staticmethod(flight_figure)

    def json(self, result: FlightEstimate | LogEstimate) -> str:
        made = log_document(result) if isinstance(result, LogEstimate) else json_document(result)
        return json_text(made)

    def card(self, results: Sequence[FlightEstimate]) -> str:
        """HTML of the report's card, for notebooks: with the style of a page in it, and no buttons."""
        style = Markup(asset("page.css").replace(":root", "&"))  # noqa: S704 - the package's own file
        return str(rendered("notebook.html", style=style, card=result_card(results)))


FLIGHT = FlightOutputs()
