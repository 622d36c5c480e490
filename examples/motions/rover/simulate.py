"""Drive a simulated rover to and fro and write what it logs.

python simulate.py FILE.csv|FILE.parquet [--seed N] [--speed V]

The rover is held at a speed that is asked for by a controller that sees its measured speed; slopes push it.
With --speed the speed that is asked for never changes, from which nothing can be told.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import polars as pl

STEP_S, LOGGED_EVERY, SECONDS = 0.002, 5, 90.0
#: The rover: gain [m/s^2], drag [1/s], dry friction [m/s^2], lag and delay of the drive [s].
TRUTH = {
    "drive_gain": 4.0,
    "rolling_drag": 1.2,
    "dry_friction": 0.6,
    "actuator_lag": 0.08,
    "delay": 0.02,
    "effective_lag": 0.10,
    "breakaway_command": 0.15,
    "time_constant": 1.0 / 1.2,
}
#: Noise of the wheels' encoder [m/s] and of the accelerometer [m/s^2].
SPEED_NOISE, ACCELERATION_NOISE = 0.01, 0.1
#: Slopes: size [m/s^2] and how long one lasts [s].
SLOPE, SLOPE_S = 0.15, 0.5


def asked_speed(rng: np.random.Generator, count: int) -> np.ndarray:
    """Speeds to and fro [m/s], a new one every 1 to 3 s."""
    speed, sample, sign = np.zeros(count), 0, 1.0
    while sample < count:
        held = int(rng.uniform(1.0, 3.0) / STEP_S)
        speed[sample : sample + held] = sign * rng.uniform(0.5, 1.8)
        sample, sign = sample + held, -sign
    return speed


def drive(seed: int, constant_speed: float | None = None) -> dict[str, np.ndarray]:
    """Return the columns of a log.

    Parameters
    ----------
    seed : int
        Of the speeds, the slopes and the noises.
    constant_speed : float, optional
        The speed that is asked for [m/s]; default: a new one every few seconds.
    """
    rng = np.random.default_rng(seed)
    count = int(SECONDS / STEP_S)
    requested = asked_speed(rng, count) if constant_speed is None else np.full(count, constant_speed)
    decay = math.exp(-STEP_S / SLOPE_S)
    kicks = SLOPE * math.sqrt(1.0 - decay**2) * rng.standard_normal(count)
    noise = SPEED_NOISE * rng.standard_normal(count), ACCELERATION_NOISE * rng.standard_normal(count)
    logged = {name: np.zeros(count) for name in ("forward_speed", "forward_acceleration", "drive_command")}
    a, c, d = TRUTH["drive_gain"], TRUTH["rolling_drag"], TRUTH["dry_friction"]
    late = round(TRUTH["delay"] / STEP_S)
    speed = command = state = slope = 0.0
    commands = np.zeros(count + late)
    for k in range(count):
        measured = speed + noise[0][k]
        if k % LOGGED_EVERY == 0:
            error = requested[k] - measured
            command = 1.5 * error + (c * requested[k] + d * math.copysign(1.0, requested[k])) / a
            command = min(max(command, -1.0), 1.0)
        commands[k + late] = command
        push = a * state - c * speed + slope
        # dry friction holds a rover that stands still until it is pushed harder
        still = abs(speed) < d * STEP_S and abs(push) < d
        acceleration = -speed / STEP_S if still else push - d * math.copysign(1.0, speed or push)
        logged["forward_speed"][k], logged["drive_command"][k] = measured, command
        logged["forward_acceleration"][k] = acceleration + noise[1][k]
        speed += STEP_S * acceleration
        state += (commands[k] - state) * -math.expm1(-STEP_S / TRUTH["actuator_lag"])
        slope = decay * slope + kicks[k]
    logged = {"time": STEP_S * np.arange(count), **logged, "reference_forward_speed": requested}
    return {name: values[::LOGGED_EVERY] for name, values in logged.items()}


def write(columns: dict[str, np.ndarray], path: Path) -> None:
    """Write a log as CSV or Parquet, told by the ending."""
    frame = pl.DataFrame(columns)
    frame.write_parquet(path) if path.suffix == ".parquet" else frame.write_csv(path)


def main() -> None:
    """Write one log."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--speed", type=float)
    chosen = parser.parse_args()
    write(drive(chosen.seed, chosen.speed), chosen.file)
    print(f"{chosen.file}: the truth is", ", ".join(f"{name} {value:g}" for name, value in TRUTH.items()))


if __name__ == "__main__":
    main()
