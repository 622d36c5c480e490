from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from eivor.estimation.estimate import Estimate
from eivor.flights.options import FlightOptions
from eivor.flights.quantity import Trace
from eivor.flights.result import FlightEstimate
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.regression import VerticalFlights
from eivor.report.figures import flight_figure, save_figure
from eivor.signals.recording import Recording


def _titles(figure: Figure) -> list[str]:
    return [axes.get_title() for axes in figure.axes]


def _inside(figure: Figure) -> bool:
    """Whether every text lies on the page."""
    figure.draw_without_rendering()
    width, height = figure.bbox.width, figure.bbox.height
    boxes = [figure._suptitle.get_window_extent()] if figure._suptitle else []  # type: ignore[attr-defined]
    boxes += [axes.get_tightbbox() for axes in figure.axes]
    return all(
        b.x0 > -1 and b.y0 > -1 and b.x1 < width + 1 and b.y1 < height + 1 for b in boxes if b is not None
    )


def test_a_flight_has_its_panels(fit: FlightEstimate) -> None:
    figure = flight_figure(fit)
    titles = _titles(figure)
    assert titles[0].startswith("Measured and predicted, both band-passed 0.0")
    assert titles[2:] == [
        "Autocorrelation of the whitened residual",
        "How well each actuator lag fits",
        "Excitation",
    ]
    assert "identified" in figure.get_suptitle()
    assert _inside(figure)


def test_every_axis_has_a_unit_or_is_a_number(fit: FlightEstimate) -> None:
    for axes in flight_figure(fit).axes:
        assert axes.get_ylabel()
        assert "[" in axes.get_ylabel() or axes.get_ylabel().startswith(("correlation", "objective"))


def test_the_prediction_drawn_is_close_for_a_good_fit(fit: FlightEstimate) -> None:
    measured, predicted = (np.asarray(line.get_ydata()) for line in flight_figure(fit).axes[0].lines[:2])
    assert np.std(measured - predicted) < 0.2 * np.std(measured)


def test_the_lag_profile_is_least_at_the_lag(fit: FlightEstimate) -> None:
    panel = flight_figure(fit).axes[3]
    curve = next(line for line in panel.lines if str(line.get_label()).startswith("delay"))
    fitting = fit.estimate.tenable() if fit.estimate is not None else ()
    assert {f"delay {1e3 * item.nuisances['delay']:g} ms" for item in fitting} <= {
        line.get_label() for line in panel.lines
    }
    lags, heights = np.asarray(curve.get_xdata()), np.asarray(curve.get_ydata())
    assert lags[np.argmin(heights)] == pytest.approx(1e3 * fit.quantities["actuator_lag"].value, rel=1e-3)
    assert heights.min() == pytest.approx(0.0, abs=1e-9)


@dataclass(frozen=True)
class TwoAxes(Vertical):
    """A motion that has two axes to draw."""

    def traces(self, problem: VerticalFlights, estimate: Estimate) -> tuple[Trace, ...]:
        (up,) = super().traces(problem, estimate)
        return up, replace(up, axis="forward acceleration", measured=-up.measured, band_hz=(0.05, 3.0))


@pytest.mark.thorough
def test_every_axis_of_a_motion_is_drawn(fit: FlightEstimate) -> None:
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
    assert _inside(figure)


@pytest.mark.thorough
@pytest.mark.long
def test_a_pool_says_which_run_is_drawn(pool: FlightEstimate) -> None:
    figure = flight_figure(pool)
    assert "the longest of 2 runs" in _titles(figure)[0]
    assert "2 flights" in figure.get_suptitle()
    assert _inside(figure)


@pytest.mark.thorough
def test_without_estimate_the_flight_itself_is_drawn(still: FlightEstimate) -> None:
    figure = flight_figure(still)
    assert "The input is constant" in figure.axes[-1].texts[0].get_text()
    assert "height [m]" in [axes.get_ylabel() for axes in figure.axes]
    assert _inside(figure)


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["least_squares", "total_least_squares", "extended_iv"])
def test_every_method_can_be_drawn(recording: Recording, method: str) -> None:
    result = identify_flight(recording, FlightOptions(window=(0.0, 20.0), method=method))
    assert _inside(flight_figure(result))


@pytest.mark.thorough
def test_measured_rotors_have_a_profile_of_their_delay(recording: Recording) -> None:
    channels = {
        name.replace("rotor_command", "rotor_speed"): replace(
            channel, name=channel.name.replace("rotor_command", "rotor_speed")
        )
        for name, channel in recording.channels.items()
    }
    figure = flight_figure(identify_flight(replace(recording, channels=channels)))
    labels = [axes.get_xlabel() for axes in figure.axes]
    assert any("delay" in label and "[ms]" in label for label in labels), labels
    assert _inside(figure)


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_a_hostile_name_is_drawn_as_it_is(fit: FlightEstimate, tmp_path: Path, ending: str) -> None:
    flight = fit.prepared[0]
    name = "$\\frac{1}{$ <b>&\x1b[31m\n 飛行 " + "x" * 200
    hostile = replace(fit, prepared=(replace(flight, recording=replace(flight.recording, name=name)),))
    figure = flight_figure(hostile)
    save_figure(figure, tmp_path / f"x.{ending}")
    assert (tmp_path / f"x.{ending}").stat().st_size > 10_000
    assert r"<b>&\x1b[31m\n" in _titles(figure)[0].replace("\n", " ")


@pytest.mark.thorough
def test_the_same_result_gives_the_same_bytes(fit: FlightEstimate, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        save_figure(flight_figure(fit), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.thorough
def test_pyplot_is_left_alone() -> None:
    code = "import sys, eivor.report.figures; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_plot_of_a_result_is_the_figure(fit: FlightEstimate) -> None:
    assert isinstance(fit.plot(), Figure)
