"""Study of frequency responses: coverage of bands, orders, parameters and margins in simulated closed loops.

`python -m validation.frequency_responses --runs 100` prints a line of JSON for each row.
Loops are this file's own: a rate loop (PI, 400 Hz) within an attitude loop, actuators of order 1 to 3 with a
delay, a gyroscope's filter of 60 Hz and its noise, and torques of the wind.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.signal import chirp, lfilter

from eivor.errors import EstimationError
from eivor.models.frequency_response import frequency_response
from eivor.models.transfer_functions import (
    loop_margins,
    margin_intervals,
    proposed_controllers,
    transfer_functions,
)

STEP_S, FILTER_HZ, NOISE, WIND_S = 0.0025, 60.0, 0.02, 0.3
#: Bins of the delay: two of 1.25 ms for each step.
DELAYS = 12


@dataclass(frozen=True)
class Loops:
    """Vehicles, one for each run."""

    order: int  # 1: turning; 2: and a lag; 3: and a motor controller's
    K: np.ndarray
    D: np.ndarray
    lag: np.ndarray  # Sum of both time constants [s]
    delay: np.ndarray  # Whole multiples of 1.25 ms [s]
    kp: np.ndarray
    ti: np.ndarray
    ka: np.ndarray  # Of the attitude loop [1/s]
    second: np.ndarray  # Share of the lag that is the second one's

    @property
    def runs(self) -> int:
        return self.K.size


def loops(order: Any, runs: Any, rng: Any) -> Any:
    """Vehicles and controllers of others' design: crossovers of 0.6 to 1.5 Hz or so."""
    K, D = rng.uniform(80.0, 250.0, runs), rng.uniform(0.3, 3.0, runs)
    lag = rng.uniform(0.02, 0.07, runs) if order > 1 else np.zeros(runs)
    delay = 0.00125 * rng.integers(0, DELAYS + 1, runs)
    theta = lag + delay + 0.00375 + 0.00125
    kp = rng.uniform(0.6, 1.2, runs) / (2.5 * K * (theta + 0.03))
    second = rng.uniform(0.25, 0.5, runs) if order == 3 else np.zeros(runs)
    ti, ka = np.maximum(8.0 * theta, 0.3), rng.uniform(1.5, 3.0, runs)
    return Loops(order, K, D, lag, delay, kp, ti, ka, second)


def _plant(K: Any, D: Any, lag: Any, second: Any, order: Any) -> Any:
    """Matrices of x' = A x + B [u, wind]: lags, rate, attitude, both states of the filter."""
    A, B = np.zeros((6, 6)), np.zeros((6, 2))
    w = 2.0 * np.pi * FILTER_HZ
    if order == 3:
        A[0, 0], B[0, 0] = -1.0 / (second * lag), 1.0 / (second * lag)
        slow = (1.0 - second) * lag
        A[1, 1], A[1, 0] = -1.0 / slow, 1.0 / slow
        A[2, 1] = K
    elif order == 2:
        A[1, 1], B[1, 0] = -1.0 / lag, 1.0 / lag
        A[2, 1] = K
    else:
        B[2, 0] = K
    A[2, 2], B[2, 1], A[3, 2] = -D, 1.0, 1.0
    A[4, 5], A[5, 4], A[5, 5], A[5, 2] = 1.0, -w * w, -np.sqrt(2.0) * w, w * w
    return A, B


def _half_step(A: Any, B: Any) -> Any:
    n, m = B.shape
    both = np.zeros((n + m, n + m))
    both[:n, :n], both[:n, n:] = A, B
    whole = expm(both * STEP_S / 2.0)
    return whole[:n, :n], whole[:n, n:]


def closed_loops(made: Any, reference: Any, setpoint: Any, wind: Any, noise: Any) -> Any:
    """Torque setpoints and measured rates; `reference` adds to the former, `setpoint` is attitude."""
    halves = [
        _half_step(*_plant(K, D, lag, second, made.order))
        for K, D, lag, second in zip(made.K, made.D, made.lag, made.second, strict=True)
    ]
    F, B = (np.array([half[k] for half in halves]) for k in (0, 1))
    runs, steps = made.runs, wind.shape[0]
    x, integral = np.zeros((runs, 6, 1)), np.zeros(runs)
    held = np.zeros((runs, DELAYS + 2))  # what was put out, newest first, each half step
    late = np.round(made.delay / (STEP_S / 2.0)).astype(int)
    rows = np.arange(runs)
    u, y = np.zeros((steps, runs)), np.zeros((steps, runs))
    for k in range(steps):
        y[k] = x[:, 4, 0] + noise[k]
        error = made.ka * (setpoint[k] - x[:, 3, 0]) - y[k]
        integral += error * STEP_S
        u[k] = made.kp * (error + integral / made.ti) + reference[k]
        for _ in range(2):
            held[:, 1:] = held[:, :-1]
            held[:, 0] = u[k]
            drive = np.stack([held[rows, late], wind[k]], axis=1)[:, :, None]
            x = F @ x + B @ drive
    return u, y


def truth(made: Any, frequency_hz: Any) -> Any:
    """Exact responses of the sampled plants, and the controllers' (rows are runs)."""
    z = np.exp(2j * np.pi * frequency_hz * STEP_S)
    G = np.empty((made.runs, z.size), dtype=complex)
    for run in range(made.runs):
        F, B = _half_step(*_plant(made.K[run], made.D[run], made.lag[run], made.second[run], made.order))
        F, B = np.delete(np.delete(F, 3, 0), 3, 1), np.delete(B, 3, 0)[:, :1]
        if made.order < 3:
            F, B = F[1:, 1:], B[1:]
        if made.order < 2:
            F, B = F[1:, 1:], B[1:]
        late = round(made.delay[run] / (STEP_S / 2.0))
        # input of half step j is u of step floor((j - late) / 2): two half steps make one
        early, mid = u_of(0, late), u_of(1, late)
        for k in range(z.size):
            drive = F @ B * z[k] ** early + B * z[k] ** mid
            state = np.linalg.solve(z[k] * np.eye(len(F)) - F @ F, drive)
            G[run, k] = state[-2, 0]
    C = made.kp[:, None] * (1.0 + STEP_S * z / (z - 1.0) / made.ti[:, None])
    return G, C


def u_of(half: Any, late: Any) -> Any:
    """How many steps before the present is the command that acts in a half step of the present one."""
    return (half - late) // 2


def winds(runs: Any, steps: Any, std: Any, rng: Any) -> Any:
    """Torques of the wind: first-order, of a time constant of 0.3 s [rad/s^2]."""
    pole = np.exp(-STEP_S / WIND_S)
    shocks = std * np.sqrt(1.0 - pole * pole) * rng.standard_normal((steps, runs))
    shocks[0] *= 1.0 / np.sqrt(1.0 - pole * pole)
    return lfilter([1.0], [1.0, -pole], shocks, axis=0)


def excitation(kind: Any, made: Any, seconds: Any, rng: Any) -> Any:
    """Sweep or multisine that is added to the torque setpoint, and attitude setpoints."""
    steps = round(seconds / STEP_S)
    t = STEP_S * np.arange(steps)
    none = np.zeros((steps, made.runs))
    size = 3.0 / made.K  # [rad/s^2] over the effectiveness
    if kind == "chirp":
        return np.outer(chirp(t, 0.3, seconds, 22.0, "logarithmic", phi=-90.0), 1.5 * size), none
    if kind == "multisine":
        lines = np.unique(np.round(np.geomspace(3, 120, 24))).astype(int) / 6.0
        phases = rng.uniform(0.0, 2.0 * np.pi, (lines.size, made.runs))
        waves = np.sin(2.0 * np.pi * lines[:, None, None] * t[:, None] + phases[:, None]).sum(axis=0)
        return waves * size / np.sqrt(lines.size / 2.0), none
    ends = np.cumsum(rng.uniform(0.4, 2.0, (round(seconds / 0.4), made.runs)), axis=0)
    levels = rng.uniform(-0.4, 0.4, ends.shape)
    number = np.array([np.searchsorted(ends[:, run], t) for run in range(made.runs)]).T
    return none, np.take_along_axis(levels, np.minimum(number, len(levels) - 1), axis=0)


def flights(order: Any, kind: Any, wind: Any, runs: Any, seed: Any, seconds: Any = 60.0) -> Any:
    """Vehicles, references, torque setpoints and rates of a row of the study."""
    rng = np.random.default_rng(seed)
    made = loops(order, runs, rng)
    injected, setpoint = excitation(kind, made, seconds, rng)
    steps = injected.shape[0]
    u, y = closed_loops(
        made, injected, setpoint, winds(runs, steps, wind, rng), NOISE * rng.standard_normal((steps, runs))
    )
    return made, injected + setpoint, u, y


# -- Study --

GRID_HZ = np.geomspace(0.5, 18.0, 30)
#: Order of the actuators, excitation and wind [rad/s^2] of each row; seeds count up from 1000.
ROWS = (
    (2, "chirp", 2.0),
    (2, "chirp", 8.0),
    (3, "chirp", 2.0),
    (3, "chirp", 8.0),
    (2, "multisine", 4.0),
    (2, "setpoints", 8.0),
    (1, "chirp", 2.0),
)
MARGINS = ("crossover_hz", "phase_margin_deg", "phase_crossover_hz", "gain_margin_db", "bandwidth_hz")


def low_pass(s: Any) -> Any:
    """Response of the gyroscope's filter."""
    x = s / (2.0 * np.pi * FILTER_HZ)
    return 1.0 / (x * x + np.sqrt(2.0) * x + 1.0)


def _holds(band: Any, values: Any, *, phase: bool = False) -> Any:
    middle = 0.5 * (band[:, 0] + band[:, 1])
    if phase:
        values = middle + (values - middle + np.pi) % (2.0 * np.pi) - np.pi
    return ~(np.isfinite(band[:, 1]) & ((values < band[:, 0]) | (values > band[:, 1])))


def exact_margins(made: Any, run: int, controller: Any) -> Any:
    one = Loops(made.order, *(getattr(made, item.name)[run : run + 1] for item in fields(made)[1:]))
    return loop_margins(lambda s: truth(one, s.imag / (2.0 * np.pi))[0][0] * controller(s))


def measured(  # noqa: C901 - one line for each number of the table
    order: Any, kind: Any, wind: Any, runs: Any, seed: Any, margins_of: Any
) -> Any:
    """What bands, intervals and, of the first runs, margins hold."""
    made, r, u, y = flights(order, kind, wind, runs, seed)
    held: dict[str, list[Any]] = {}

    def add(name: str, value: Any) -> None:
        held.setdefault(name, []).append(value)

    for run in range(runs):
        given: dict[str, Any] = {"frequency_hz": GRID_HZ, "rate_hz": 1.0 / STEP_S}
        if kind == "multisine":
            given |= {"period_s": 6.0}
        result = frequency_response(u[:, run], y[:, run], reference=r[:, run], **given)
        one = Loops(order, *(getattr(made, item.name)[run : run + 1] for item in fields(made)[1:]))
        G, _ = truth(one, result.frequency_hz)
        size, angle = np.abs(G[0]), np.angle(G[0])
        magnitude, phase = result.bands
        add("magnitude", _holds(magnitude, size))
        add("phase", _holds(phase, angle, phase=True))
        add("shown", result.is_shown)
        add("coherent", result.points.coherence > 0.6)
        both = zip(result.simultaneous_bands, (size, angle), (False, True), strict=True)
        add("simultaneous", all(_holds(band, of, phase=turned).all() for band, of, turned in both))
        add(
            "half",
            np.nanmedian(10.0 * np.log10(magnitude[:, 1] / magnitude[:, 0])[result.frequency_hz > 3.4]),
        )
        alone = frequency_response(u[:, run], y[:, run], reference=None, **given | {"period_s": None})
        exact = np.abs(truth(one, alone.frequency_hz)[0][0])
        add("direct", _holds(alone.bands[0], exact).mean())
        try:
            models = transfer_functions(result, sensor_filter=low_pass)
        except EstimationError:
            add("refused", 1.0)
            continue
        add("right order", models.chosen.order == order)
        true = {"gain": made.K[run], "damping": made.D[run], "delay": made.delay[run], "lag": made.lag[run]}
        for name, value in true.items():
            for words, ends in (
                (name, models.by_order[order].intervals),
                (f"union {name}", models.intervals),
            ):
                add(words, ends[name][0] <= value <= ends[name][1])
        if kind != "chirp" or order == 1 or run >= margins_of:
            continue
        controller = lambda s, k=run: made.kp[k] * (1.0 + STEP_S / (1.0 - np.exp(-s * STEP_S)) / made.ti[k])  # noqa: E731
        margins, ends = exact_margins(made, run, controller), margin_intervals(models, controller)
        for name in MARGINS:
            if np.isfinite(ends[name][0]):
                add(name, ends[name][0] <= getattr(margins, name) <= ends[name][1])
        for simc in proposed_controllers(models)[:1]:
            add("SIMC above 45 deg", exact_margins(made, run, simc.response).phase_margin_deg > 45.0)
    return held


def summarised(held: Any) -> Any:
    """Shares of a row."""
    shown = np.array(held["shown"])
    parts = {}
    for name in ("magnitude", "phase"):
        values = np.array(held[name])
        parts[name] = float(values.mean())
        parts[f"{name}, worst"] = float(values.mean(axis=0).min())
        parts[f"{name}, coherent"] = float(values[np.array(held["coherent"])].mean())
        parts[f"{name}, shown"] = float(values[shown].mean())
    parts["shown"] = float(shown.mean())
    others = {
        name: float(np.mean(values)) for name, values in held.items() if name not in (*parts, "coherent")
    }
    return parts | others


def main() -> None:
    """Print a line of JSON for each row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--margins", type=int, default=100, help="runs of which margins are looked at")
    parser.add_argument("--rows", type=int, nargs="*", default=range(len(ROWS)))
    given = parser.parse_args()
    for number in given.rows:
        row = ROWS[number]
        shares = summarised(measured(*row, given.runs, 1000 + number, given.margins))
        sys.stdout.write(
            json.dumps({"row": row, "runs": given.runs} | {k: round(v, 3) for k, v in shares.items()}) + "\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
