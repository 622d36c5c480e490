"""Figures of signals, studies and noises: what is on their axes, and that all of it is on the page."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

from eivor.errors import MissingChannelError, NonFiniteError, UsageError
from eivor.lab.experiments import VerticalExperiment
from eivor.lab.figures import histogram_figure, nrmse_figure, signal_figure, study_figure
from eivor.lab.paper import EXAMPLES, named_readings, run_example
from eivor.lab.records import Scenario
from eivor.lab.study import MethodChoice, Spread, Study, StudyResult
from eivor.report.figures import axis_label, noise_spectrum_figure, signals_figure
from eivor.signals.noise import FractionalNoise, LongMemory
from eivor.signals.signals import Signals


def inside(figure: Figure) -> bool:
    """Whether every text lies on the page."""
    figure.draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    return all(
        b is None
        or (b.x0 > -1 and b.y0 > -1 and b.x1 < figure.bbox.width + 1 and b.y1 < figure.bbox.height + 1)
        for b in boxes
    )


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes if axes.get_legend() for text in axes.get_legend().texts]


# -- signals -----------------------------------------------------------------------------------------


def test_each_channel_has_a_panel_with_its_unit():
    channels = {name: np.linspace(0.0, 1.0, 20) for name in ("input", "velocity_z", "specific_force_z")}
    figure = signals_figure(Signals(5.0, channels, start_s=3.0), title="$a_b")
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "input u [-]",
        "velocity z' [m/s]",
        "specific force z'' + g [m/s²]",
    ]
    assert figure.axes[-1].get_xlabel() == "time t [s]"
    assert figure.axes[0].lines[0].get_xdata()[0] == 3.0
    assert inside(figure)


def test_what_is_not_valid_is_a_gap_and_truth_is_drawn_too():
    values = np.arange(10.0)
    valid = np.arange(10) != 4
    measured = Signals(5.0, {"velocity_z": values}, valid=valid)
    figure = signals_figure(measured, truth=Signals(5.0, {"velocity_z": values}))
    drawn = figure.axes[0].lines[0].get_ydata()
    assert np.isnan(drawn[4])
    assert not np.isnan(np.delete(drawn, 4)).any()
    assert labels(figure) == ["measured", "without noise"]


def test_a_channel_that_is_not_there_is_told():
    signals = Signals(5.0, {"input": np.zeros(4)})
    with pytest.raises(MissingChannelError, match="velocity_z"):
        signals_figure(signals, ("velocity_z",))


def test_unknown_channels_keep_their_names():
    assert axis_label("odd\nname") == "odd\\nname [-]"


# -- histograms --------------------------------------------------------------------------------------


def test_bars_hold_every_trial():
    values = np.random.default_rng(0).exponential(size=200)
    figure = nrmse_figure({"a": {"viscous_friction": values, "together": values[:50]}})
    for axes, count in zip(figure.axes, (200, 50), strict=True):
        assert sum(patch.get_height() for patch in axes.patches) == count
    assert figure.axes[0].get_xlabel() == "NRMSE of K [%]"
    assert figure.axes[1].get_xlabel() == "NRMSE of all parameters [%]"
    assert figure.axes[0].get_ylabel() == "a\ntrials [count]"
    assert inside(figure)


def test_a_long_tail_is_logarithmic_and_loses_no_trial():
    values = np.concatenate([np.full(50, 1.0), [1e-9, 500.0]])
    axes = nrmse_figure({"a": {"together": values}}).axes[0]
    assert axes.get_xscale() == "log"
    assert sum(patch.get_height() for patch in axes.patches) == 52


@pytest.mark.parametrize("values", [np.full(5, 2.0), np.zeros(3), np.array([7.0])])
def test_equal_values_are_drawn(values):
    axes = nrmse_figure({"a": {"together": values}}).axes[0]
    assert sum(patch.get_height() for patch in axes.patches) == values.size


def test_what_is_printed_is_drawn_when_it_is_near_and_told_when_it_is_not():
    values = np.linspace(1.0, 2.0, 20)
    for mean, drawn in ((2.5, True), (187.2, False)):
        figure = nrmse_figure({"a": {"together": values}}, printed={"a": {"together": Spread(mean, 0.5)}})
        assert any("off this axis" in label for label in labels(figure)) is not drawn
        low, high = figure.axes[0].get_xlim()
        assert bool(low < mean < high) is drawn


def test_no_estimate_is_said():
    figure = nrmse_figure({"a": {"together": np.full(4, np.nan)}})
    assert "no estimate" in figure.axes[0].texts[0].get_text()
    with pytest.raises(UsageError, match="scores to draw"):
        nrmse_figure({})


@pytest.mark.thorough
def test_a_study_has_a_row_for_each_method(tmp_path):
    study = Study(
        "a study",
        VerticalExperiment(Scenario(0.293, 0.021)),
        (MethodChoice("least_squares"), MethodChoice("generalized_iv", lags=(0, 3))),
        runs=3,
    )
    columns: dict[str, list[int] | list[float] | list[str]] = {"trial": [0, 1, 2]}
    for label in ("least_squares", "generalized_iv"):
        columns[f"{label}.status"] = ["identified", "failed", "weak"]
        columns[f"{label}.viscous_friction"] = [0.3, float("nan"), 0.28]
        columns[f"{label}.input_gain"] = [0.02, float("nan"), 0.022]
    figure = study_figure(StudyResult(study, tmp_path, pl.DataFrame(columns)))
    assert len(figure.axes) == 6
    assert figure.get_suptitle() == "a study: 3 trials"
    assert all(sum(patch.get_height() for patch in axes.patches) == 2 for axes in figure.axes)
    assert inside(figure)


# -- noises ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [pytest.param(-0.5, marks=pytest.mark.thorough), -0.4, 0.0, 0.3])
def test_the_fitted_line_lies_on_the_bands(order):
    values = FractionalNoise(0.2, order).sample(20_000, np.random.default_rng(2))
    figure = noise_spectrum_figure(values, rate_hz=50.0, unit="m/s²", title="accelerometer")
    axes = figure.axes[0]
    bands, fitted = axes.lines[1], axes.lines[3]
    index = np.interp(np.log(bands.get_xdata()), np.log(fitted.get_xdata()), np.log(fitted.get_ydata()))
    inner = (bands.get_xdata() < fitted.get_xdata()[-1]) & (bands.get_xdata() > 200.0 * fitted.get_xdata()[0])
    assert np.abs(np.log(bands.get_ydata()) - index)[inner].max() < 0.25
    assert axes.get_ylabel() == "amplitude density [m/s² per √Hz]"
    assert axes.get_xlabel() == "frequency [Hz]"
    assert inside(figure)


def test_density_integrates_to_the_variance():
    values = np.random.default_rng(3).standard_normal(4096)
    periodogram = noise_spectrum_figure(values, rate_hz=10.0).axes[0].lines[0]
    frequency, amplitude = periodogram.get_xdata(), periodogram.get_ydata()
    assert np.sum(amplitude**2) * (frequency[1] - frequency[0]) == pytest.approx(values.var(), rel=1e-2)


def test_an_estimate_of_ones_own_is_drawn():
    long_memory = LongMemory(order=-0.2, order_error=0.01, std=1.0, std_error=0.1, bandwidth=20)
    figure = noise_spectrum_figure(np.arange(100.0) % 7, rate_hz=1.0, estimate=long_memory)
    assert any("order -0.200 ± 0.010" in label for label in labels(figure))
    with pytest.raises(NonFiniteError, match="positive rate"):
        noise_spectrum_figure(np.arange(100.0), rate_hz=0.0)


# -- the paper's -------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_counterparts_of_the_papers_figures():
    reading = named_readings(("height-central",))[0]
    signals = signal_figure(reading)
    assert [axes.get_ylabel() for axes in signals.axes] == ["input u [-]", "height z [m]"]
    assert signals.axes[0].lines[0].get_xdata()[-1] == pytest.approx(799.8)
    histogram = histogram_figure(run_example(reading, EXAMPLES[0], 4), "IV")
    assert [axes.get_xlabel() for axes in histogram.axes] == [
        "NRMSE of K [%]",
        "NRMSE of K_u [%]",
        "NRMSE of all parameters [%]",
    ]
    assert inside(signals)
    assert inside(histogram)
