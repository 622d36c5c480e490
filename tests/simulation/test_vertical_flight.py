"""Flights of the own simulator: logs against the truth, and one specification against another."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from eivor.errors import UsageError
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.recording import Frame
from eivor.simulation.environment import FlightTruth, NoiseKind, SensorNoise, SimulatedFlight, TrajectoryKind
from eivor.simulation.vertical import BATCH, STEP_S, VerticalFlightSpec, simulate_vertical_flights
from simulation.rotor_states import actual_state_recording
from validation.effective_parameters import effective_parameters

QUIET = VerticalFlightSpec(noise=SensorNoise.none(), duration=8.0, seed=21)
LOUD = VerticalFlightSpec(
    viscous_friction=0.7,
    actuator_lag=0.012,
    delay=0.02,
    gust_rms=0.8,
    accelerometer_bias=0.1,
    noise=SensorNoise(NoiseKind.FRACTIONAL),
    duration=8.0,
    seed=22,
)


def fly(spec: VerticalFlightSpec) -> SimulatedFlight:
    return next(simulate_vertical_flights([spec]))


def values(flight: SimulatedFlight, name: str) -> np.ndarray:
    return flight.recording.channel(name).values


def identical(first: SimulatedFlight, second: SimulatedFlight) -> None:
    """Raise unless two flights are one, to rounding."""
    assert first.recording.channels.keys() == second.recording.channels.keys()
    for name in first.recording.channels:
        np.testing.assert_allclose(values(first, name), values(second, name), rtol=1e-12, atol=1e-12)
    for part in fields(FlightTruth):
        np.testing.assert_allclose(
            getattr(first.truth, part.name), getattr(second.truth, part.name), rtol=1e-12, atol=1e-12
        )


# -------------------------------------------------------------------------------------- log and truth


def test_log_without_noise_is_the_truth():
    flight = fly(replace(QUIET, gust_rms=0.5))
    truth = flight.truth
    np.testing.assert_allclose(values(flight, "specific_force_z"), truth.specific_force_z, rtol=1e-12)
    np.testing.assert_allclose(values(flight, "cos_tilt"), truth.cos_tilt, rtol=1e-12)
    lift = QUIET.input_gain * truth.cos_tilt * truth.rotor_state[:, 0] ** 2
    drag = QUIET.viscous_friction * truth.air_velocity_z
    np.testing.assert_allclose(truth.specific_force_z, lift - drag, rtol=1e-12)
    wind = values(flight, "velocity_z") - truth.air_velocity_z
    assert np.std(wind) > 0.1


@pytest.mark.parametrize(("over", "halfway"), [(0.0, 0.8), (2.0, 0.9)])
def test_the_gain_changes_when_it_is_to_and_the_controller_does_not_know(over, halfway):
    spec = replace(QUIET, gain_after=0.8, gain_changes_at=4.0, gain_changes_over=over)
    truth = fly(spec).truth
    share = (truth.specific_force_z + spec.viscous_friction * truth.air_velocity_z) / (
        spec.input_gain * truth.cos_tilt * truth.rotor_state[:, 0] ** 2
    )
    indices = np.searchsorted(truth.time_s, [3.9, 5.0, 7.9])
    np.testing.assert_allclose(share[indices], [1.0, halfway, 0.8], rtol=1e-9)
    hover = truth.rotor_state[[0, -1], 0] ** 2
    assert hover[1] / hover[0] > 1.1


def test_effective_parameters_are_the_nominal_ones():
    truth = fly(LOUD).truth
    parameters = effective_parameters(truth, np.ones(truth.time_s.size, dtype=bool), np.square)
    np.testing.assert_allclose(
        parameters, (LOUD.viscous_friction, LOUD.input_gain, 0.0), rtol=1e-9, atol=1e-9
    )


def test_rotor_is_the_lag_of_the_delayed_command():
    flight = fly(LOUD)
    late = round(LOUD.delay / STEP_S)
    reported = np.concatenate([np.full(late, LOUD.hover_input), values(flight, "rotor_command_1")])
    decay = np.exp(-STEP_S / LOUD.actuator_lag)
    state = LOUD.hover_input
    for k, actual in enumerate(flight.truth.rotor_state[:, 0]):
        assert actual == pytest.approx(state, rel=1e-9)
        state = decay * state + (1.0 - decay) * reported[k]


def test_bias_and_noise_are_on_the_logged_force_alone():
    quiet = replace(LOUD, noise=SensorNoise(NoiseKind.FRACTIONAL, acceleration=0.0), accelerometer_bias=0.0)
    loud, quiet_flight = fly(LOUD), fly(quiet)
    error = values(loud, "specific_force_z") - loud.truth.specific_force_z
    assert error.mean() == pytest.approx(LOUD.accelerometer_bias, abs=0.3)
    assert np.std(error) == pytest.approx(LOUD.noise.acceleration, rel=0.4)
    np.testing.assert_allclose(
        values(quiet_flight, "rotor_command_1"), values(loud, "rotor_command_1"), rtol=1e-12
    )


@pytest.mark.thorough
def test_controller_answers_the_noise_that_is_logged():
    hover = replace(QUIET, trajectory=TrajectoryKind.HOVER, tilt_rms=0.0, integral_share=0.0)
    assert np.ptp(values(fly(hover), "rotor_command_1")) < 1e-12
    flight = fly(replace(hover, noise=SensorNoise(attitude=0.0)))
    gains = hover.controller
    error = -gains.position_gain * values(flight, "position_z") - values(flight, "velocity_z")
    thrust = hover.input_gain * values(flight, "rotor_command_1") ** 2
    np.testing.assert_allclose(thrust, GRAVITY + gains.velocity_gain * error, rtol=1e-12)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")  # a minute has the shapes of eight seconds
def test_tilt_has_its_size():
    truth = fly(replace(QUIET, tilt_rms=0.1, duration=60.0)).truth
    # 1 - cos(roll) cos(pitch) is half the squared angles, each .1 rad before smoothing takes 7 % off.
    assert np.mean(1.0 - truth.cos_tilt) == pytest.approx(0.1**2 / 1.15, rel=0.3)


def test_recording_is_what_the_recipe_reads():
    recording = fly(QUIET).recording
    assert recording.frame is Frame.Z_UP
    assert recording.input_map == "square"
    assert {"rotor_command_1", "velocity_z", "position_z", "specific_force_z", "cos_tilt"} < set(
        recording.channels
    )
    held = {name for name, channel in recording.channels.items() if channel.held}
    assert held == {"rotor_command_1"} | {
        name for name in recording.channels if name.startswith("reference_")
    }


def test_actual_state_takes_the_commands_place():
    flight = fly(LOUD)
    recording = actual_state_recording(flight)
    np.testing.assert_array_equal(recording.channel("rotor_speed_1").values, flight.truth.rotor_state[:, 0])
    assert not recording.channel("rotor_speed_1").held
    assert set(recording.channels) ^ set(flight.recording.channels) == {"rotor_speed_1", "rotor_command_1"}


# ------------------------------------------------------------------------- a flight is its specification


@pytest.mark.thorough
def test_flight_does_not_depend_on_its_batch():
    others = [replace(QUIET, seed=seed, delay=0.02, viscous_friction=0.2) for seed in range(30, 30 + BATCH)]
    batch = list(simulate_vertical_flights([*others, LOUD, QUIET]))
    assert len(batch) == BATCH + 2  # the last two share the second batch
    identical(batch[-2], fly(LOUD))
    identical(next(simulate_vertical_flights([LOUD, *others[:3]])), batch[-2])
    identical(batch[0], fly(others[0]))


@pytest.mark.thorough
def test_same_specification_gives_the_same_bytes():
    first, second = fly(LOUD), fly(LOUD)
    for name in first.recording.channels:
        assert values(first, name).tobytes() == values(second, name).tobytes()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"noise": SensorNoise(NoiseKind.WHITE)}, ("reference_position_z",)),
        ({"trajectory": TrajectoryKind.CHIRP}, ()),
        ({"seed": 23}, ()),
    ],
)
def test_streams_are_apart(change, same):
    first, second = fly(LOUD), fly(replace(LOUD, **change))
    for name in ("reference_position_z", "rotor_command_1", "specific_force_z"):
        assert np.array_equal(values(first, name), values(second, name)) == (name in same)


# ------------------------------------------------------------------------------------------ refusals


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"viscous_friction": 0.0}, "viscous_friction between"),
        ({"actuator_lag": float("nan")}, "actuator_lag between"),
        ({"delay": 0.005}, "a multiple of 0.002"),
        ({"quickness": 2.0}, "quickness between"),
        ({"duration": 1.0}, "duration between"),
    ],
)
def test_specification_is_checked(wrong, message):
    with pytest.raises(UsageError, match=message):
        VerticalFlightSpec(**wrong)


def test_durations_must_agree():
    with pytest.raises(UsageError, match="flights of one duration"):
        list(simulate_vertical_flights([QUIET, replace(QUIET, duration=9.0)]))


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")  # a minute has the shapes of eight seconds
def test_vehicle_far_from_its_reference_is_lost():
    storm = replace(QUIET, gust_rms=5.0, viscous_friction=2.0, duration=60.0)
    breeze = replace(storm, viscous_friction=0.5, gust_rms=1.0)
    assert [flight.flew for flight in simulate_vertical_flights([storm, breeze])] == [False, True]
