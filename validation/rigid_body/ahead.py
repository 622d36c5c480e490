"""Predictions of real flights half a second ahead, by a pool of other flights of the same vehicle.

    python -m validation.rigid_body.ahead

Figures are sums of the errors after .1 to .5 s over those of "stays as it is": velocity, attitude, rates.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev
from eivor.flights.motion import FIT, UNCHANGED
from eivor.flights.prepare import prepare
from eivor.flights.quantity import SimpleModel

METHODS = {"least squares": "whitened_least_squares", FIT: "whitened_least_squares+output_error"}
#: One flight of each of these is identified; all other flights are predicted.
TRAINED = ("B2_circle_fast", "B3_figure8_medium", "B7_oval_medium", "B5_helix_slow", "B2_circle_slow")
GROUPS = {
    "velocity": ["velocity"],
    "attitude": ["attitude"],
    "rates": ["roll rate", "pitch rate", "yaw rate"],
}


def main() -> None:
    folder = Path(os.environ.get("EIVOR_DATA") or "../shared/data")
    files = sorted([*folder.glob("nanobench/B*.csv"), *folder.glob("nanobench-repeats/B*.csv")])
    trained = [next(file for file in files if file.stem.startswith(kind)) for kind in TRAINED]
    logs, models = [ev.read_log(file) for file in trained], {}
    for name, method in METHODS.items():
        fit: Any = ev.identify_flight(logs, model="rigid-body", vehicle="crazyflie-2x", method=method)
        models[name] = SimpleModel(name, {**fit.estimate.nuisances, **fit.estimate.parameters})
    ahead = fit.motion.abilities.prediction.multi_step
    for file in files:
        flight = prepare(ev.read_log(file), fit.motion, fit.options)
        if file in trained or not flight.runs:
            continue
        made = ahead((flight.shortened,), {FIT: models[FIT], **models}, frozenset())
        sums = {(item.model, item.quantity): sum(item.rms) for item in made.errors}
        for model in METHODS:
            shares = [
                sum(sums[model, name] for name in names) / sum(sums[UNCHANGED, name] for name in names)
                for names in GROUPS.values()
                if (UNCHANGED, names[0]) in sums
            ]
            print(file.stem, model, *np.round(shares, 2), flush=True)


if __name__ == "__main__":
    main()
