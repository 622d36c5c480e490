"""Thrust and inertias of a Crazyflie by the recipe of those who published them, and what each step does.

    python -m validation.crazyflie.study ../shared/data/arpl-crazyflie

prints the tables of `docs/crazyflie.md`. Some seconds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from eivor.logs.crazyflie.reader import parse_header, read_events
from eivor.tools import Float

#: Of the one type of events that these logs have.
STAMP_S = 1e-6
#: A step of so many usual ones ends a stretch, and stretches below this share of the window are left out.
GAP, SHORTEST_SHARE = 3.0, 0.01
ROTORS = range(1, 5)


@dataclass(frozen=True)
class Stretch:
    time_s: Float[np.ndarray, " n"]  # Stamps since the vehicle was switched on [s]
    force_g: Float[np.ndarray, " n"]  # Accelerometer along z [g]
    rates: Float[np.ndarray, "n 3"]  # Body rates [rad/s]
    commands: Float[np.ndarray, "n 4"]  # Of the motors, 0 to 65535


def stretches(log: Path, window: tuple[float, float]) -> tuple[Stretch, ...]:
    """Stretches of a log within a window [s since the vehicle was switched on]."""
    data = log.read_bytes()
    event = read_events(data, parse_header(data, log.name))[0][0]
    time = event.records["stamp"].astype(np.float64) * STAMP_S
    rates = np.deg2rad(np.column_stack([event.values(f"gyro.{axis}") for axis in "xyz"]))
    commands = np.column_stack([event.values(f"motor.m{rotor}") for rotor in ROTORS])
    force = event.values("acc.z")
    inside = np.flatnonzero((time > window[0]) & (time < window[1]))
    return tuple(
        Stretch(time[part], force[part], rates[part], commands[part]) for part in _parts(inside, time)
    )


def _parts(inside: np.ndarray, time: Float[np.ndarray, " n"]) -> Sequence[np.ndarray]:
    """Numbers of the samples of each stretch, without the ones beside gaps and the window's ends."""
    step = np.diff(time[inside])
    edges = [0, *(np.flatnonzero(step > GAP * np.median(step)) + 1).tolist(), inside.size]
    shortest = SHORTEST_SHARE * (time[inside[-1]] - time[inside[0]])
    results = [inside[first + 1 : last - 1] for first, last in pairwise(edges)]
    return [part for part in results if part.size and time[part[-1]] - time[part[0]] > shortest]


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
        return cls(
            stretches(folder / THRUST_LOG, THRUST_WINDOW), stretches(folder / TILTING_LOG, TILTING_WINDOW)
        )


def numbers(logs: Logs, steps: Steps) -> Numbers:
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
    product = float(torque @ change)
    return (
        float(torque @ torque) / product if steps.torque_has_the_noise else product / float(change @ change)
    )


#: Exit code for an input that cannot be used.
WRONG = 2
HEAD = (
    "| | $c_0$, $c_1$, $c_2$ [N] | residual [m/s²] | $I_{xx}$ | $I_{yy}$ | $I_{zz}$ [1e-5 kg m²] |",
    "|---|---|---|---|---|---|",
)


def variants(logs: Logs) -> dict[str, Steps]:
    """Steps by what is told of them, the published ones first."""
    result = best_lag(logs.thrust)
    return {
        f"found again, lag {1e3 * PUBLISHED_LAG_S:.1f} ms as published": Steps(),
        f"lag {1e3 * result:.1f} ms, at which the residual is smallest": Steps(lag_s=result),
        "g along z is 9.81 in place of 9.18 m/s²": Steps(gravity=9.81),
        "full power is 65535 in place of 65536": Steps(full_power=65535.0),
        "even stamps in place of the logged ones": Steps(corrected_stamps=True),
        "thrust of the roll and pitch log itself": Steps(own_thrust=True),
        "rates' differences on torque in place of torque on them": Steps(torque_has_the_noise=True),
    }


def line(words: str, result: Numbers) -> str:
    curve = ", ".join(f"{item:.4f}" for item in result.thrust)
    residual = "" if result.residual != result.residual else f"{result.residual:.4f}"
    inertias = " | ".join(f"{1e5 * item:.3f}" for item in result.inertia)
    return f"| {words} | {curve} | {residual} | {inertias} |"


def table(folder: Path) -> list[str]:
    """Rows of the table: what was published, what was found again, and what each step does."""
    logs = Logs.of_folder(folder)
    rows = [line(words, numbers(logs, steps)) for words, steps in variants(logs).items()]
    return [*HEAD, line("published", PUBLISHED), *rows]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m validation.crazyflie.study", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with log10 and log15")
    folder = parser.parse_args(arguments).folder
    try:
        print("\n".join(table(folder)))
    except OSError as error:
        print(f"Expected a folder with log10 and log15, received '{folder}': {error}", file=sys.stderr)
        return WRONG
    return 0


if __name__ == "__main__":
    sys.exit(main())
