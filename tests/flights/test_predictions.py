"""Predictions of vertical motion: the truth predicts a noise-free flight, other numbers do not."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, GAIN, LAG_S, flown, prepare_vertical

import eivor as ev
from eivor.errors import UsageError
from eivor.flights.motion import HorizonErrors, MultiStepPrediction, Starts, multi_step_predictions, starts_of
from eivor.flights.prepare import prepare
from eivor.flights.track import Moment, Track, track
from eivor.models.separable import NoInstruments
from eivor.motions.vertical.motion import Vertical
from eivor.report.other_results import marks, report_changes, track_document, track_figure, track_json, untold
from eivor.report.terminal import on_terminal
from motions.turning_logs import turned

TRUTH = {"viscous_friction": FRICTION, "input_gain": GAIN, "actuator_lag": LAG_S, "delay": 0.0}


@pytest.fixture(scope="module")
def problem():
    (log,) = flown(noise=0.0)
    return Vertical().problem((prepare_vertical(log, ev.FlightOptions()),), NoInstruments())


def left(problem, values):
    return [
        float(np.std(prediction.measured - prediction.predicted) / np.std(prediction.measured))
        for prediction in Vertical().abilities.prediction.another_flight(problem, values)
    ]


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.thorough
def test_the_truth_predicts(problem):
    one_step, open_loop = Vertical().abilities.prediction.another_flight(problem, TRUTH)
    assert (one_step.horizon.words, open_loop.horizon.words) == ("one step ahead", "in open loop")
    assert one_step.measured.shape == one_step.predicted.shape == open_loop.measured.shape
    # the rotors' state before the log is not known: they start at their first command
    one_step, open_loop = left(problem, TRUTH)
    assert one_step < 0.02
    assert open_loop < 0.005


def error(model, quantity, size):
    return HorizonErrors(model, f"model {model}", quantity, "rad/s", np.full((4, 5), size))


def test_states_are_carried_on_as_their_equation_says():
    samples = np.arange(0, 400, 40)
    starts = Starts(samples, (20, 40, 60), 0.005)
    time = 0.005 * np.arange(600)
    force, decay = np.sin(3.0 * time), 1.5

    def truth(nuisances):
        return (decay * np.sin(3.0 * time[nuisances]) - 3.0 * np.cos(3.0 * time[nuisances])) / (
            decay**2 + 9.0
        )

    started = np.stack([truth(samples), truth(samples) + 1.0])
    driven = starts.over_step(force)
    carried = starts.propagate(started, lambda state, now: driven[now] - decay * state)
    assert np.allclose(carried[:, 0], truth(starts.ends), atol=2e-5)
    left = np.exp(-decay * 0.005 * np.array(starts.steps))[:, None]
    assert np.allclose(carried[:, 1], truth(starts.ends) + left, atol=3e-5)


@pytest.fixture(scope="module")
def broken():
    """A flight of 20 s with a gap of a second, and a hundredth of one that does not count."""
    log = turned(0, seconds=20.0)
    channels = {}
    for name, channel in log.channels.items():
        kept = (channel.time_s < 8.0) | (channel.time_s > 9.0)
        channels[name] = replace(channel, time_s=channel.time_s[kept], values=channel.values[kept])
    flight = prepare(replace(log, channels=channels), ev.motion_by_name("rates"), ev.FlightOptions())
    usable = flight.usable.copy()
    usable[600:602] = False
    return replace(flight, usable=usable)


def test_every_half_second_that_is_predicted_stands_on_data(broken):
    starts = starts_of(broken)
    assert starts.steps == (20, 40, 60, 80, 100)
    assert starts.samples.size > 200
    inside = [any(run.start <= sample < run.stop - 100 for run in broken.runs) for sample in starts.samples]
    assert all(inside)
    assert all(broken.usable[sample : sample + 101].all() for sample in starts.samples)


def test_errors_are_held_against_those_of_simpler_models():
    errors = (
        error("fit", "roll rate", 1.0),
        error("other", "roll rate", 4.0),
        error("fit", "yaw rate", 1.0),
        error("other", "yaw rate", 0.5),
    )
    multi_step_prediction = MultiStepPrediction(errors, np.arange(4.0))
    assert multi_step_prediction.ratios["model other"] == pytest.approx(np.sqrt(0.25 * 2.0))
    assert multi_step_prediction.predicts
    assert "'model other' leaves less of yaw rate." in multi_step_prediction.sentence
    assert "roll rate" not in multi_step_prediction.sentence
    worse = replace(multi_step_prediction, errors=(error("fit", "roll rate", 5.0), *errors[1:]))
    assert not worse.predicts
    alone = MultiStepPrediction(errors[:1], np.arange(4.0))
    assert "nothing to hold" in alone.sentence


def test_flights_follow_each_other_and_what_nobody_measured_is_left_out():
    unmeasured = replace(error("fit", "position", 1.0), left=np.full((4, 5), np.nan))
    half = replace(
        error("fit", "roll rate", 3.0), left=np.vstack([np.full((2, 5), 3.0), np.full((2, 5), np.nan)])
    )
    item = (error("fit", "roll rate", 1.0), unmeasured)
    result = multi_step_predictions(
        [item, (half, unmeasured), ()], [np.arange(4.0), np.arange(4.0), np.empty(0)], ("said",)
    )
    assert [each.quantity for each in result.errors] == ["roll rate"]
    assert result.errors[0].rms[0] == pytest.approx(np.sqrt((4 * 1.0 + 2 * 9.0) / 6))
    assert result.start_s.size == 8
    assert result.omitted == ("said",)


def weakened(log, at_s, factor):
    """The log of a vehicle whose thrust drops by a factor at a time: it commands as much more."""
    command = log.channels["rotor_command_1"]
    values = np.where(command.time_s >= at_s, command.values / np.sqrt(factor), command.values)
    return replace(log, channels={**log.channels, "rotor_command_1": replace(command, values=values)})


@pytest.fixture(scope="module")
def hover():
    return flown(amplitude=0.0, gust=0.3, seed=3)[0]


@pytest.fixture(scope="module")
def dropped(hover):
    return track(ev.identify_flight(weakened(hover, 20.0, 0.8)))


@pytest.mark.thorough
def test_a_drop_is_told_where_it_is_and_by_how_much(dropped):
    (change,) = dropped.changes
    assert change.change == -1
    assert 20.0 < change.time_s < 23.0
    (sentence,) = report_changes(dropped)
    assert re.search("input gain K_u fell by 20 %", sentence)
    early = [item for item in dropped.precise_moments if item.time_s < 20.0]
    late = [item for item in dropped.precise_moments if item.time_s > 25.0]
    for moments, truth in ((early, GAIN), (late, 0.8 * GAIN)):
        assert len(moments) > 5
        assert all(abs(moment.value - truth) < moment.half_width < 0.05 * truth for moment in moments)


@pytest.mark.thorough
def test_nothing_is_told_of_a_flight_that_stays_as_it_is(hover):
    result = track(ev.identify_flight(hover))
    assert result.changes == ()
    assert "None" in next(iter(report_changes(result)))


@pytest.mark.thorough
def test_hover_tells_nothing_when_nothing_is_known_of_the_intercept(hover):
    result = track(ev.identify_flight(hover, accelerometer_bias=float("inf")))
    assert result.precise_moments == ()
    assert "wider than ±20 %" in " ".join(untold(result))
    assert "only movement identifies" in result.known[1]
    figure = track_figure(result)
    assert "reported at no moment" in figure.get_suptitle()


@pytest.mark.thorough
def test_a_window_without_samples_is_not_told():
    moments = tuple(Moment(float(t), 40.0, 1.0, 0.1 if 3 <= t < 6 else 0.9) for t in range(10))
    result = ev.identify_flight(flown(seconds=10.0)[0])
    results = Track(result, "input_gain", "m/s^2", 5.0, {}, moments, ())
    (sentence,) = untold(results)
    assert sentence.startswith("3.0 to 5.0 s: hardly any sample")
    assert len(results.precise_moments) == 7


@pytest.mark.thorough
def test_documents_figure_and_json_agree(dropped, capsys):
    from rich.console import Console

    Console(width=80).print(on_terminal(track_document(dropped)))
    screen = capsys.readouterr().out
    assert "K_u  ··█" in screen
    assert "fell" in screen
    document = track_json(dropped)
    assert document["schema"] == "eivor.track/1"
    assert document["changes"] == [{"time_s": dropped.changes[0].time_s, "upwards": False}]
    assert len(document["moments"]) == len(dropped.moments)
    (axes,) = track_figure(dropped).axes
    assert len(axes.lines) == 2
    assert len(axes.collections) == 1


def test_marks_span_what_is_told_and_a_tenth_at_least():
    assert marks([1.0, 2.0, 5.0], [True, True, False]) == "▁█·"
    assert marks([1.0, 1.001], [True, True]) in ("▄▅", "▅▅", "▄▄")
    assert marks([1.0], [False]) == "·"


@pytest.mark.thorough
def test_what_cannot_be_followed_is_refused(hover):
    result = ev.identify_flight(hover)
    with pytest.raises(UsageError, match=r"memory of 0.1 to 30 s, the length of the flight; received 99 s"):
        track(result, 99.0)
    with pytest.raises(UsageError, match="one flight to follow; received 2"):
        track(replace(result, prepared=result.prepared * 2))
    nothing = track(ev.identify_flight(hover, window=(1.0, 2.0)))
    assert nothing.moments == ()
    assert "three seconds" in " ".join(untold(nothing))
