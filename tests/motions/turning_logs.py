"""Logs of simulated turning: rate loops at 400 Hz about three axes, and rigid bodies with rotors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

import eivor as ev
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from flights.flight_logs import channel as logged

STEP_S = 0.0025
AXES = ("roll", "pitch", "yaw")
LETTERS = "xyz"


@dataclass(frozen=True)
class Vehicle:
    """Effectiveness [rad/s^2] and damping [1/s] by axis, lag [s], and delay in steps of the controller."""

    effectiveness: tuple[float, float, float] = (100.0, 80.0, 20.0)
    damping: tuple[float, float, float] = (0.5, 0.6, 0.3)
    lag_s: float = 0.035
    delayed: int = 2
    second_s: float = 0.0  # Lag of the motor's controller, before that of the rotor
    drag_moment: tuple[float, float, float] = (0.0, 0.0, 0.0)  # By the integral of the angle [1/s^3]

    @property
    def effective_lag_s(self):
        return self.lag_s + self.delayed * STEP_S


def steps(rng, count, size):
    """Steps to either side or back, at uneven times."""
    series, index = np.zeros(count), int(rng.uniform(0.0, 400.0))
    while index < count:
        series[index:] = size * rng.choice([-1.0, 0.0, 1.0])
        index += int(rng.uniform(0.7, 1.8) / STEP_S)
    return series


def turned(
    seed=0,
    *,
    vehicle=None,
    seconds=40.0,
    size=0.25,
    command_hz=50.0,
    rate_hz=200.0,
    disturbance=3.0,
    noise=0.1,
    injected=None,
    swept=None,
):
    """A log of attitude steps of some size [rad] about each axis.

    `injected` is added to the torques and logged, and `swept` is added to the attitude setpoint.
    """
    flight, rng, count = vehicle or Vehicle(), np.random.default_rng(seed), round(seconds / STEP_S)
    effect = np.array(flight.effectiveness)
    reference = np.stack([steps(rng, count, size) for _ in AXES], axis=1)
    reference += 0.0 if swept is None else swept
    kept = np.exp(-STEP_S / 0.3)
    torque = disturbance * lfilter(
        [np.sqrt(1.0 - kept**2)], [1.0, -kept], rng.standard_normal((count, 3)), axis=0
    )
    measured = noise * rng.standard_normal((count, 3))
    moves = [_discrete(flight, axis) for axis in range(3)]
    onward = np.stack([move[0] for move in moves])
    driven = np.stack([move[1] for move in moves])
    bandwidth = np.array([18.0, 18.0, 8.0])
    gain, derivative, outer = bandwidth / effect, 0.02 * bandwidth / effect, np.array([5.0, 5.0, 3.0])
    state = np.zeros((3, 3))
    issued = np.zeros((count + flight.delayed + 1, 3))
    slope, before, controlled = np.zeros(3), np.zeros(3), np.zeros(3)
    followed = 1.0 - np.exp(-STEP_S / flight.second_s) if flight.second_s else 1.0
    kept = np.exp(-2.0 * np.pi * 30.0 * STEP_S)
    rates, drift = np.empty((count, 3)), np.zeros(3)
    for k in range(count):
        rate = state[:, 1] + measured[k]
        rates[k] = rate
        slope = kept * slope + (1.0 - kept) * (before - rate) / STEP_S
        before = rate
        wanted = outer * (reference[k] - state[:, 2]) - rate
        requested = gain * wanted + derivative * slope + (0.0 if injected is None else injected[k])
        issued[k + flight.delayed] = np.clip(requested, -1.0, 1.0)
        controlled = controlled + followed * (issued[k] - controlled)
        drift += STEP_S * state[:, 2]
        inputs = np.stack([controlled, torque[k] - np.array(flight.drag_moment) * drift], axis=1)
        state = (onward @ state[:, :, None] + driven @ inputs[:, :, None])[:, :, 0]
    time = np.arange(count) * STEP_S
    looked = np.arange(0.0, seconds - 0.5 * STEP_S, 1.0 / command_hz)
    kept, seen = np.unique(np.rint(looked / STEP_S).astype(int)), round(1.0 / (rate_hz * STEP_S))
    channels = {}
    for axis, (name, letter) in enumerate(zip(AXES, LETTERS, strict=True)):
        command = issued[flight.delayed + kept, axis]
        if injected is not None:
            name_of_sweep = f"injected_torque_{letter}"
            channels[name_of_sweep] = logged(name_of_sweep, time, injected[:, axis])
        for channel, item, values, unit, held in (
            (f"angular_rate_{letter}", time[::seen], rates[::seen, axis], "rad/s", False),
            (f"torque_setpoint_{letter}", time[kept], command, "", True),
            (f"reference_{name}", time[::8], reference[::8, axis], "rad", True),
        ):
            channels[channel] = replace(logged(channel, item, values), unit=unit, source="", held=held)
    return ev.Recording("turned.csv", "csv", channels)


def _discrete(vehicle, axis):
    """Exact step of (actuator, rate, angle) under a held command and a held torque."""
    effect, damping = vehicle.effectiveness[axis], vehicle.damping[axis]
    continuous = np.zeros((5, 5))
    continuous[0, [0, 3]] = -1.0 / vehicle.lag_s, 1.0 / vehicle.lag_s
    continuous[1, [0, 1, 4]] = effect, -damping, 1.0
    continuous[2, 1] = 1.0
    step = expm(continuous * STEP_S)
    return step[:3, :3], step[:3, 3:]


CRAZYFLIE = shipped_rigid_body_flight("crazyflie")


def known(vehicle=CRAZYFLIE.vehicle, **given):
    """What the file of a simulated vehicle says: no heights, and not where its centre of mass lies."""
    rotors = vehicle.rotors
    return KnownVehicle("simulated", tuple((x, y) for x, y, _ in rotors.positions), rotors.spins, **given)


#: The rigid body of that vehicle; of one whose delay is known, the search takes a fraction of the time.
BODY, DELAY_KNOWN = RigidBody(known()), RigidBody(known(delay=KnownNumber(0.0)))


def combinations(parameters):
    """What a flight shows of a rigid body, by the names of quantities."""
    turning = {"gain": parameters.torque_gains, "coupling": parameters.gyroscopic_ratios}
    turning["damping"] = parameters.rate_damping
    return {
        **{f"{a}_{n}": v for n, values in turning.items() for a, v in zip(AXES, values, strict=True)},
        **{f"drag_{letter}": drag for letter, drag in zip(LETTERS, parameters.drag, strict=True)},
        "thrust_gain": parameters.thrust_gain,
    }


def body_flown(spec=CRAZYFLIE, **changes):
    """A simulated flight of a rigid body."""
    (flight,) = simulate_rigid_body_flights([replace(spec, **changes)])
    return flight
