"""The published recipe in our own words, each step with the choice that can be made in it.

It is that of Eschmann, Albani and Loianno, "Data-Driven System Identification of Quadrotors Subject to Motor
Delays" (2024).

Notation: u a motor's command as a share, n its state behind a first-order lag T, f = c0 + c1 n + c2 n^2 its
thrust, m mass, l what a rotor is forward and left of the centre, s_z specific force, h a step of the stamps.

1. Stretches between gaps of the stated windows; in each step as logged n moves by 1 - exp(-h/T) of its
   distance from u.
2. Thrust: m s_z on the sums over the rotors of 1, n, n^2 by least squares, of the log with thrust manoeuvres.
3. Inertias: the torque l sum +-f of that thrust on the central differences of the rates, neither filtered nor
   delayed, through the origin, of the log with roll and pitch manoeuvres.
4. The inertia in yaw: a ratio of the mean of the other two that is assumed.

They say that T is the lag that explains thrust best. How it was searched for, with which steps, is published
nowhere: searched for finely, the smallest residual is at another lag than theirs (`best_lag`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from eivor.tools import Float
from validation.crazyflie.stretches import Stretch, stretches

MASS_KG, ARM_M = 0.027, 0.028
#: Signs of the rotors' arms about the forward and the left axis, in the order of the motors.
LEFT, FORWARD = np.array([-1.0, -1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0, 1.0])
THRUST_LOG, THRUST_WINDOW = "log10", (35.0, 65.0)
TILTING_LOG, TILTING_WINDOW = "log15", (55.0, 90.0)
#: Izz over the mean of Ixx and Iyy.
ASSUMED_RATIO = 1.832
#: Between which lags the smallest residual is looked for [s].
LAGS_S = (0.03, 0.15)


@dataclass(frozen=True, slots=True)
class Steps:
    """What can be chosen in the steps; the defaults are what gives the published numbers."""

    lag_s: float = 0.0716  # Of the motors [s]
    gravity: float = 9.18  # What an accelerometer's g along z counts as [m/s^2]
    full_power: float = 65536.0  # Command that is full power
    corrected_stamps: bool = False  # Steps of the mean length in place of the logged ones
    own_thrust: bool = False  # Thrust of the log with roll and pitch manoeuvres itself
    # The rates' differences regressed on the torque in place of the torque on them
    torque_has_the_noise: bool = False


@dataclass(frozen=True, slots=True)
class Numbers:
    """What comes out."""

    thrust: tuple[float, float, float]  # c0, c1, c2 of a rotor [N]
    residual: float  # Root mean square of the specific force that thrust does not explain [m/s^2]
    inertia: tuple[float, float, float]  # Ixx, Iyy, Izz [kg m^2]


#: Lag [s], and numbers as they were published; nothing is known of the residual.
PUBLISHED = Numbers((0.0213, -0.0112, 0.1201), float("nan"), (1.029e-5, 1.105e-5, 1.955e-5))
PUBLISHED_LAG_S = 0.0716


@dataclass(frozen=True)
class Logs:
    """Stretches of the two logs that the recipe takes."""

    thrust: tuple[Stretch, ...]  # With thrust manoeuvres, and with those of roll and pitch
    tilting: tuple[Stretch, ...]

    @classmethod
    def of_folder(cls, folder: Path) -> Logs:
        """Those of a folder."""
        return cls(
            stretches(folder / THRUST_LOG, THRUST_WINDOW), stretches(folder / TILTING_LOG, TILTING_WINDOW)
        )


def numbers(logs: Logs, steps: Steps) -> Numbers:
    """Thrust and inertias by the steps."""
    curve, residual = thrust_curve(logs.tilting if steps.own_thrust else logs.thrust, steps)
    force = [_states(item, steps) for item in logs.tilting]
    thrusts = np.concatenate([curve[0] + n * curve[1] + n**2 * curve[2] for n in force])
    change = np.concatenate(
        [np.gradient(item.rates[:, :2], _time(item, steps), axis=0) for item in logs.tilting]
    )
    about_x = _ratio(ARM_M * thrusts @ LEFT, change[:, 0], steps)
    about_y = _ratio(-ARM_M * thrusts @ FORWARD, change[:, 1], steps)
    about_z = ASSUMED_RATIO * 0.5 * (about_x + about_y)
    return Numbers((curve[0], curve[1], curve[2]), residual, (about_x, about_y, about_z))


def thrust_curve(parts: Sequence[Stretch], steps: Steps) -> tuple[list[float], float]:
    """Coefficients of a rotor's thrust [N], and the root mean square of the residual [m/s^2]."""
    states = np.concatenate([_states(part, steps) for part in parts])
    regressors = np.column_stack([np.full(len(states), 4.0), states.sum(axis=1), (states**2).sum(axis=1)])
    measured = np.concatenate([steps.gravity * part.force_g for part in parts])
    result, *_ = np.linalg.lstsq(regressors / MASS_KG, measured, rcond=None)
    return result.tolist(), float(np.std(measured - regressors @ result / MASS_KG))


def best_lag(parts: Sequence[Stretch]) -> float:
    """Lag with the smallest residual of thrust [s], by even stamps, which hardly move it and are quicker."""

    def residual(lag_s: float) -> float:
        return thrust_curve(parts, Steps(lag_s=lag_s, corrected_stamps=True))[1]

    return float(minimize_scalar(residual, bounds=LAGS_S, method="bounded", options={"xatol": 1e-5}).x)


def _time(stretch: Stretch, steps: Steps) -> Float[np.ndarray, " n"]:
    if not steps.corrected_stamps:
        return stretch.time_s
    return np.asarray(np.linspace(stretch.time_s[0], stretch.time_s[-1], stretch.time_s.size))


def _states(stretch: Stretch, steps: Steps) -> Float[np.ndarray, "n 4"]:
    """States of the motors behind their commands."""
    commands = stretch.commands / steps.full_power
    if steps.corrected_stamps:
        step_s = (stretch.time_s[-1] - stretch.time_s[0]) / (stretch.time_s.size - 1)
        kept = float(np.exp(-step_s / steps.lag_s))
        started = kept * commands[:1]
        return np.asarray(lfilter([1.0 - kept], [1.0, -kept], commands, axis=0, zi=started)[0])
    states = commands.copy()
    for k, kept in enumerate(np.exp(-np.diff(stretch.time_s) / steps.lag_s), start=1):
        states[k] += kept * (states[k - 1] - states[k])
    return states


def _ratio(torque: Float[np.ndarray, " n"], change: Float[np.ndarray, " n"], steps: Steps) -> float:
    """Torque over change of rate."""
    product = float(torque @ change)
    return (
        float(torque @ torque) / product if steps.torque_has_the_noise else product / float(change @ change)
    )
