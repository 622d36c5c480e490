"""Figures of flights and of arrays."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure
from scipy.signal import lfilter

import eivor as ev
from eivor.errors import EstimationError, InputError, NonFiniteError, TooFewSamplesError, UsageError
from eivor.estimation.methods import least_squares
from eivor.lab.experiments import VerticalExperiment
from eivor.lab.figures import coverage_figure, nrmse_figure, study_figures
from eivor.lab.study import MethodChoice, Share, Spread, Study, StudyResult
from eivor.motions.vertical.motion import Vertical
from eivor.report.figure_panels import PlottedInterval, draw_forest, estimates_figure, pair_figure
from eivor.report.figures import residual_figure, save_figure, signals_figure
from eivor.report.flight_figures import fit_pictures, flight_figure
from refusal_rows import calls, rows, table


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
    assert "not identified" not in figure.get_suptitle()
    assert inside(figure)


def test_an_ellipse_ends_where_its_quantities_do(fit):
    """Of lag and delay it reached below zero, where neither is."""
    (picture,) = [
        item for item in fit_pictures(fit, fit.fit) if item.title == "Actuator lag and delay together"
    ]
    axes = Figure().add_subplot()
    picture.on(axes)
    assert axes.get_ylim()[0] == 0.0


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


NOISE = np.random.default_rng(0).normal(size=400)


@cache
def replicates():
    """A bootstrap of two parameters."""
    rows = ev.regression(
        response=NOISE, regressors=np.column_stack([np.roll(NOISE, 1), np.roll(NOISE, 2)]), names=("a", "b")
    )
    return ev.bootstrap(rows, least_squares(), runs=40)


def signals():
    return ev.Signals(5.0, {name: np.linspace(0.0, 1.0, 20) for name in ("input", "velocity_z")})


FIGURES: dict[str, Callable[[ev.FlightEstimate], Figure]] = {
    "plot": lambda fit: fit.plot(),
    "pair": lambda fit: pair_figure(fit.estimate, "viscous_friction", "input_gain", title="$a_b"),
    "residual": lambda _: residual_figure(NOISE, rate_hz=5.0, title="$a_b"),
    "signals": lambda _: signals_figure(signals(), title="$a_b"),
    "estimates": lambda _: estimates_figure({"by bootstrap": replicates()}, title="$a_b"),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", FIGURES)
def test_every_panel_is_drawn_and_says_what_its_axes_are(name, fit):
    figure = FIGURES[name](fit)
    assert all(axes.lines or axes.patches or axes.collections for axes in figure.axes)
    assert all(axes.get_ylabel() or axes.texts for axes in figure.axes)
    assert all(axes.get_xlabel() for axes in figure.axes)
    assert ("$a_b" in figure._suptitle.get_text()) == (name != "plot")  # type: ignore[attr-defined]
    assert inside(figure)


def test_without_an_estimate_the_flight_is_drawn_by_its_names(still):
    figure = flight_figure(still)
    assert "climb rate\n[m/s]" in [axes.get_ylabel() for axes in figure.axes]
    assert "The input is constant" in " ".join(figure.axes[-1].texts[0].get_text().split())
    assert inside(figure)


# Figures of intervals, ellipses, residuals, signals, noises and studies.

TRUTH = {"viscous_friction": 0.3, "input_gain": 0.8}


def words(figure):
    return [text.get_text() for axes in figure.axes if axes.get_legend() for text in axes.get_legend().texts]


@pytest.fixture(scope="module")
def estimate():
    random, count = np.random.default_rng(1), 600
    u = lfilter([0.3], [1.0, -0.9], random.normal(size=count))
    v = lfilter([0.2], [1.0, -0.95], u)
    force = 0.8 * u - 0.3 * v + lfilter([0.1], [1.0, -0.7], random.normal(size=count))
    channels = {"velocity_z": v, "specific_force_z": force, "input": u}
    problem = ev.VerticalMotion(intercept=False).regression(ev.Signals(5.0, channels))
    return ev.identify(problem, ev.methods.least_squares())


def test_each_parameter_has_a_panel_with_its_unit_and_the_truth(estimate):
    rows = estimate.rows
    replicates = ev.bootstrap(rows, ev.methods.least_squares(), runs=40)
    figure = estimates_figure({"least squares": estimate, "its bootstrap": replicates}, truth=TRUTH)
    assert [axes.get_xlabel() for axes in figure.axes] == [
        "viscous friction K [1/s]",
        "input gain K_u [m/s²]",
    ]
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert list(filter(None, texts)) == ["least squares", "its bootstrap"]
    assert figure.axes[1].lines[-1].get_xdata()[0] == 0.8
    ends = {x for line in figure.axes[0].lines for x in line.get_xdata()}
    assert set(estimate.interval("viscous_friction")) <= ends
    assert set(replicates.interval("viscous_friction")) <= ends
    assert inside(figure)


def test_ends_without_bound_are_arrows():
    rows = [
        PlottedInterval("$both_", 0.3, ((-math.inf, math.inf),)),
        PlottedInterval("bounded", 0.3, ((0.2, 0.4),)),
        PlottedInterval("none", math.nan, ()),
    ]
    axes = Figure(layout="constrained").add_subplot()
    draw_forest(axes, rows, "a_b [m]")
    markers = [line.get_marker() for line in axes.lines]
    assert markers.count("<") == 1
    assert markers.count(">") == 1
    assert axes.get_xlabel() == "a_b [m]"


def test_a_pair_has_its_ellipse_its_intervals_the_truth_and_a_cloud(estimate):
    replicates = ev.bootstrap(estimate.rows, ev.methods.least_squares(), runs=40)
    figure = pair_figure(estimate, "viscous_friction", "input_gain", truth=TRUTH, replicates=replicates)
    axes = figure.axes[0]
    assert axes.get_xlabel() == "viscous friction K [1/s]"
    assert axes.get_ylabel() == "input gain K_u [m/s²]"
    assert words(figure) == ["40 replicates", "joint 95 % ellipse", "intervals one by one", "truth"]
    outline = estimate.ellipse("viscous_friction", "input_gain").outline()
    np.testing.assert_array_equal(axes.lines[1].get_xydata(), outline)
    assert inside(figure)


def test_coverage_has_a_line_for_each_group_and_a_colour_for_each_label():
    hits = {"one": 950, "two": 700}
    shares = {label: dict.fromkeys(("a: K", "b: K"), Share(count, 1000)) for label, count in hits.items()}
    figure = coverage_figure(shares | {"never run": {"a: K": Share(0, 0)}}, title="N = 500")
    axes = figure.axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["a: K", "b: K"]
    assert [text.get_text() for text in figure.legends[0].texts] == ["nominal, 95 %", "one", "two"]
    first, second = axes.containers
    assert first.lines[0].get_xdata().tolist() == [95.0, 95.0]
    assert second.lines[0].get_xdata().tolist() == [70.0, 70.0]
    spans = second.lines[2][0].get_segments()
    assert spans[0][:, 0] == pytest.approx([67.1, 72.8], abs=0.1)  # Wilson's
    assert axes.get_xlim()[0] < 67.0
    assert inside(figure)


def finished(folder, level):
    experiment = VerticalExperiment(ev.Scenario(0.3, 0.8))
    choices = (MethodChoice("least_squares"), MethodChoice("generalized_iv", lags=(0, 3)))
    study = Study("one", experiment, choices, runs=3, intervals=True, level=level)
    columns: dict[str, list[int] | list[float] | list[str]] = {"trial": [0, 1, 2]}
    for label in ("least_squares", "generalized_iv"):
        columns[f"{label}.status"] = ["identified", "failed", "weak"]
        for parameter, truth in TRUTH.items():
            columns[f"{label}.{parameter}"] = [truth, math.nan, truth]
            columns[f"{label}.{parameter}.low"] = [truth - 0.1, math.nan, truth + 0.1]
            columns[f"{label}.{parameter}.high"] = [truth + 0.1, math.nan, truth + 0.2]
    return StudyResult(study, folder, pl.DataFrame(columns))


def test_studies_show_each_parameter_with_its_methods_side_by_side(tmp_path):
    alone = dict(study_figures(finished(tmp_path, level=0.9)))["coverage"]
    assert [text.get_text() for text in alone.axes[0].get_yticklabels()] == ["K", "K_u"]
    assert next(text.get_text() for text in alone.legends[0].texts) == "nominal, 90 %"
    assert alone.axes[0].containers[0].lines[0].get_xdata().tolist() == [50.0, 50.0]
    assert inside(alone)


def test_each_channel_has_a_panel_with_its_unit():
    channels = {name: np.linspace(0.0, 1.0, 20) for name in ("input", "velocity_z", "specific_force_z")}
    figure = signals_figure(ev.Signals(5.0, channels, start_s=3.0), title="$a_b")
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "input u [-]",
        "velocity z' [m/s]",
        "specific force z'' + g [m/s²]",
    ]
    assert (figure.axes[-1].get_xlabel(), figure.axes[0].lines[0].get_xdata()[0]) == ("time t [s]", 3.0)
    assert inside(figure)


def test_what_is_not_valid_is_a_gap():
    valid = np.arange(10) != 4
    figure = signals_figure(ev.Signals(5.0, {"velocity_z": np.arange(10.0)}, valid=valid))
    drawn = figure.axes[0].lines[0].get_ydata()
    assert np.isnan(drawn[4])
    assert not np.isnan(np.delete(drawn, 4)).any()


def test_what_is_printed_is_drawn_when_it_is_near_and_told_when_it_is_not():
    values = np.linspace(1.0, 2.0, 20)
    for mean, drawn in ((2.5, True), (187.2, False)):
        figure = nrmse_figure({"a": {"together": values}}, printed={"a": {"together": Spread(mean, 0.5)}})
        assert any("off this axis" in label for label in words(figure)) is not drawn
        low, high = figure.axes[0].get_xlim()
        assert bool(low < mean < high) is drawn


def test_no_estimate_is_said():
    figure = nrmse_figure({"a": {"together": np.full(4, np.nan)}})
    assert "no estimate" in figure.axes[0].texts[0].get_text()


def test_long_residuals_are_drawn_by_their_range():
    figure = residual_figure(np.random.default_rng(3).normal(size=100_000), rate_hz=100.0)
    assert len(figure.axes[0].lines) == 1  # zero; the range is an area
    assert figure.axes[0].collections


def test_a_long_tail_is_logarithmic_and_loses_no_trial():
    values = np.concatenate([np.full(50, 1.0), [1e-9, 500.0]])
    axes = nrmse_figure({"a": {"together": values}}).axes[0]
    assert axes.get_xscale() == "log"
    assert sum(patch.get_height() for patch in axes.patches) == 52


def saved(result, tmp_path):
    (tmp_path / "fit.json").write_text(result if isinstance(result, str) else result.to_json())
    return ev.load_fit(tmp_path / "fit.json")


def without_commands(log):
    return replace(log, channels={name: x for name, x in log.channels.items() if "command" not in name})


NO_FITS = "", "[1]", "{}", '{"schema": "eivor.inspect/1"}', '{"schema": "eivor.identify/1"}', "[" * 100_000
test_refused = table(
    rows("file", InputError, saved,
        *((text, r"of schema eivor\.identify/1 or eivor\.identify/2 in fit\.json") for text in NO_FITS)),
    rows("choices", UsageError, lambda choices, recording: ev.identify_flight(recording, **choices),
        ({"options": ev.FlightOptions(method="least_squares"), "method": "reference_iv"},
            "each choice once; received method in options= and by name"),
        ({"windw": (1.0, 2.0)}, "Did you mean 'window'"),
        ({"window": (1.0, 2.0), "windows": [None]}, "Give either window= or windows="),
    ),
    rows("interval", UsageError, lambda words, fit, tmp_path: saved(fit, tmp_path).interval(*words),
        (("friction",), "a quantity out of viscous_friction"),
        (("hover_input", 0.9), "or of the joint vector"),
    ),
    calls("call", None,
        (lambda: estimates_figure({}), UsageError, "intervals to draw"),
        (lambda: residual_figure(np.array([1.0, math.nan] * 20), rate_hz=5.0), NonFiniteError, "Expected"),
        (lambda: residual_figure(np.ones(100), rate_hz=0.0), NonFiniteError, "Expected"),
        (lambda: residual_figure(np.ones(9), rate_hz=5.0), TooFewSamplesError, "Expected"),
        (lambda: coverage_figure({"one": {"a": Share(0, 0)}}), UsageError, "that were counted"),
        (lambda: nrmse_figure({}), UsageError, "scores to draw"),
        (lambda still: still.plot(), EstimationError, ""),
        (lambda: ev.load_fit("absent.json"), InputError, "a result that can be read"),
        (lambda: ev.load_fit(3), UsageError, "the path of a JSON file"),
        (lambda still, tmp_path: saved(still, tmp_path).covariance, EstimationError, "one without"),
        (lambda still, recording: ev.validate(still, recording=recording), UsageError,
            "a result with an estimate"),
        (lambda fit, recording: ev.validate(fit, recording, window=(10.0, 11.0)), InputError,
            "three seconds in the air"),
        (lambda fit, recording: ev.validate(fit, without_commands(recording)), InputError,
            "the input of the fit.*; received a log without it"),
    ),
)  # fmt: skip
