"""Predictions of flights by others: errors of velocity, attitude and rates over "stays as it is", to .5 s."""

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
TRAINED = ("B2_circle_fast", "B3_figure8_medium", "B7_oval_medium", "B5_helix_slow", "B2_circle_slow")
GROUPS = (["velocity"], ["attitude"], ["roll rate", "pitch rate", "yaw rate"])

if __name__ == "__main__":
    files = sorted(Path(os.environ.get("EIVOR_DATA") or "../shared/data").glob("nanobench*/B*.csv"))
    trained = [next(file for file in files if file.stem.startswith(kind)) for kind in TRAINED]
    logs, models = [ev.read_log(file) for file in trained], {}
    for name, method in METHODS.items():
        fit: Any = ev.identify_flight(logs, model="rigid-body", vehicle="crazyflie-2x", method=method)
        values = {item: quantity.value for item, quantity in fit.quantities.items()}
        models[name] = SimpleModel(name, {**fit.estimate.nuisances, **values})
    for log in (ev.read_log(item) for item in files if item not in trained):
        flight = prepare(log, fit.motion, fit.options).shortened
        made = fit.motion.abilities.prediction.multi_step(
            (flight,), {FIT: models[FIT], **models}, frozenset()
        )
        sums = {(item.model, item.quantity): sum(item.rms) for item in made.errors}
        for model in METHODS if sums else ():
            pairs = [[sum(sums[of, name] for name in names) for of in (model, UNCHANGED)] for names in GROUPS]
            print(log.name, model, *np.round([fit / stays for fit, stays in pairs], 2), flush=True)
