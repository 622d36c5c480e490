"""A declared machine from 60 s at 100 Hz, lag and delay searched, and without an actuator: processor time.

Targets: 0.5 s and 0.05 s. The peer is least squares of the same columns in time, lag and delay given.
"""

from __future__ import annotations

import time

import numpy as np
from _shared import arguments, least_seconds, machine

import eivor as ev

STEP_S, COUNT = 0.01, 6000


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    rng, time_s = np.random.default_rng(0), STEP_S * np.arange(COUNT)
    waves = (np.sin(2.0 * np.pi * (f * time_s + rng.random())) / f for f in np.geomspace(0.1, 1.5, 12))
    asked = 0.1 * np.sum(list(waves), axis=0)
    rover, axis = ev.load_machine("rover"), ev.load_machine("linear-axis")
    truth = {"drive_gain": 4.0, "rolling_drag": 0.8, "dry_friction": 0.3, "actuator_lag": 0.15, "delay": 0.05}

    def drive(at_s: float, measured: dict[str, np.ndarray]) -> np.ndarray:
        return 0.8 * asked[round(at_s / STEP_S)] - 0.6 * measured["forward_speed"]

    driven = rover.simulate(
        truth,
        {"drive_command": drive, "reference_forward_speed": asked},
        step_s=STEP_S,
        noise={"forward_speed": 0.01, "forward_acceleration": 0.1},
        disturbance=(0.05, 0.3),
    )
    speed = np.gradient(asked, STEP_S)
    force = 95.0 * np.gradient(speed, STEP_S) + 200.0 * speed + 20.0 * np.sign(speed)
    force += rng.standard_normal(COUNT)
    moved = {"time": time_s, "position": asked, "force": force, "reference_position": asked}
    for words, model, columns, target_s in (
        ("lag and delay", rover, driven, 0.5),
        ("no actuator", axis, moved, 0.05),
    ):
        log = ev.recording_from_columns(columns)
        fit = ev.identify_flight(log, model=model).fit
        assert fit is not None
        rows, repeats = fit.problem.rows(fit.estimate.nuisances), 1 if small else 10
        seconds, peer = (
            least_seconds(action, repeats, time.process_time)
            for action in (
                lambda log=log, model=model: ev.identify_flight(log, model=model),
                lambda rows=rows: np.linalg.lstsq(rows.regressors, rows.response),
            )
        )
        print(
            f"{words:<14}{1e3 * seconds:7.1f} ms   least squares alone {1e3 * peer:6.2f} ms   "
            f"ratio {seconds / peer:6.0f}   of target {seconds / target_s:5.2f}"
        )


if __name__ == "__main__":
    main()
