"""Simulated runs whose input lags behind its command and acts through a curve: two nuisances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.models.lagged_runs import ACTUATOR_LAG, AxisColumns, LaggedRuns
from eivor.models.regression import Parameter
from eivor.models.separable import Nuisance
from eivor.signals.filters import first_order_lag

STEP_S = 0.02
SAMPLES = 1500
FRICTION, GAIN, LAG_S, SHARE = 2.0, 5.0, 0.08, 0.4
TRUTH = np.array([FRICTION, GAIN, LAG_S, SHARE])
CURVE_SHARE = Parameter("curve_share")
PARAMETERS = (Parameter("friction", "1/s"), Parameter("gain"))
HERTZ = (0.15, 0.4, 0.9, 1.7, 2.9)


def lag(**more):
    return Nuisance(ACTUATOR_LAG, more.pop("grid", np.geomspace(0.01, 0.4, 20)), **more)


def share(**more):
    return Nuisance(CURVE_SHARE, more.pop("grid", np.linspace(0.0, 1.0, 11)), **more)


def curved(values, bend):
    """What an input does: a share of it by its square."""
    return (1.0 - bend) * values + bend * values**2


@dataclass(frozen=True)
class Driven:
    """The column that moves with lag and share."""

    command: np.ndarray

    def __call__(self, nuisance_values):
        state = first_order_lag(self.command, step_s=STEP_S, lag_s=nuisance_values["actuator_lag"])
        return curved(state, nuisance_values["curve_share"])[:, None]


def sines(rng, hertz=HERTZ, size=0.15):
    time, phases = STEP_S * np.arange(SAMPLES)[:, None], rng.uniform(0.0, 2.0 * np.pi, len(hertz))
    return size * np.sin(2.0 * np.pi * np.array(hertz) * time + phases).sum(axis=1)


def columns(seed, *, noise=0.02, hertz=HERTZ, flight=0, axis=0):
    """One flight; what its input does is not measured, only what comes of it."""
    rng = np.random.default_rng(seed)
    command, velocity = 0.7 + sines(rng, hertz), sines(rng)
    driven = Driven(command)
    truth = driven({"actuator_lag": LAG_S, "curve_share": SHARE})[:, 0]
    response = -FRICTION * velocity + GAIN * truth + noise * rng.standard_normal(SAMPLES)
    known = [first_order_lag(command, step_s=STEP_S, lag_s=lag_s) for lag_s in (0.0, 0.04, 0.15, 0.5)]
    instruments = np.column_stack([velocity, *known, *(item**2 for item in known)])
    runs = (slice(100, 800), slice(850, SAMPLES))
    return AxisColumns(STEP_S, runs, response[:, None], -velocity[:, None], driven, instruments, flight, axis)


def problem(*nuisances, seed=0, **more):
    return LaggedRuns((columns(seed, **more),), PARAMETERS, nuisances)


def residual(made, joint):
    """Residual of the rows in time, written out run by run."""
    friction, gain, lag_s, bend = joint
    (item,) = made.columns
    driven = item.moving({"actuator_lag": lag_s, "curve_share": bend})[:, 0]
    whole = item.responses[:, 0] - friction * item.fixed[:, 0] - gain * driven
    return np.concatenate([whole[run] - whole[run].mean() for run in item.runs])
