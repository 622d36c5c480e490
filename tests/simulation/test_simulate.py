"""Simulated records against an integrator, against the model's own equation, and against each other."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eivor as ev
from eivor.errors import ParameterError, UsageError
from eivor.lab.disturbances import Arma
from eivor.lab.records import ALWAYS_MEASURED, DisturbanceRoute, Intersample, VelocityControl
from eivor.simulation.environment import (
    FlightTruth,
    NoiseKind,
    SensorNoise,
    TrajectoryKind,
    altitude_reference,
    sensor_errors,
)
from eivor.simulation.excitation import PaperInput, WhiteDisturbance, WhiteExcitation
from eivor.simulation.vertical import BATCH, VerticalFlightSpec, simulate_vertical_flights
from validation.effective_parameters import effective_parameters

NOISY = {
    "velocity_z": ev.FractionalNoise(1.0, -0.4),
    "acceleration_z": ev.FractionalNoise(1.0, -0.5),
    "input": ev.WhiteNoise(1.0),
}
RATIOS = {"velocity_z": 0.1, "acceleration_z": 0.045, "input": 0.045}
OPEN = ev.Scenario(0.293, 0.021, samples=200)
FULL = replace(
    OPEN, noise=NOISY, noise_to_signal=RATIOS, disturbance=WhiteDisturbance(1.0), disturbance_to_signal=0.3
)
CONTROL = {"control": VelocityControl(15.0, 4.0)}


def rng(seed=1):
    return np.random.default_rng(seed)


def integrated(scenario, u, e):
    """Velocity at the samples by an adaptive integrator, interval by interval."""
    K, K_u, T = scenario.viscous_friction, scenario.input_gain, scenario.step_s
    linear = scenario.intersample is Intersample.LINEAR
    velocity = [0.0]
    for (u0, u1), e0 in zip(pairwise(u), e[:-1], strict=True):
        slope = (u1 - u0) / T if linear else 0.0
        solved = solve_ivp(
            lambda t, v, u0=u0, slope=slope, e0=e0: -K * v + K_u * (u0 + slope * t) + e0,
            (0.0, T),
            [velocity[-1]],
            rtol=1e-11,
            atol=1e-13,
        )
        velocity.append(float(solved.y[0, -1]))
    return np.array(velocity)


@pytest.mark.parametrize("intersample", list(Intersample))
@pytest.mark.parametrize("friction", [0.0, 1e-3, 0.293, 12.0])
def test_velocity_is_the_integrators(friction, intersample):
    scenario = replace(
        OPEN,
        viscous_friction=friction,
        samples=40,
        intersample=intersample,
        excitation=WhiteExcitation(1.0),
        disturbance=WhiteDisturbance(0.02),
        route=DisturbanceRoute.DYNAMICS,
    )
    truth = ev.simulate(scenario, rng()).truth
    expected = integrated(scenario, truth.channel("input"), truth.channel("disturbance"))
    np.testing.assert_allclose(truth.channel("velocity_z"), expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    "scenario", [FULL, replace(FULL, route=DisturbanceRoute.DYNAMICS), replace(FULL, **CONTROL)]
)
def test_truth_obeys_the_equation(scenario):
    truth = ev.simulate(scenario, rng()).truth
    v, u, e = (truth.channel(name) for name in ("velocity_z", "input", "disturbance"))
    np.testing.assert_allclose(truth.channel("acceleration_z"), 0.021 * u - 0.293 * v + e, atol=1e-13)


@pytest.mark.parametrize("route", list(DisturbanceRoute))
@pytest.mark.parametrize("control", [{}, CONTROL])
def test_ratios_are_of_the_motion_without_noise(route, control):
    scenario = replace(FULL, route=route, **control)
    result = ev.simulate(scenario, rng())
    noiseless = ev.simulate(replace(scenario, noise_to_signal=dict.fromkeys(RATIOS, 0.0)), rng()).truth
    undisturbed = ev.simulate(
        replace(scenario, noise_to_signal={}, noise={}, disturbance=None, disturbance_to_signal=None), rng()
    ).truth
    response = undisturbed.channel("acceleration_z")
    assert result.truth.channel("disturbance").std() == pytest.approx(0.3 * response.std(), rel=1e-12)
    for name, ratio in RATIOS.items():
        expected = NOISY[name].with_std(ratio * float(noiseless.channel(name).std()))
        assert result.signals.noise[name].std == pytest.approx(expected.std, rel=1e-12)
        assert type(result.signals.noise[name]) is type(expected)


@pytest.mark.parametrize("control", [{}, CONTROL])
def test_measured_is_true_plus_declared(control):
    """Each error, divided by its declared std, is the unit noise of its own stream."""
    result = ev.simulate(replace(FULL, **control), rng())
    streams = rng().spawn(5)
    for name, stream in zip(ALWAYS_MEASURED, streams[2:], strict=True):
        error = result.signals.channel(name) - result.truth.channel(name)
        declared = result.signals.noise[name]
        np.testing.assert_allclose(error, declared.sample(200, stream), atol=1e-12)
    assert result.parameters == {"viscous_friction": 0.293, "input_gain": 0.021}


CHANGES = [
    ("excitation", {"excitation": WhiteExcitation(1.0)}),
    ("disturbance", {"disturbance": Arma(1.0, (0.5,))}),
    ("velocity_z", {"noise": NOISY | {"velocity_z": ev.WhiteNoise(1.0)}}),
    ("acceleration_z", {"noise": NOISY | {"acceleration_z": ev.FractionalNoise(1.0, 0.2)}}),
    ("input", {"noise": NOISY | {"input": ev.FractionalNoise(1.0, -0.1)}}),
]


@pytest.mark.parametrize(("changed", "change"), CHANGES, ids=[name for name, _ in CHANGES])
def test_changing_one_source_leaves_the_others(changed, change):
    """Realisations in units of their own std, since ratios make sizes depend on each other."""

    def sources(scenario):
        result = ev.simulate(scenario, rng())
        errors = {name: result.signals.channel(name) - result.truth.channel(name) for name in ALWAYS_MEASURED}
        errors |= {
            "excitation": result.truth.channel("input"),
            "disturbance": result.truth.channel("disturbance"),
        }
        return {name: values / values.std() for name, values in errors.items()}

    before, after = sources(FULL), sources(replace(FULL, **change))
    for name, values in before.items():
        same = np.allclose(values, after[name], atol=1e-9)
        assert same == (name != changed), name


def test_record_without_noise_gives_its_parameters_back():
    signals = ev.simulate(replace(OPEN, excitation=PaperInput()), rng()).signals
    rows = ev.VerticalMotion(intercept=False).regression(signals).rows()
    solution = np.linalg.lstsq(rows.regressors, rows.response, rcond=None)[0]
    np.testing.assert_allclose(solution, [0.293, 0.021], rtol=1e-10)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"viscous_friction": -0.1}, "viscous_friction of zero or more; received -0.1"),
        ({"viscous_friction": float("nan")}, "viscous_friction of zero or more; received nan"),
        ({"input_gain": float("inf")}, "a finite input_gain"),
        ({"noise_to_signal": {"u": 0.1}}, "received noise of 'u'"),
        ({"disturbance_to_signal": 0.1}, "a disturbance to scale; received disturbance_to_signal alone"),
        (
            {"disturbance_to_signal": -0.1, "disturbance": WhiteDisturbance(1.0)},
            "disturbance_to_signal of zero or more; received -0.1",
        ),
        (CONTROL | {"intersample": Intersample.LINEAR}, "held between samples.*'linear'"),
    ],
)
def test_impossible_scenarios_are_refused(change, said):
    with pytest.raises(ParameterError, match=f"Expected .*{said}"):
        replace(OPEN, **change)


def test_disturbance_without_variation_cannot_be_scaled():
    scenario = replace(OPEN, disturbance=WhiteDisturbance(0.0), disturbance_to_signal=0.1)
    with pytest.raises(ParameterError, match="a disturbance that varies"):
        ev.simulate(scenario, rng())


STEP_S = 0.01


def reference(kind, *, seed=1, count=6000, vigour=1.0):
    rng = np.random.default_rng(seed)
    return altitude_reference(kind, count=count, step_s=STEP_S, rng=rng, vigour=vigour)


@pytest.mark.parametrize("kind", list(TrajectoryKind))
def test_reference_and_its_derivatives_belong_together(kind):
    flight = reference(kind)
    np.testing.assert_allclose(
        np.gradient(flight.position, STEP_S)[1:-1], flight.velocity[1:-1], rtol=0.0, atol=5e-3
    )
    np.testing.assert_allclose(
        np.gradient(flight.velocity, STEP_S)[1:-1], flight.acceleration[1:-1], rtol=0.0, atol=5e-2
    )


@pytest.mark.parametrize("kind", [TrajectoryKind.STEPS, TrajectoryKind.MULTISINE, TrajectoryKind.CHIRP])
@pytest.mark.parametrize("seed", range(5))
def test_excitation_reaches_a_limit_and_passes_none(kind, seed):
    flight = reference(kind, seed=seed)
    speed, acceleration = np.abs(flight.velocity).max(), np.abs(flight.acceleration).max()
    assert speed <= 2.2 + 1e-9
    assert acceleration <= 4.0 + 1e-9
    assert speed >= 1.6 - 1e-9 or acceleration >= 3.0 - 1e-9


@pytest.mark.parametrize("kind", list(NoiseKind))
def test_errors_have_their_levels_over_the_record(kind):
    noise = SensorNoise(kind, acceleration=0.4, velocity=0.03, position=0.01, attitude=0.002)
    errors = sensor_errors(noise, count=4000, axes=40, rng=np.random.default_rng(5))
    for name in ("acceleration", "velocity", "position", "attitude", "angular_rate"):
        rms = np.sqrt(np.mean(getattr(errors, name) ** 2))
        assert rms == pytest.approx(getattr(noise, name), rel=0.05)


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


def fly(spec):
    return next(simulate_vertical_flights([spec]))


def values(flight, name):
    return flight.recording.channel(name).values


def identical(first, second):
    """Raise unless two flights are one, to rounding."""
    assert first.recording.channels.keys() == second.recording.channels.keys()
    for name in first.recording.channels:
        np.testing.assert_allclose(values(first, name), values(second, name), rtol=1e-12, atol=1e-12)
    for part in fields(FlightTruth):
        np.testing.assert_allclose(
            getattr(first.truth, part.name), getattr(second.truth, part.name), rtol=1e-12, atol=1e-12
        )


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


@pytest.mark.thorough
def test_flight_does_not_depend_on_its_batch():
    others = [replace(QUIET, seed=seed, delay=0.02, viscous_friction=0.2) for seed in range(30, 30 + BATCH)]
    batch = list(simulate_vertical_flights([*others, LOUD, QUIET]))
    assert len(batch) == BATCH + 2  # the last two share the second batch
    identical(batch[-2], fly(LOUD))
    identical(next(simulate_vertical_flights([LOUD, *others[:3]])), batch[-2])
    identical(batch[0], fly(others[0]))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"viscous_friction": 0.0}, "viscous_friction between"),
        ({"actuator_lag": float("nan")}, "actuator_lag between"),
        ({"delay": 0.005}, "a multiple of 0.002"),
        ({"quickness": 2.0}, "quickness between"),
        ({"duration": 1.0}, "duration between"),
        ({"noise": {"velocity": -0.1}}, "finite noise levels"),
    ],
)
def test_specification_is_checked(wrong, message):
    with pytest.raises(UsageError, match=message):
        SensorNoise(**wrong["noise"]) if "noise" in wrong else VerticalFlightSpec(**wrong)


def test_durations_must_agree():
    with pytest.raises(UsageError, match="flights of one duration"):
        list(simulate_vertical_flights([QUIET, replace(QUIET, duration=9.0)]))


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")  # a minute has the shapes of eight seconds
def test_vehicle_far_from_its_reference_is_lost():
    storm = replace(QUIET, gust_rms=5.0, viscous_friction=2.0, duration=60.0)
    breeze = replace(storm, viscous_friction=0.5, gust_rms=1.0)
    assert [flight.flew for flight in simulate_vertical_flights([storm, breeze])] == [False, True]
