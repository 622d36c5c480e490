"""Controlled vehicles against plain loops, a matrix exponential, an integrator, and each other."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import eivor as ev
from eivor.errors import ParameterError
from eivor.lab.records import AltitudeControl, DisturbanceRoute, VelocityControl, pushed_motion
from eivor.motions.vertical.model import GRAVITY
from eivor.simulation.excitation import SteppedExcitation, WhiteDisturbance, WhiteExcitation
from eivor.simulation.vertical import (
    THRUST_RANGE,
    AltitudeController,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)

K, K_U, T = 0.293, 0.021, 0.2
VELOCITY = VelocityControl(15.0, 4.0)
ALTITUDE = AltitudeControl(0.4, 30.0, 5.0)
CONTROLS = [VELOCITY, VelocityControl(15.0), ALTITUDE, AltitudeControl(0.4, 30.0)]
QUIET = ev.Scenario(K, K_U, samples=150, excitation=WhiteExcitation(1.0), control=ALTITUDE)
NOISY = replace(
    QUIET,
    noise={
        "velocity_z": ev.FractionalNoise(0.02, -0.4),
        "acceleration_z": ev.WhiteNoise(0.1),
        "input": ev.WhiteNoise(0.5),
        "position_z": ev.FractionalNoise(0.05, -0.2),
    },
    disturbance=WhiteDisturbance(0.05),
    route=DisturbanceRoute.DYNAMICS,
)


def rng(seed=1):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("control", CONTROLS, ids=str)
@pytest.mark.parametrize("route", list(DisturbanceRoute))
@pytest.mark.parametrize("friction", [0.0, K])
def test_loop_is_that_of_a_flight_controller(control, route, friction):
    """Sample by sample, in the order in which a controller computes; motion between samples by expm."""
    noise = {name: NOISY.noise[name] for name in ("velocity_z", "input")}
    if isinstance(control, AltitudeControl):
        noise["position_z"] = NOISY.noise["position_z"]
    scenario = replace(NOISY, viscous_friction=friction, control=control, noise=noise, route=route)
    result = ev.simulate(scenario, rng())
    truth, signals = result.truth.channels, result.signals.channels
    errors = {name: signals[name] - truth[name] for name in noise}
    flow = expm(T * np.array([[-friction, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    velocity, altitude, total = 0.0, 0.0, 0.0
    reference, disturbance = truth[control.reference], truth["disturbance"]
    for k in range(scenario.samples):
        setpoint = reference[k]
        if isinstance(control, AltitudeControl):
            assert truth["position_z"][k] == pytest.approx(altitude, abs=1e-11)
            setpoint = control.altitude_gain * (reference[k] - altitude - errors["position_z"][k])
        missing = setpoint - velocity - errors["velocity_z"][k]
        total += missing
        u = control.velocity_gain * missing + control.velocity_integral_gain * T * total
        assert truth["velocity_z"][k] == pytest.approx(velocity, abs=1e-11)
        assert truth["input"][k] == pytest.approx(u, abs=1e-9)
        force = K_U * u + disturbance[k]
        assert truth["acceleration_z"][k] == pytest.approx(force - friction * velocity, abs=1e-11)
        push = K_U * u + (disturbance[k] if route is DisturbanceRoute.DYNAMICS else 0.0)
        velocity, altitude, _ = flow @ [velocity, altitude, push]


def test_altitude_follows_its_reference():
    """Without steady error, also against a constant push, since the velocity's errors are summed."""
    steps = replace(QUIET, excitation=SteppedExcitation((1.0,), 1e6), samples=1500)
    result = ev.simulate(steps, rng())
    assert result.truth.channel("position_z")[-1] == pytest.approx(1.0, abs=1e-8)
    assert result.truth.channel("position_z")[0] == 0.0
    np.testing.assert_array_equal(result.signals.channel("reference_position_z"), 1.0)
    pushed = pushed_motion(steps, np.full(1500, 0.3))
    assert pushed.altitude is not None
    assert pushed.altitude[-1] == pytest.approx(0.0, abs=1e-7)
    assert pushed.input[-1] == pytest.approx(-0.3 / K_U, rel=1e-6)


def loop_by_columns(control):
    """Matrix of the loop, each column by letting the controller and the vehicle make one step."""
    assert isinstance(control, VelocityControl | AltitudeControl)
    altitude_gain = control.altitude_gain if isinstance(control, AltitudeControl) else 0.0
    a, held = np.exp(-K * T), (1.0 - np.exp(-K * T)) / K
    columns = []
    for velocity, altitude, total in np.eye(3):
        missing = -altitude_gain * altitude - velocity
        u = control.velocity_gain * missing + control.velocity_integral_gain * T * (total + missing)
        pushed = K_U * u
        climbed = altitude + held * velocity + (T - held) / K * pushed
        columns.append([a * velocity + held * pushed, climbed, total + missing])
    used = [True, altitude_gain != 0.0, control.velocity_integral_gain != 0.0]
    return np.array(columns).T[np.ix_(used, used)]


@pytest.mark.parametrize("altitude", [0.0, 0.3, 3.0, 40.0])
@pytest.mark.parametrize("gain", np.geomspace(1.0, 900.0, 8).tolist())
@pytest.mark.parametrize("integral", [0.0, 0.4, 40.0, 1500.0])
def test_loops_called_stable_are(altitude, gain, integral):
    control = AltitudeControl(altitude, gain, integral) if altitude else VelocityControl(gain, integral)
    stable = bool(np.abs(np.linalg.eigvals(loop_by_columns(control))).max() < 1.0)
    try:
        replace(QUIET, control=control)
        accepted = True
    except ParameterError:
        accepted = False
    assert accepted == stable


STEP_S = 0.01
VEHICLES = VerticalVehicles(
    viscous_friction=np.array([0.18, 0.87, 0.4, 0.5]),
    input_gain=np.array([40.0, 25.0, 9.0, 1.5e-5]),
    lag_s=np.array([0.005, 0.12, 0.03, 0.06]),
    delay_s=np.array([0.02, 0.0, 0.014, 0.006]),
)
CONTROLLER = AltitudeController(
    position_gain=np.array([1.2, 0.8, 1.0, 0.9]),
    velocity_gain=np.array([4.0, 2.2, 3.0, 2.5]),
    integral_gain=np.array([1.0, 0.3, 0.5, 0.4]),
)


def environment(count=300):
    """Everything at once: trajectory, wind, tilt and noise, different for each flight."""
    rng = np.random.default_rng(5)
    time = STEP_S * np.arange(count)[:, None]
    pulsation = np.array([1.0, 2.0, 3.0, 5.0])
    gust = np.cumsum(0.1 * rng.standard_normal((count, 4)), axis=0)
    return VerticalEnvironment(
        reference_position=np.sin(pulsation * time),
        reference_velocity=pulsation * np.cos(pulsation * time),
        reference_acceleration=-(pulsation**2) * np.sin(pulsation * time),
        gust=gust,
        cos_tilt=np.cos(0.1 * np.sin(2.0 * time + pulsation)),
        position_noise=0.01 * rng.standard_normal((count, 4)),
        velocity_noise=0.05 * rng.standard_normal((count, 4)),
        acceleration_noise=np.zeros((count, 4)),
    )


def single(index):
    """One of the flights alone."""
    met = environment()
    return (
        VerticalVehicles(*(getattr(VEHICLES, f.name)[[index]] for f in fields(VEHICLES))),
        VerticalEnvironment(*(getattr(met, f.name)[:, [index]] for f in fields(met))),
        AltitudeController(*(float(getattr(CONTROLLER, f.name)[index]) for f in fields(CONTROLLER))),
    )


def fly_all():
    return simulate_vertical(VEHICLES, environment(), step_s=STEP_S, controller=CONTROLLER)


@pytest.mark.parametrize("index", range(4))
def test_flight_is_that_of_an_independent_integration(index):
    """The closed loop once more: one flight, the equations as they are written, a general integrator."""
    vehicle, met, gains = (
        {f.name: np.squeeze(getattr(part, f.name)) for f in fields(part)} for part in single(index)
    )
    motion = fly_all()
    K, K_u, lag = vehicle["viscous_friction"], vehicle["input_gain"], vehicle["lag_s"]
    hover = np.sqrt(GRAVITY / K_u)
    state = np.array([hover, met["reference_position"][0], met["reference_velocity"][0]])
    integral, issued = 0.0, []

    def received(time):
        period = int(np.floor((time - vehicle["delay_s"]) / STEP_S + 1e-6))
        return issued[period] if period >= 0 else hover

    for k in range(met["gust"].size):
        w, z, v = state
        force = K_u * met["cos_tilt"][k] * w**2 - K * (v - met["gust"][k])
        results = (motion.rotor_state, motion.position, motion.velocity, motion.specific_force)
        ours = [column[k, index] for column in results]
        np.testing.assert_allclose(ours, [w, z, v, force], rtol=1e-9, atol=1e-8)
        wanted = met["reference_velocity"][k]
        wanted += gains["position_gain"] * (met["reference_position"][k] - z - met["position_noise"][k])
        error = wanted - v - met["velocity_noise"][k]
        integral += error * STEP_S
        pull = GRAVITY + met["reference_acceleration"][k]
        pull += gains["velocity_gain"] * error + gains["integral_gain"] * integral
        thrust = np.clip(pull / met["cos_tilt"][k] / GRAVITY, *THRUST_RANGE[:, 0])
        issued.append(hover * np.sqrt(thrust))
        assert motion.command[k, index] == pytest.approx(issued[-1], rel=1e-9)

        def derivative(_, y, command, k=k):
            lift = K_u * met["cos_tilt"][k] * y[0] ** 2
            return [(command - y[0]) / lag, y[2], lift - K * (y[2] - met["gust"][k]) - GRAVITY]

        # A command that comes late arrives inside a control period: integrate up to there, then on.
        start = k * STEP_S
        arrival = start + vehicle["delay_s"] % STEP_S
        for begin, end in ((start, arrival), (arrival, start + STEP_S)):
            if end - begin > 1e-9:
                command = received(0.5 * (begin + end))
                state = solve_ivp(
                    derivative, (begin, end), state, "DOP853", rtol=1e-11, atol=1e-12, args=(command,)
                ).y[:, -1]


def test_thrust_stays_in_its_range():
    wild = environment()
    hard = VerticalEnvironment(
        *(
            getattr(wild, f.name) * (300.0 if f.name == "reference_acceleration" else 1.0)
            for f in fields(wild)
        )
    )
    command = simulate_vertical(VEHICLES, hard, step_s=STEP_S, controller=CONTROLLER).command
    share = command**2 * VEHICLES.input_gain / GRAVITY
    assert share.min() == pytest.approx(THRUST_RANGE[0, 0])
    assert share.max() == pytest.approx(THRUST_RANGE[1, 0])
