"""Predictions of real flights half a second ahead, by flights that were not used for the fit.

    python -m validation.rigid_body.ahead

The first repeat of each kind of NanoBench's flights is identified in one pool; all others are predicted from their
measured states. Figures are sums of mean absolute errors over 50 steps of 10 ms, as shares of those of "the state
stays as it is, and velocity goes on": position, velocity [m/s], rotation [rad] and rates [rad/s].
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

import eivor as ev
from eivor.flights.motion import Starts, starts_of
from eivor.flights.prepare import prepare
from eivor.flights.quantity import SimpleModel
from eivor.motions.rigid_body.output_error import difference
from eivor.motions.rigid_body.predict import LoggedState, StatePropagator
from eivor.motions.rigid_body.verdict import with_gyroscopic_moments

VEHICLE = "crazyflie-2x"
METHODS = ("whitened_least_squares", "whitened_least_squares+output_error")
STEPS_S = tuple(0.01 * step for step in range(1, 51))
#: Kinds whose fits others predict, and flights that take off.
TRAINED = ("B2_circle_fast", "B3_figure8_medium", "B7_oval_medium", "B5_helix_slow", "B2_circle_slow")


def recordings(folder: Path) -> dict[str, list[Path]]:
    kinds: dict[str, list[Path]] = {}
    for file in sorted([*folder.glob("nanobench/B*.csv"), *folder.glob("nanobench-repeats/B*.csv")]):
        kinds.setdefault(file.stem.rpartition("_")[0], []).append(file)
    return kinds


def errors(logged: LoggedState, starts: Starts, states: np.ndarray) -> np.ndarray:
    measured = logged.body[:, starts.ends].transpose(1, 0, 2)
    left = difference(states, measured)
    parts = (list(logged.placed), [3, 4, 5], [6, 7, 8], [9, 10, 11])
    return np.array([np.sqrt((left[:, part] ** 2).sum(axis=1)).mean(axis=1).sum() for part in parts])


def main() -> int:
    folder = Path(os.environ.get("EIVOR_DATA") or "../shared/data")
    kinds = recordings(folder)
    trained = [kinds[kind][0] for kind in TRAINED]
    fits = [
        ev.identify_flight(
            [ev.read_log(file) for file in trained], model="rigid-body", vehicle=VEHICLE, method=method
        )
        for method in METHODS
    ]
    motion = fits[0].motion
    values = [{**fit.estimate.nuisances, **fit.estimate.parameters} for fit in fits]
    models = [
        next(iter(with_gyroscopic_moments({"fit": SimpleModel("", item)}, "fit").values())).values
        for item in values
    ]
    print("flight | staying: position, velocity, rotation, rates | least squares | output error")
    for kind, files in kinds.items():
        for file in files:
            flight = prepare(ev.read_log(file), motion, fits[0].options)
            if file in trained or not flight.runs:
                continue
            logged = LoggedState(flight.shortened)
            starts = starts_of(logged.flight, STEPS_S, 0.1)
            if starts.samples.size < 20:
                continue
            begun = logged.body[:, starts.samples]
            stays = np.repeat(begun[None], len(STEPS_S), axis=0)
            stays[:, :3] += np.array(starts.steps)[:, None, None] * starts.step_s * begun[3:6]
            least = errors(logged, starts, stays)
            made = StatePropagator(logged, motion.known_vehicle, models, starts).propagate(begun)
            shares = [errors(logged, starts, states) / least for states in made]
            texts = [", ".join(f"{item:.2f}" for item in row) for row in (least, *shares)]
            print(" | ".join((kind + " " + file.stem.rpartition("_")[2], *texts)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
