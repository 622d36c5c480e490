"""Simulated records against an integrator, against the model's own equation, and against each other."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import eivor as ev
from eivor.errors import ParameterError
from eivor.lab.disturbances import Arma, OrnsteinUhlenbeck
from eivor.lab.records import ALWAYS_MEASURED, Control, DisturbanceRoute, Intersample
from eivor.motions.rigid_body.dynamics import body_derivative, coefficients_of, speed_derivative, wrench
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors, Vehicle
from eivor.signals.noise import WhiteNoise
from eivor.simulation.controller import FlightController, Sensor, mixer_of, torque_limits
from eivor.simulation.environment import (
    NoiseKind,
    SensorNoise,
    TrajectoryKind,
    altitude_reference,
)
from eivor.simulation.excitation import (
    DrydenGust,
    PaperInput,
    RandomSteps,
    SteppedExcitation,
    WhiteDisturbance,
    WhiteExcitation,
)
from eivor.simulation.rigid_body import (
    STILL,
    AxisExcitations,
    Logged,
    RigidBodyFlightSpec,
    Sensors,
    TorqueDisturbance,
    Wind,
    log_of_rigid_body_flight,
    quaternions,
    rotor_response,
    runge_kutta,
    simulate_rigid_body_flights,
    viscous_friction,
)
from eivor.simulation.vertical import BATCH, VerticalFlightSpec, simulate_vertical_flights
from validation.effective_parameters import effective_parameters, truth_of

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
CONTROL = {"control": Control(15.0, 4.0)}
FALLING = {"disturbance_to_signal": -0.1, "disturbance": WhiteDisturbance(1.0)}


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
    calm = {"noise_to_signal": {}, "noise": {}, "disturbance": None, "disturbance_to_signal": None}
    undisturbed = ev.simulate(replace(scenario, **calm), rng()).truth
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
        truth = result.truth.channels
        errors |= {"excitation": truth["input"], "disturbance": truth["disturbance"]}
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


STEP_S = 0.01


def reference(kind, *, seed=1, count=6000, vigour=1.0):
    rng = np.random.default_rng(seed)
    return altitude_reference(kind, count=count, step_s=STEP_S, rng=rng, vigour=vigour)


@pytest.mark.parametrize("kind", list(TrajectoryKind))
def test_reference_and_its_derivatives_belong_together(kind):
    flight = reference(kind)
    for of, slope, atol in (("position", "velocity", 5e-3), ("velocity", "acceleration", 5e-2)):
        slopes = np.gradient(getattr(flight, of), STEP_S)[1:-1]
        np.testing.assert_allclose(slopes, getattr(flight, slope)[1:-1], rtol=0.0, atol=atol)


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
    for name, errors in noise.errors(4000, 40, np.random.default_rng(5)).items():
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(getattr(noise, name), rel=0.05)


QUIET = VerticalFlightSpec(noise=SensorNoise(NoiseKind.WHITE, *[0.0] * 4), duration=8.0, seed=21)
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


def identical(first, second, truths, within=1e-12):
    """Raise unless two flights, and these parts of their truths, are one to rounding."""
    assert first.recording.channels.keys() == second.recording.channels.keys()
    pairs = [(values(first, name), values(second, name)) for name in first.recording.channels]
    for item, other in zip(*map(truths, (first, second)), strict=True):
        pairs += [(getattr(item, part.name), getattr(other, part.name)) for part in fields(item)]
    for one, another in pairs:
        np.testing.assert_allclose(one, another, rtol=within, atol=within)


def test_log_without_noise_is_the_truth():
    spec = replace(QUIET, gust_rms=0.5)
    flight = fly(spec)
    truth = truth_of(spec, flight)
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
    truth = truth_of(spec, fly(spec))
    share = (truth.specific_force_z + spec.viscous_friction * truth.air_velocity_z) / (
        spec.input_gain * truth.cos_tilt * truth.rotor_state[:, 0] ** 2
    )
    indices = np.searchsorted(truth.time_s, [3.9, 5.0, 7.9])
    np.testing.assert_allclose(share[indices], [1.0, halfway, 0.8], rtol=1e-9)
    hover = truth.rotor_state[[0, -1], 0] ** 2
    assert hover[1] / hover[0] > 1.1


def test_effective_parameters_are_the_nominal_ones():
    truth = truth_of(LOUD, fly(LOUD))
    parameters = effective_parameters(truth, np.ones(truth.time_s.size, dtype=bool), np.square)
    nominal = (LOUD.viscous_friction, LOUD.input_gain, 0.0)
    np.testing.assert_allclose(parameters, nominal, rtol=1e-9, atol=1e-9)


@pytest.mark.thorough
def test_flight_does_not_depend_on_its_batch():
    others = [replace(QUIET, seed=seed, delay=0.02, viscous_friction=0.2) for seed in range(30, 30 + BATCH)]
    batch = list(simulate_vertical_flights([*others, LOUD, QUIET]))
    assert len(batch) == BATCH + 2  # the last two share the second batch
    fewer = next(simulate_vertical_flights([LOUD, *others[:3]]))
    for made, other in ((batch[-2], fly(LOUD)), (fewer, batch[-2]), (batch[0], fly(others[0]))):
        identical(made, other, lambda flight: flight.truth)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")  # a minute has the shapes of eight seconds
def test_vehicle_far_from_its_reference_is_lost():
    storm = replace(QUIET, gust_rms=5.0, viscous_friction=2.0, duration=60.0)
    breeze = replace(storm, viscous_friction=0.5, gust_rms=1.0)
    assert [flight.flew for flight in simulate_vertical_flights([storm, breeze])] == [False, True]


# Flights of a whole vehicle: logs against the truth, one route against another, and what is refused.

VEHICLE = Vehicle(
    1.2,
    (0.0153, 0.0155, 0.0296),
    Rotors(
        positions=((0.16, 0.16, 0.0), (0.16, -0.16, 0.0), (-0.16, -0.16, 0.0), (-0.16, 0.16, 0.0)),
        spins=(1, -1, 1, -1),
        highest_speed=900.0,
        thrust_quadratic=1.4e-5,
        torque_ratio=0.016,
        lag_up=0.04,
        lag_down=0.04,
        inertia=2e-5,
        drag=1.3e-4,
        inflow=2.6e-4,
    ),
    BodyDrag(quadratic=(0.01, 0.01, 0.02)),
)
STEPS = AxisExcitations(RandomSteps(0.2, 0.1), RandomSteps(0.2, 0.1), RandomSteps(0.3, 0.1))
QUIET_BODY = RigidBodyFlightSpec(
    VEHICLE, duration=3.0, attitude=STEPS, sensors=Sensors(*[Sensor()] * 6), seed=4
)
LOUD_BODY = RigidBodyFlightSpec(
    replace(VEHICLE, rotors=replace(VEHICLE.rotors, delay=0.006, lag_down=0.06)),
    duration=1.0,
    attitude=STEPS,
    injection=AxisExcitations(roll=SteppedExcitation((0.05, -0.05), 0.1)),
    controller=FlightController(rate_hz=250.0, attitude_hz=250.0, derivative_share=0.3, hold=0.3),
    wind=Wind((1.0, 0.0, 0.0), z=DrydenGust(0.3, 3.0, 2.0)),
    torque_disturbance=TorqueDisturbance(pitch=OrnsteinUhlenbeck(1.0, 0.3)),
    sensors=Sensors(
        angular_rate=Sensor(WhiteNoise(0.02), cutoff_hz=60.0, delay_s=0.004),
        velocity=Sensor(WhiteNoise(0.05), bias=0.1, delay_s=0.02),
        rotor_speed=Sensor(WhiteNoise(5.0)),
    ),
    seed=5,
)


def with_rotors(**changes):
    return replace(VEHICLE, rotors=replace(VEHICLE.rotors, **changes))


@cache
def fly_body(spec):
    return next(simulate_rigid_body_flights([spec]))


def vectors(flight, stem, parts="xyz"):
    return np.column_stack([values(flight, f"{stem}_{part}") for part in parts])


@pytest.mark.usefixtures("unchecked_shapes")
def test_log_of_exact_sensors_is_the_truth():
    flight = fly_body(QUIET_BODY)
    truth = flight.truth
    assert flight.flew
    for stem, parts, expected in (
        ("angular_rate", "xyz", truth.record.body[:, 10:13]),
        ("specific_force_body", "xyz", truth.specific_force),
        ("velocity", "xyz", truth.record.body[:, 3:6]),
        ("attitude", "wxyz", truth.record.body[:, 6:10]),
        ("rotor_speed", "1234", truth.record.rotor_speed),
        ("rotor_command", "1234", truth.record.rotor_command),
        ("torque_setpoint", "xyz", truth.record.torque),
    ):
        np.testing.assert_allclose(vectors(flight, stem, parts), expected, atol=1e-12)
    np.testing.assert_array_equal(values(flight, "input"), truth.record.thrust)
    assert "injected_torque_x" not in flight.recording.channels
    held = {name for name, channel in flight.recording.channels.items() if channel.held}
    begins = ("rotor_command", "reference", "feedback", "torque", "input")
    assert held == {name for name in flight.recording.channels if name.startswith(begins)}


@pytest.mark.usefixtures("unchecked_shapes")
def test_equations_of_the_truth_hold():
    """Least squares of the rates' increments on interval means gives the parameters that the truth names."""
    truth = fly_body(replace(QUIET_BODY, vehicle=with_rotors(inertia=0.0))).truth
    parameters, step = truth.parameters, QUIET_BODY.step_s
    x, y, _ = np.array(VEHICLE.rotors.positions).T
    spins = np.array(VEHICLE.rotors.spins)
    p, q, r = truth.record.body[:, 10:13].T[:, :, None]
    turn = Rotation.from_quat(truth.record.body[:, 6:10], scalar_first=True)
    u, v, w = turn.inv().apply(truth.air_velocity).T[:, :, None]
    n = truth.record.rotor_speed
    lx, ly, lz = u - r * y, v + r * x, w + p * y - q * x
    phi = mean_squares(truth.record.rotor_command[:-1], n[:-1], step, 0.04)
    (first, second, _), (roll, pitch, yaw) = parameters.gyroscopic_ratios, parameters.torque_gains
    for axis, (series, thrust, gain) in enumerate(
        [
            ([(q * r)[:, 0], -(n * lz) @ y], phi @ y, roll),
            ([(p * r)[:, 0], (n * lz) @ x], -(phi @ x), pitch),
            ([-(n * (x * ly - y * lx)).sum(axis=1)], phi @ spins, yaw),
        ]
    ):
        columns = [0.5 * (item[1:] + item[:-1]) for item in series] + [thrust]
        expected = [*((first,), (second,), ())[axis], parameters.rotor_rate_drag[axis], gain]
        scale = np.linalg.norm(columns, axis=1)
        slope = np.diff(truth.record.body[:, 10:13][:, axis]) / step
        result = np.linalg.lstsq(np.array(columns).T / scale, slope)[0] / scale
        assert result[-1] == pytest.approx(expected[-1], rel=1e-3)
        np.testing.assert_allclose(result, expected, rtol=0.01)  # trapezoids across kinks


def mean_squares(command, speed, step_s, lag_s):
    """Mean of the squared speed over each step, from its course under a held command."""
    away, left = speed - command, np.exp(-step_s / lag_s)
    once, twice = lag_s * (1.0 - left) / step_s, lag_s * (1.0 - left**2) / (2.0 * step_s)
    return command**2 + 2.0 * command * away * once + away**2 * twice


@pytest.mark.usefixtures("unchecked_shapes")
def test_sensor_filters_delays_and_errs():
    sensor = Sensor(WhiteNoise(0.0), bias=0.5, cutoff_hz=20.0, delay_s=0.01)
    step = np.r_[np.zeros(100), np.ones(400)][:, None]
    rng = np.random.default_rng(0)
    read = sensor.readings(step + sensor.errors(500, 1, rng), 0.002)[:, 0] - 0.5
    np.testing.assert_allclose(read[:105], 0.0, atol=1e-12)
    assert read[-1] == pytest.approx(1.0, abs=1e-9)
    late = np.sum(1.0 - read[100:]) * 0.002  # the area that is missing is the delay
    assert late == pytest.approx(sensor.lateness_s, abs=0.0015)
    assert Sensor(WhiteNoise(0.3)).errors(4000, 2, rng).std(axis=0) == pytest.approx([0.3, 0.3], rel=0.05)


@pytest.mark.usefixtures("unchecked_shapes")
def test_stamps_have_their_rate_offset_and_error():
    sensor = Sensor(rate_hz=100.0, offset_s=0.006, jitter_s=0.001)
    rows = sensor.rows(5000, 0.002)
    assert rows[:3].tolist() == [3, 8, 13]
    stamps = sensor.stamps(rows, 0.002, np.random.default_rng(1))
    assert np.diff(stamps).min() > 0.0
    assert np.std(stamps - 0.002 * rows) == pytest.approx(0.001, rel=0.1)
    assert Sensor(rate_hz=300.0).rows(1000, 0.002).size == 600
    assert np.array_equal(Sensor(rate_hz=1000.0).rows(100, 0.002), np.arange(100))


@pytest.mark.usefixtures("unchecked_shapes")
def test_each_group_has_its_own_stamps_and_some_are_left_out():
    spec = replace(
        QUIET_BODY,
        duration=0.4,
        sensors=replace(QUIET_BODY.sensors, angular_rate=Sensor(rate_hz=250.0)),
        logged=Logged(100.0, 50.0, 25.0, omitted=("rotor_command_*", "reference_velocity_z")),
    )
    channels = fly_body(spec).recording.channels
    assert not {"rotor_command_1", "reference_velocity_z"} & set(channels)
    counts = {"angular_rate_x": 100, "input": 20, "torque_setpoint_z": 20, "reference_position_z": 10}
    assert {name: channels[name].time_s.size for name in counts} == counts
    assert channels["velocity_z"].time_s.size == 200


@pytest.mark.usefixtures("unchecked_shapes")
def test_flights_side_by_side_are_those_alone():
    """Other vehicles, delays, filters, gains and winds beside it make no difference."""
    short = replace(LOUD_BODY, duration=0.3)
    controller = replace(LOUD_BODY.controller, hold=0.0, derivative_share=0.0)
    other = replace(short, vehicle=replace(VEHICLE, mass=1.0), controller=controller, seed=9)
    other = replace(other, sensors=Sensors(), wind=Wind(), injection=AxisExcitations())
    together = list(simulate_rigid_body_flights([short, other, replace(short, seed=6)]))
    for made, alone in zip(together, (fly_body(short), fly_body(other)), strict=False):
        identical(made, alone, lambda flight: [flight.truth.record], 1e-10)
        assert made.truth.parameters == alone.truth.parameters
    assert not np.array_equal(together[2].truth.record.body[:, 6:10], together[0].truth.record.body[:, 6:10])


@pytest.mark.usefixtures("unchecked_shapes")
def test_flights_of_several_lengths_keep_their_order():
    specs = [replace(QUIET_BODY, duration=length, seed=n) for n, length in enumerate((0.2, 0.1, 0.2))]
    flights = list(simulate_rigid_body_flights(specs))
    assert [len(flight.truth.record.body) for flight in flights] == [100, 50, 100]


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_lost_vehicle_is_told():
    torque = TorqueDisturbance(roll=OrnsteinUhlenbeck(600.0, 1.0))
    storm = replace(QUIET_BODY, duration=1.0, torque_disturbance=torque)
    assert not fly_body(storm).flew
    with pytest.raises(ParameterError, match="stays upright"):
        log_of_rigid_body_flight(storm)


@pytest.mark.usefixtures("unchecked_shapes")
def test_friction_of_the_truth_is_that_of_the_flights_speeds():
    """Up and down at 1 and 3 m/s: half of the squares' weight is not half of the samples."""
    truth = fly_body(replace(QUIET_BODY, duration=0.1)).truth
    dragged = replace(truth.parameters, drag=(0.1, 0.1, 0.2), quadratic_drag=(0.0, 0.0, 0.05))

    def flown(*climbs, attitude=(1.0, 0.0, 0.0, 0.0)):
        air = np.array([[0.0, 0.0, climb] for climb in climbs])
        record = replace(truth.record, body=np.tile([0.0] * 6 + [*attitude, 0.0, 0.0, 0.0], (len(climbs), 1)))
        return replace(truth, record=record, parameters=dragged, air_velocity=air)

    assert viscous_friction(flown(0.0, 0.0)) == 0.2
    assert viscous_friction(flown(2.0, -2.0)) == pytest.approx(0.2 + 0.05 * 2.0)
    assert viscous_friction(flown(1.0, -3.0)) == pytest.approx(0.2 + 0.05 * 28.0 / 10.0)
    sideways = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    assert viscous_friction(flown(2.0, attitude=sideways)) == pytest.approx(0.2)


ANGLES = np.pi / 3.0 * np.arange(6) + 0.2
HEXACOPTER = Vehicle(
    2.0,
    (0.02, 0.03, 0.04),
    Rotors(
        positions=tuple((0.3 * np.cos(a), 0.25 * np.sin(a), 0.0) for a in ANGLES.tolist()),
        spins=(1, -1, 1, -1, 1, -1),
        highest_speed=800.0,
        thrust_quadratic=1e-5,
        thrust_linear=1e-3,
        torque_ratio=0.02,
        lag_up=0.03,
        lag_down=0.03,
    ),
)


def test_mixer_gives_the_thrust_and_torques_that_are_asked_for():
    speeds = mixer_of(HEXACOPTER).commands(0.4, (0.1, -0.05, 0.08))
    force, torque = wrench(coefficients_of(HEXACOPTER), STILL, STILL, speeds)
    assert force[2] == pytest.approx(0.4 * HEXACOPTER.full_thrust)
    limits = torque_limits(HEXACOPTER)
    assert torque == pytest.approx((0.1 * limits[0], -0.05 * limits[1], 0.08 * limits[2]))


def test_quaternions_are_yaw_then_pitch_then_roll():
    angles = np.array([[0.3, -0.4, 1.2], [-0.1, 0.2, -2.0]])
    expected = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat(scalar_first=True)
    np.testing.assert_allclose(quaternions(angles), expected * np.sign(expected[:, :1]), atol=1e-12)


# Steps of the rigid body against closed forms.

ARM = 0.03
ROTORS = Rotors(
    positions=((ARM, ARM, 0.0), (ARM, -ARM, 0.0), (-ARM, -ARM, 0.0), (-ARM, ARM, 0.0)),
    spins=(1, -1, 1, -1),
    highest_speed=2500.0,
    thrust_quadratic=2.3e-8,
    torque_ratio=0.034,
    lag_up=0.07,
    lag_down=0.07,
)
SMALL = Vehicle(0.03, (1.4e-5, 1.5e-5, 2.6e-5), ROTORS)
DRAGGED = replace(
    SMALL, rotors=replace(ROTORS, drag=1e-6, inflow=7.5e-7), drag=BodyDrag(quadratic=(1e-3, 1e-3, 2e-3))
)
LEVEL = [0.0] * 6 + [1.0] + [0.0] * 6


def turning(rates):
    return LEVEL[:10] + list(rates)


def flown(coefficients, body, speeds, command, *, step_s, seconds, wind=STILL):
    """States of body and rotors at the start and after each step."""
    stepper = runge_kutta(coefficients, step_s)
    bodies, rotors = [body], [speeds]
    for _ in range(round(seconds / step_s)):
        body, speeds = stepper(body, speeds, command, wind, STILL)
        bodies.append(body)
        rotors.append(speeds)
    return np.array(bodies), np.array(rotors)


def rotations(bodies):
    return Rotation.from_quat(bodies[:, 6:10], scalar_first=True)


unchecked = pytest.mark.usefixtures("unchecked_shapes")  # thousands of steps of the same shapes


def test_small_steps_agree_with_scipys_integrator():
    vehicle = replace(DRAGGED, rotors=replace(DRAGGED.rotors, lag_down=0.02, inertia=1e-9))
    c, hover = coefficients_of(vehicle), vehicle.hover_speed
    command, wind = [1.1 * hover, hover, 0.9 * hover, hover], (2.0, 0.0, 0.0)
    body, speeds = turning((1.0, -2.0, 0.5)), [hover, hover, 1.1 * hover, 0.9 * hover]
    bodies, _ = flown(c, body, speeds, command, step_s=0.001, seconds=0.1, wind=wind)

    def slope(time, state):
        now = rotor_response(c, time)(speeds, command)
        change = speed_derivative(c, now, command)
        return body_derivative(c, state.tolist(), now, change, wind, STILL)

    solved = solve_ivp(slope, (0.0, 0.1), np.array(body), method="DOP853", rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(bodies[-1], solved.y[:, -1], atol=1e-9)


def test_rotors_that_speed_up_turn_the_body_the_other_way():
    """RotorPy has no inertia of rotors; here the yaw rate is that of the closed form."""
    vehicle = replace(SMALL, rotors=replace(ROTORS, inertia=2e-9, torque_ratio=0.0, lag_down=0.03))
    hover = vehicle.hover_speed
    command = [1.2 * hover, 0.9 * hover, 1.2 * hover, 0.9 * hover]
    bodies, rotors = flown(coefficients_of(vehicle), LEVEL, [hover] * 4, command, step_s=0.002, seconds=0.2)
    time = 0.002 * np.arange(bodies.shape[0])
    gained = -0.2 * hover * np.expm1(-time / 0.07), 0.1 * hover * np.expm1(-time / 0.03)
    np.testing.assert_allclose(rotors[:, 0] - hover, gained[0], atol=1e-9)
    np.testing.assert_allclose(rotors[:, 1] - hover, gained[1], atol=1e-9)
    # rotors 1 and 3 turn clockwise: as they speed up, the body is pushed counterclockwise
    expected = 2e-9 / 2.6e-5 * 2.0 * (gained[0] - gained[1])
    np.testing.assert_allclose(bodies[:, 12], expected, atol=1e-7)


@unchecked
def test_rotors_and_body_exchange_momentum():
    """Rotors that speed up while the body tumbles: the sum of both momenta stays."""
    idle = replace(ROTORS, inertia=3e-8, torque_ratio=0.0, thrust_quadratic=1e-30)
    vehicle = replace(SMALL, rotors=idle)
    speeds, command = [0.0] * 4, [1000.0, 200.0, 400.0, 0.0]
    body, how = turning((2.0, -1.0, 1.0)), {"step_s": 0.001, "seconds": 1.0}
    bodies, rotors = flown(coefficients_of(vehicle), body, speeds, command, **how)
    current = bodies[:, 10:] @ vehicle.inertia_matrix
    current[:, 2] -= 3e-8 * rotors @ np.array(idle.spins)
    total = rotations(bodies).apply(current)
    first = np.tile(total[0], (total.shape[0], 1))
    np.testing.assert_allclose(total, first, atol=1e-7 * np.linalg.norm(total[0]))
