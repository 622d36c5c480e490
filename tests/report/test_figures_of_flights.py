"""Figures of flights, and figures drawn into Axes that the caller made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import eivor as ev
import shape_checks
from eivor.errors import EstimationError, UsageError
from eivor.estimation.methods import least_squares
from eivor.motions.vertical.motion import Vertical
from eivor.report.figure_panels import estimates_figure, pair_figure
from eivor.report.figures import residual_figure, save_figure, signals_figure
from eivor.report.flight_figures import flight_figure


def _titles(figure):
    return [axes.get_title() for axes in figure.axes]


def inside(figure):
    """Whether every text lies on the page."""
    figure.draw_without_rendering()
    width, height = figure.bbox.width, figure.bbox.height
    boxes = [figure._suptitle.get_window_extent()] if figure._suptitle else []  # type: ignore[attr-defined]
    boxes += [axes.get_tightbbox() for axes in figure.axes]
    return all(
        b.x0 > -1 and b.y0 > -1 and b.x1 < width + 1 and b.y1 < height + 1 for b in boxes if b is not None
    )


def test_a_flight_has_its_panels(fit):
    figure = flight_figure(fit)
    titles = _titles(figure)
    assert titles[0].startswith("Measured and predicted, both band-passed 0.0")
    assert titles[2:] == [
        "Autocorrelation of the whitened residual",
        "How well each actuator lag fits",
        "How well each delay fits",
        "Excitation",
    ]
    assert "identified" in figure.get_suptitle()
    assert inside(figure)


@dataclass(frozen=True)
class TwoAxes(Vertical):
    """A motion that has two axes to draw."""

    def traces(self, problem, estimate):
        (up,) = super().traces(problem, estimate)
        return up, replace(up, axis="forward acceleration", measured=-up.measured, band_hz=(0.05, 3.0))


@pytest.mark.thorough
def test_every_axis_of_a_motion_is_drawn(fit):
    figure = flight_figure(replace(fit, motion=TwoAxes()))
    assert [axes.get_ylabel().split("\n")[0] for axes in figure.axes[:4]] == [
        "vertical acceleration",
        "residual",
        "forward acceleration",
        "residual",
    ]
    assert "to 5 Hz" in _titles(figure)[0]
    assert any("0.05 to 3 Hz" in title for title in _titles(figure))  # an axis with a band of its own
    assert len(figure.axes[-1].lines) == 4
    assert inside(figure)


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_a_hostile_name_is_drawn_as_it_is(fit, tmp_path, ending):
    flight = fit.prepared[0]
    name = "$\\frac{1}{$ <b>&\x1b[31m\n 飛行 " + "x" * 200
    hostile = replace(fit, prepared=(replace(flight, recording=replace(flight.recording, name=name)),))
    figure = flight_figure(hostile)
    save_figure(figure, tmp_path / f"x.{ending}")
    assert (tmp_path / f"x.{ending}").stat().st_size > 10_000
    assert r"<b>&\x1b[31m\n" in _titles(figure)[0].replace("\n", " ")


FLIGHT = ("fit", "residual", "autocorrelation", "profile of actuator_lag", "profile of delay", "excitation")


NOISE = np.random.default_rng(0).normal(size=400)


def page(rows, columns=1):
    """A figure of the caller's, as ``plt.subplots`` makes it."""
    figure = Figure(figsize=(5.5 * columns, 3.6 * rows), layout="constrained")
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


def drawn(axes):
    return bool(axes.lines or axes.patches or axes.collections or axes.texts)


@cache
def replicates():
    """A bootstrap of two parameters."""
    rows = ev.regression(
        response=NOISE, regressors=np.column_stack([np.roll(NOISE, 1), np.roll(NOISE, 2)]), names=("a", "b")
    )
    return ev.bootstrap(rows, least_squares(), runs=40)


ONE_PANEL: dict[str, Callable[[Any, ev.FlightEstimate, Path], Figure]] = {
    "pair": lambda ax, fit, _folder: pair_figure(
        estimated(fit), "viscous_friction", "input_gain", title="noise", ax=ax
    )
}


def estimated(fit):
    assert fit.estimate is not None
    return fit.estimate


@pytest.mark.thorough
@pytest.mark.parametrize("name", ONE_PANEL)
def test_a_single_panel_is_drawn_where_it_is_told(name, fit, tmp_path):
    figure, (left, right) = page(1, 2)
    assert ONE_PANEL[name](right, fit, tmp_path) is figure
    assert drawn(right)
    assert not drawn(left)
    assert right.get_title() == "noise"
    assert right.get_legend() is not None
    assert figure._suptitle is None  # type: ignore[attr-defined]
    assert not figure.legends
    assert inside(figure)


def test_a_panel_of_a_subfigure_is_drawn_too():
    figure = Figure(layout="constrained")
    ax = figure.subfigures(1, 2)[1].add_subplot()
    assert residual_figure(NOISE, rate_hz=5.0, axes={"spectrum": ax}) is figure


def signals():
    return ev.Signals(5.0, {name: np.linspace(0.0, 1.0, 20) for name in ("input", "velocity_z")})


SEVERAL: dict[str, tuple[tuple[str, ...], Callable[[Any, ev.FlightEstimate, Path], Figure]]] = {
    "flight": (FLIGHT, lambda axes, fit, _folder: flight_figure(fit, axes)),
    "plot": (FLIGHT, lambda axes, fit, _folder: fit.plot(axes=axes)),
    "residual": (
        ("time", "autocorrelation", "spectrum"),
        lambda axes, _fit, _folder: residual_figure(NOISE, rate_hz=5.0, axes=axes),
    ),
    "signals": (("input", "velocity_z"), lambda axes, _fit, _folder: signals_figure(signals(), axes=axes)),
    "estimates": (
        ("a", "b"),
        lambda axes, _fit, _folder: estimates_figure({"by bootstrap": replicates()}, axes=axes),
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", SEVERAL)
def test_panels_are_drawn_in_order_or_by_name(name, fit, tmp_path):
    names, draw = SEVERAL[name]
    figure, axes = page(len(names))
    assert draw(np.array(axes), fit, tmp_path) is figure
    assert all(drawn(axis) for axis in axes)
    # every panel stands by itself: it says what both of its axes are
    assert all(axis.get_ylabel() or axis.get_yticklabels() for axis in axes)
    assert all(axis.get_xlabel() and axis.xaxis.label.get_visible() for axis in axes)
    assert inside(figure)
    neighbours, (left, right) = page(1, 2)
    assert draw({names[-1]: right}, fit, tmp_path) is neighbours
    assert drawn(right)
    assert not drawn(left)
    assert right.get_xlabel() == axes[-1].get_xlabel()
    assert neighbours._suptitle is None  # type: ignore[attr-defined]
    assert len(neighbours.axes) == 2
    assert inside(neighbours)


def test_axes_that_do_not_fit_are_refused():
    """Every figure of several panels takes its Axes through the same door."""
    figure, (item,) = page(1)
    _, (other,) = page(1)
    for wrong, expected in (
        (3, "as many as there are panels"),
        ("fit", "as many as there are panels"),
        (figure, "as many as there are panels"),
        ([], "2 Axes"),
        ([item] * 3, "received 3"),
        (item, "received 1"),
        ([item, 3], "Matplotlib Axes"),
        ({}, "Axes to draw into"),
        ({"input": 3}, "Matplotlib Axes"),
        ({"inputs": item}, "Did you mean"),
        ({3: item}, "Name some of"),
        ({"input": item, "velocity_z": other}, "of one figure"),
    ):
        with shape_checks.unchecked(), pytest.raises(UsageError, match=expected):
            signals_figure(signals(), axes=wrong)  # type: ignore[arg-type]
    assert not drawn(item)


def test_the_title_stands_above_the_first_panel_that_is_given():
    _, axes = page(3)
    residual_figure(NOISE, rate_hz=5.0, title="$a_b", axes=axes)
    assert [axis.get_title() for axis in axes] == ["$a_b", "", ""]


def test_without_an_estimate_the_flight_is_drawn_by_its_names(still):
    figure, axes = page(2)
    flight_figure(still, {"climb rate": axes[0], "reasons": axes[1]})
    assert axes[0].get_ylabel() == "climb rate\n[m/s]"
    assert "The input is constant" in " ".join(axes[1].texts[0].get_text().split())
    assert inside(figure)
    with pytest.raises(UsageError, match="height, climb rate, input, reasons"):
        flight_figure(still, {"zzz": axes[0]})
    with pytest.raises(EstimationError):
        still.plot(axes=axes)
