"""Closed loops of RotorPy, a simulator of others, as logs of the study.

Equations of motion and allocation are RotorPy's. The loops of rates, attitude and height, the steps of
integration and what is measured are this file's: no part of a flight is Eivor's simulator.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from eivor.signals.recording import Recording
from eivor.simulation.environment import simulated_recording
from validation.flight_recipe.rotorpy_flight import hover_speed, vehicle_parameters

#: Of the loops [Hz]; that of rates is as fast as the log where that is faster.
RATE_HZ, ATTITUDE_HZ, HEIGHT_HZ = 500.0, 250.0, 50.0
#: Steps of roll, pitch and yaw [rad], and how long they last [s].
STEPS = ((0.25, 0.7, 1.8), (0.25, 0.7, 1.8), (0.3, 1.5, 4.0))
#: Sweeps [Hz], how long each lasts [s]; what they turn the loops by [rad], of the torque at hover at most.
SWEEP_HZ, SWEEPS_S, SWEEP_RAD, SWEEP_SHARE = (0.5, 8.0), (9.0, 11.0, 7.0), 0.15, 0.1
#: Torques of the air over the sweeps, their correlation [s]; noise of rotors over their speed at hover.
AIR, AIR_S, ROTOR_NOISE = 0.05, 0.3, 0.002


#: How often each vehicle is logged [Hz], and the delay of its commands [s].
LOGGED = {
    "crazyflie": (100.0, 0.004),
    "crazyflie-brushless": (1000.0, 0.003),
    "hummingbird": (250.0, 0.006),
    "quadrotor-1.5kg": (500.0, 0.008),
    "hexarotor-2.4kg": (250.0, 0.006),
}
SAMPLED = [
    *(
        f"{name}_{axis}"
        for name in ("angular_rate", "specific_force_body", "velocity", "position")
        for axis in "xyz"
    ),
    *(f"attitude_{part}" for part in "xyzw"),
]
HELD = [
    *(f"reference_{name}" for name in ("position_z", "velocity_z", "acceleration_z", "roll", "pitch", "yaw")),
    *(f"injected_torque_{axis}" for axis in "xyz"),
]


def series_of(rng: np.random.Generator, count: int, step_s: float, most: Any) -> dict[str, Any]:
    """Attitudes, heights, sweeps and torques of the air of a flight, of so large sweeps [rad/s^2]."""
    time_s, attitude = step_s * np.arange(count), np.zeros((count, 3))
    for axis, (size, shortest, longest) in enumerate(STEPS):
        begin = int(1.0 / step_s)
        while begin < count:
            end = begin + int(rng.uniform(shortest, longest) / step_s)
            attitude[begin:end, axis] = size * rng.uniform(-1.0, 1.0)
            begin = end
    attitude[:, 2] = lfilter([step_s / 0.3], [1.0, step_s / 0.3 - 1.0], attitude[:, 2])
    pulse = 2.0 * np.pi * np.array([0.1, 0.17, 0.29, 0.43, 0.61])
    waves = np.exp(1j * (np.outer(time_s, pulse) + rng.uniform(0.0, 2.0 * np.pi, 5))) / pulse**1.5
    height = np.stack([waves, 1j * pulse * waves, -(pulse**2) * waves], axis=1).sum(axis=2).real
    height *= min(1.8 / np.abs(height[:, 1]).max(), 3.0 / np.abs(height[:, 2]).max())
    grows = np.log(SWEEP_HZ[1] / SWEEP_HZ[0])
    into = np.stack([(time_s + rng.uniform(0.0, long)) % long / long for long in SWEEPS_S], axis=1)
    phase = 2.0 * np.pi * SWEEP_HZ[0] * np.array(SWEEPS_S) * np.expm1(grows * into) / grows
    decay = np.exp(-step_s / AIR_S)
    air = lfilter([np.sqrt(1.0 - decay**2)], [1.0, -decay], rng.standard_normal((count, 3)), axis=0)
    return {"attitude": attitude, "height": height, "sweep": most * np.sin(phase), "air": AIR * most * air}


def stepped(slope: Any, state: Any, first: Any, step_s: float) -> Any:
    """The classical method of the fourth order."""
    second = slope(state + 0.5 * step_s * first)
    third = slope(state + 0.5 * step_s * second)
    return state + step_s / 6.0 * (first + 2.0 * (second + third) + slope(state + step_s * third))


def logged_flight(vehicle: str, seed: int, seconds: float, noise: Sequence[float]) -> Recording | None:
    """Log of a flight under sensors of such noise, None of one that was lost."""
    from rotorpy.vehicles.multirotor import Multirotor

    parameters, (log_hz, delay_s) = vehicle_parameters(vehicle, None), LOGGED[vehicle]
    rate_hz = max(RATE_HZ, log_hz)
    with patch.object(np.linalg, "inv", np.linalg.pinv):  # the allocation of six rotors is not square
        body = Multirotor(parameters, control_abstraction="cmd_ctbm")
    step_s, hover, rotors = 1.0 / rate_hz, hover_speed(parameters), body.num_rotors
    slow_s = body.tau_m + delay_s + step_s
    quick, lifts = min(0.6 / slow_s, 20.0), min(0.35 / (slow_s + 0.5 / HEIGHT_HZ), 5.0)
    turns = quick * np.array([0.5, 0.5, 0.25])
    arms = np.abs([body.f_to_TM[1], body.f_to_TM[2], body.f_to_TM[3]]).sum(axis=1) / np.diag(body.inertia)
    sweeps = np.minimum(SWEEP_RAD * quick * turns, SWEEP_SHARE * body.k_eta * hover**2 * arms)
    rng, count = np.random.default_rng(seed), round(seconds * rate_hz)
    made = series_of(rng, count, step_s, sweeps)
    errors = [std * rng.standard_normal((count, 3)) for std in noise]
    wanted = Rotation.from_euler("ZYX", made["attitude"][:, ::-1])
    state = np.concatenate([np.zeros(9), [1.0], np.zeros(6), np.full(rotors, hover)])
    state[[2, 5]] = made["height"][0, :2]
    pending = deque([state[16:]] * round(delay_s * rate_hz))
    rotor_noise = ROTOR_NOISE * hover * np.sqrt(2.0 * step_s / body.tau_m)
    every, rows = round(rate_hz / log_hz), []
    for k in range(count):
        acting, push = pending.popleft(), np.zeros(16 + rotors)
        push[10:13] = made["air"][k]

        def slope(at: Any, acting: Any = acting, push: Any = push) -> Any:
            return body._s_dot_fn(0.0, at, acting) + push

        first = slope(state)
        rate, velocity, position = (
            true + errors[of][k] for of, true in ((0, state[10:13]), (2, state[3:6]), (3, state[:3]))
        )
        height, climb, upward = made["height"][k]
        if k % round(rate_hz / ATTITUDE_HZ) == 0 or k % every == 0:
            truly = Rotation.from_quat(state[6:10])
            attitude = truly * Rotation.from_rotvec(errors[4][k])
            cosine = attitude.as_matrix()[2, 2]
        if not (cosine > 0.17 and abs(position[2] - height) < 5.0):
            return None
        if k % round(rate_hz / HEIGHT_HZ) == 0:
            upward += lifts * (climb + 0.3 * lifts * (height - position[2]) - velocity[2])
            thrust = body.mass * (body.g + upward) / max(cosine, 0.5)
        if k % round(rate_hz / ATTITUDE_HZ) == 0:
            rates = turns * (attitude.inv() * wanted[k]).as_rotvec()
        moment = body.inertia @ (quick * (rates - rate) + made["sweep"][k])
        command = body.get_cmd_motor_speeds({}, {"cmd_thrust": thrust, "cmd_moment": moment})
        pending.append(np.clip(command, body.rotor_speed_min, body.rotor_speed_max))
        if k % every == 0:
            force = truly.apply(first[3:6] + np.array([0.0, 0.0, body.g]), inverse=True) + errors[1][k]
            rows.append([*pending[-1], *rate, *force, *velocity, *position, *attitude.as_quat()])
        state = stepped(slope, state, first, step_s)
        state[6:10] /= np.linalg.norm(state[6:10])
        state[16:] += rotor_noise * rng.standard_normal(rotors)
    log = np.array(rows).T
    references = np.concatenate([made["height"], made["attitude"], made["sweep"]], axis=1)[::every]
    commands = {f"rotor_command_{number}": series for number, series in enumerate(log[:rotors], start=1)}
    recording = simulated_recording(
        f"RotorPy, seed {seed}",
        "rotorpy",
        step_s * np.arange(0, count, every),
        commands | dict(zip((*HELD, *SAMPLED), (*references.T, *log[rotors:]), strict=True)),
    )
    return replace(recording, parameters={})  # an autopilot's log does not say how fast its loop is
