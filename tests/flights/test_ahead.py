"""Predictions from many starts: how states are carried on, where they start, what is said of the errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.motion import HorizonErrors, MultiStepPrediction, Starts, multi_step_predictions, starts_of
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.motions import motion_by_name
from motions.turning_logs import turned


def error(model: str, quantity: str, size: float) -> HorizonErrors:
    return HorizonErrors(model, f"model {model}", quantity, "rad/s", np.full((4, 5), size))


def test_states_are_carried_on_as_their_equation_says():
    samples = np.arange(0, 400, 40)
    starts = Starts(samples, (20, 40, 60), 0.005)
    time = 0.005 * np.arange(600)
    force, decay = np.sin(3.0 * time), 1.5

    def truth(nuisances: np.ndarray) -> np.ndarray:
        return (decay * np.sin(3.0 * time[nuisances]) - 3.0 * np.cos(3.0 * time[nuisances])) / (
            decay**2 + 9.0
        )

    started = np.stack([truth(samples), truth(samples) + 1.0])
    driven = starts.over_step(force)
    carried = starts.propagate(started, lambda state, now: driven[now] - decay * state)
    assert np.allclose(carried[:, 0], truth(starts.ends), atol=2e-5)
    left = np.exp(-decay * 0.005 * np.array(starts.steps))[:, None]
    assert np.allclose(carried[:, 1], truth(starts.ends) + left, atol=3e-5)


def test_fine_grids_are_passed_in_longer_steps_that_meet_the_horizons():
    starts = Starts(np.array([3]), (50, 100, 150, 200, 250), 0.002)
    visited: list[int] = []

    def derivative(state: np.ndarray, now: np.ndarray) -> np.ndarray:
        visited.append(int(now[0]))
        return np.ones_like(state)

    carried = starts.propagate(np.zeros((1, 1)), derivative)
    assert np.allclose(carried[:, 0, 0], [0.1, 0.2, 0.3, 0.4, 0.5])
    assert len(visited) == 2 * 50
    assert visited[-1] == 248


def test_what_drives_counts_with_all_its_samples():
    quick = np.cos(0.9 * np.pi * np.arange(400))
    starts = Starts(np.array([7]), (50, 100), 0.002)
    driven = starts.over_step(np.stack([quick, np.ones(400)]))
    carried = starts.propagate(np.zeros((2, 1)), lambda _state, now: driven[:, now])
    whole = 0.002 * np.cumsum(0.5 * (quick[7:-1] + quick[8:]))
    assert np.allclose(carried[:, 0, 0], whole[[49, 99]], atol=1e-12)
    assert np.allclose(carried[:, 1, 0], [0.1, 0.2])


@pytest.fixture(scope="module")
def broken() -> PreparedFlight:
    """A flight of 20 s with a gap of a second, and a hundredth of one that does not count."""
    log = turned(0, seconds=20.0)
    channels = {}
    for name, channel in log.channels.items():
        kept = (channel.time_s < 8.0) | (channel.time_s > 9.0)
        channels[name] = replace(channel, time_s=channel.time_s[kept], values=channel.values[kept])
    flight = prepare(replace(log, channels=channels), motion_by_name("rates"), FlightOptions())
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


def test_long_flights_have_no_more_starts(broken, monkeypatch):
    monkeypatch.setattr("eivor.flights.motion.MOST_STARTS", 50)
    assert 25 < starts_of(broken).samples.size <= 50


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
