"""The simulator of vertical motion against an independent integration, and batches against single flights."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from eivor.motions.vertical.model import GRAVITY
from eivor.simulation.vertical import (
    THRUST_RANGE,
    AltitudeController,
    SimulatedMotion,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)

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


def environment(count: int = 300) -> VerticalEnvironment:
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


def single(index: int) -> tuple[VerticalVehicles, VerticalEnvironment, AltitudeController]:
    """One of the flights alone."""
    met = environment()
    return (
        VerticalVehicles(*(getattr(VEHICLES, f.name)[[index]] for f in fields(VEHICLES))),
        VerticalEnvironment(*(getattr(met, f.name)[:, [index]] for f in fields(met))),
        AltitudeController(*(float(getattr(CONTROLLER, f.name)[index]) for f in fields(CONTROLLER))),
    )


def fly_all() -> SimulatedMotion:
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

    def received(time: float) -> float:
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


@pytest.mark.parametrize("index", range(4))
def test_batch_is_its_flights_one_by_one(index):
    together = fly_all()
    vehicles, met, controller = single(index)
    alone = simulate_vertical(vehicles, met, step_s=STEP_S, controller=controller)
    for part in fields(alone):
        np.testing.assert_allclose(
            getattr(alone, part.name)[:, 0], getattr(together, part.name)[:, index], rtol=1e-12, atol=1e-12
        )


def test_vehicle_in_equilibrium_stays_there():
    still = np.zeros((200, 4))
    met = VerticalEnvironment(still, still, still, still, still + 1.0, still, still, still)
    motion = simulate_vertical(VEHICLES, met, step_s=STEP_S, controller=CONTROLLER)
    np.testing.assert_allclose(motion.position, 0.0, atol=1e-12)
    np.testing.assert_allclose(motion.specific_force, GRAVITY, rtol=1e-12)


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
