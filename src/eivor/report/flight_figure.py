"""The figure of a flight's result: what was measured, what the model says, and what the verdict rests on.

Panels: for each axis of the motion measured against predicted response, and the residual below it; the
residual's autocorrelation; for each continuous nuisance the objective against it; what excites the vehicle,
by frequency. Matplotlib's object interface only: nothing here touches the global state of pyplot. Text is
never parsed for mathematics, so that a log's name cannot be taken for a formula.
"""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from eivor.flights.result import Fit, FlightEstimate
from eivor.inference.verdict import Status
from eivor.report.figure_without_estimate import flight_panels, page_without_estimate
from eivor.report.fit_numbers import flight_runs
from eivor.report.fit_panels import draw_autocorrelation, draw_excitation, draw_fit, draw_residual
from eivor.report.given_axes import GivenAxes, figure_of, given_axes
from eivor.report.plain_figure import Panels, page, without_abscissa
from eivor.report.printable import printable, short_name
from eivor.report.profile_panels import draw_no_profile, draw_profile
from eivor.report.wording import NO_NUMBER, numbers
from eivor.whole_file import whole_file

SIZE_INCHES = (11.0, 8.5)
#: What each further axis adds to the height.
AXIS_INCHES = 4.0
#: So many panels stand side by side in that width; more of them make it wider.
LEAST_BESIDE = 3
TITLE_COLOURS = {
    Status.IDENTIFIED: "#1b7f3b",
    Status.WEAK: "#a06a00",
    Status.PROVISIONAL: "#7b3f9e",
    Status.REFUSED: "#b3261e",
}


def flight_figure(result: FlightEstimate, axes: GivenAxes | None = None) -> Figure:
    """Figure of a result; without an estimate it shows the flight itself and says why.

    Parameters
    ----------
    result : FlightEstimate
        Of one flight or of a pool.
    axes : mapping of str to Axes, or sequence of Axes, optional
        Where to draw: some panels by name, or all in order, see the notes. Default: a figure of its
        own, with the verdict above.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own, or that of `axes`; save it with `save_figure` or `Figure.savefig`.

    Raises
    ------
    UsageError
        When `axes` do not fit the panels.

    Notes
    -----
    Panels are "fit", "residual", "autocorrelation", "profile" and "excitation". A motion of several axes has
    "fit of AXIS" and "residual of AXIS" for each; with several continuous nuisances there is a "profile of
    NAME" for each. Without an estimate they are what the motion looks at, "input" and "reasons".
    """
    panels = flight_panels(result) if result.fit is None else _panels(result, result.fit)
    if axes is not None:
        placed = given_axes(axes, tuple(panels))
    else:
        placed = (page_without_estimate if result.fit is None else _page)(tuple(panels))
    for name, panel in placed.items():
        panels[name](panel)
    figure = figure_of(*placed.values())
    if axes is None:
        _title(figure, result)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF, told by the ending; whole, and the same result gives the same bytes.

    Raises
    ------
    OSError
        When the file cannot be written.
    """
    kind = path.suffix.lower().lstrip(".")
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with warnings.catch_warnings():
        # a log's name may hold letters that the font does not have; they become boxes
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        with whole_file(path) as file:
            figure.savefig(file, format=kind, metadata=metadata)


def _panels(result: FlightEstimate, fit: Fit) -> Panels:
    """Panels of an estimate, in order; where there are several of a kind, they say what they are of."""
    estimate, runs = fit.estimate, flight_runs(result)
    traces = fit.traces(result.motion)
    panels: Panels = {}
    for trace in traces:
        of_axis = f" of {trace.axis}" if len(traces) > 1 else ""
        panels[f"fit{of_axis}"] = partial(draw_fit, trace=trace, runs=runs)
        panels[f"residual{of_axis}"] = partial(draw_residual, trace=trace, runs=runs)
    panels["autocorrelation"] = partial(draw_autocorrelation, best=estimate.best, runs=runs)
    profiles = estimate.best.profiles
    for number, profile in enumerate(profiles):
        of_nuisance = f" of {profile.nuisance.name}" if len(profiles) > 1 else ""
        panels[f"profile{of_nuisance}"] = partial(
            draw_profile, result=result, estimate=estimate, number=number
        )
    if not profiles:
        panels["profile"] = partial(draw_no_profile, result=result)
    panels["excitation"] = partial(draw_excitation, traces=traces, runs=runs)
    return panels


def _page(names: tuple[str, ...]) -> dict[str, Axes]:
    """Fits and residuals over the whole width, one below the other; the rest side by side below them."""
    wide = [name for name in names if name.startswith(("fit", "residual"))]
    beside = [name for name in names if name not in wide]
    width, height = SIZE_INCHES
    figure = page(width * max(len(beside) / LEAST_BESIDE, 1.0), height + AXIS_INCHES * (len(wide) // 2 - 1))
    grid = GridSpec(
        len(wide) + 1, len(beside), figure=figure, height_ratios=(*(2.0, 0.9) * (len(wide) // 2), 2.2)
    )
    placed: dict[str, Axes] = {}
    for row, (fit, residual) in enumerate(zip(wide[::2], wide[1::2], strict=True)):
        placed[fit] = figure.add_subplot(grid[2 * row, :])
        placed[residual] = figure.add_subplot(grid[2 * row + 1, :], sharex=placed[fit])
        without_abscissa(placed[fit])
    return placed | {name: figure.add_subplot(grid[-1, place]) for place, name in enumerate(beside)}


def _title(figure: Figure, result: FlightEstimate) -> None:
    names = [printable(flight.recording.name) for flight in result.prepared]
    shown = short_name(names[0])
    if len(names) > 1:
        shown = f"{len(names)} flights: {shown}, …"
    parts = []
    for name in result.motion.rows:
        wording = result.motion.wording[name]
        value, interval = numbers(result.quantities[name], wording)
        if value != NO_NUMBER:
            bounds = "" if interval == NO_NUMBER else f" {interval}"
            parts.append(f"{wording.words} {value}{bounds} {wording.shown_unit}".rstrip())
    lines = [f"{shown} — {result.verdict.status.value}", "; ".join(parts[:2]), "; ".join(parts[2:])]
    figure.suptitle(
        "\n".join(line for line in lines if line),
        fontsize=11,
        color=TITLE_COLOURS[result.verdict.status],
        parse_math=False,
    )
