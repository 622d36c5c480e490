"""Rotors that spin turn all axes by one inertia J, where the ratios of the body's inertias are told.

What they turn stands in three equations: J / Ixx and J / Iyy before what their angular momentum does as it
goes round with the body, and J / Izz before the reaction to a change of it. A change of it looks much like a
shorter lag about the yaw axis, so that J / Izz by itself costs the lag a tenth of what is known of it. The
gains and the gyroscopic couplings tell the ratios of the inertias far better than either. With them the three
columns are one.

Where couplings are not excited, or where the three by themselves say something else than one inertia, they
stay as they are: what acts like a reaction about yaw may be none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.flights.predicted import SimpleModel
from eivor.flights.quantity import Unjudged
from eivor.models.equation import Parameter
from eivor.models.lagged_runs import AxisColumns, LaggedRuns
from eivor.models.separable import Begun
from eivor.motions.rigid_body.combinations import Combinations, Formula
from eivor.motions.rigid_body.flights import RotorColumns
from eivor.motions.rigid_body.inertia_ratios import (
    TELLING,
    InertiaRatios,
    by_pitch_coupling,
    by_roll_coupling,
)
from eivor.motions.rigid_body.parameters import GAIN, PITCH, REACTION, ROLL, SPIN_MOMENT, YAW

#: The ratio of inertias is told when the half-width of its interval, by each coupling, is at most this share.
TOLD_SHARE, LEVEL = 0.1, 0.95
#: Level of the intervals of what the three columns and one inertia differ by.
APART_LEVEL = 0.995

_SPINS = (*(one.name for one in SPIN_MOMENT), REACTION.name)


def settled_spin(
    problem: LaggedRuns, estimated: Callable[[LaggedRuns], Estimate]
) -> tuple[LaggedRuns, Estimate]:
    """The problem with one inertia of the rotors where the flights tell that there is one, and its estimate.

    Parameters
    ----------
    problem : LaggedRuns
        Of the flights.
    estimated : callable
        From a problem to its estimate.
    """
    free = estimated(problem)
    ratios = ratios_told(free)
    if ratios is None:
        return problem, free
    linked = with_one_spin(problem, ratios, free.best)
    return linked, estimated(linked)


def ratios_told(estimate: Estimate) -> InertiaRatios | None:
    """Ratios of the inertias; None where they are not told, or the three columns are not of one inertia.

    Parameters
    ----------
    estimate : Estimate
        With a parameter for each column.
    """
    found = Combinations.of_estimate(estimate).finite()
    if not found.has(*TELLING, *_SPINS):
        return None
    values = dict(zip(found.names, found.candidates[0].values.tolist(), strict=True))
    if not min(values[one.name] for one in GAIN[:YAW]) > 0.0:
        return None
    for ratio in (by_roll_coupling, by_pitch_coupling):
        low, high = found.function(ratio, TELLING, {}, LEVEL, math.inf).interval
        if not (low > 0.0 and high - low <= 2.0 * TOLD_SHARE * ratio(values)):
            return None
    for axis in (ROLL, PITCH):
        low, high = found.function(_apart(axis), (*TELLING, *_SPINS), {}, APART_LEVEL, math.inf).interval
        if not low <= 0.0 <= high:
            return None
    return InertiaRatios.of_values(values)


def with_one_spin(problem: LaggedRuns, ratios: InertiaRatios, free: Candidate | None = None) -> LaggedRuns:
    """The same problem whose columns of rotors that spin go with J / Izz alone.

    Parameters
    ----------
    problem : LaggedRuns
        With a parameter for each column.
    ratios : InertiaRatios
        By which J / Ixx and J / Iyy are multiples of it.
    free : Candidate, optional
        An estimate of it, where that of the new one begins.
    """
    moving = problem.parameters[problem.columns[0].fixed.shape[1] :]
    kept = tuple(one for one in moving if one not in SPIN_MOMENT)
    combination = np.array([[float(one == other) for other in kept] for one in moving])
    for axis, one in enumerate(SPIN_MOMENT):
        combination[moving.index(one), kept.index(REACTION)] = ratios.of_axis(axis)
    columns = tuple(_of_one_spin(one, kept, ratios) for one in problem.columns)
    noisier = None if problem.noisier is None else with_one_spin(problem.noisier, ratios)
    begun = None
    if free is not None:
        stays = [place for place, one in enumerate(problem.parameters) if one not in SPIN_MOMENT]
        begun = Begun(free.theta[stays], free.at)
    return problem.combined(columns, kept, combination, noisier=noisier, begun=begun)


def spin_of(problem: LaggedRuns) -> InertiaRatios | None:
    """Ratios by which a problem's columns of rotors that spin are one; None where they are three."""
    moving = problem.columns[0].moving
    return moving.one_spin if isinstance(moving, RotorColumns) else None


def spin_moments(problem: LaggedRuns, joint: Mapping[str, Unjudged]) -> dict[str, Unjudged]:
    """J / Ixx and J / Iyy, by J / Izz, of a problem in which they are one with it; else nothing."""
    ratios, of_all = spin_of(problem), joint.get(REACTION.name)
    if ratios is None or of_all is None:
        return {}
    return {one.name: of_all.times(ratios.of_axis(axis)) for axis, one in enumerate(SPIN_MOMENT)}


def with_spin_moments(models: Mapping[str, SimpleModel], fit: str) -> dict[str, SimpleModel]:
    """Models of flights with J / Ixx and J / Iyy as well, by the ratios of the fit among them.

    Parameters
    ----------
    models : mapping of str to SimpleModel
        All of the same columns. Where these were three they are returned as they are.
    fit : str
        Name of the one whose gains and couplings count.
    """
    values = models[fit].values
    if not {REACTION.name, *TELLING} <= set(values) or SPIN_MOMENT[ROLL].name in values:
        return dict(models)
    ratios = InertiaRatios.of_values(values)
    return {name: replace(one, values=_with_moments(one.values, ratios)) for name, one in models.items()}


def _with_moments(values: Mapping[str, float], ratios: InertiaRatios) -> dict[str, float]:
    of_all = values.get(REACTION.name, 0.0)
    return {**values, **{one.name: ratios.of_axis(axis) * of_all for axis, one in enumerate(SPIN_MOMENT)}}


def _of_one_spin(one: AxisColumns, kept: tuple[Parameter, ...], ratios: InertiaRatios) -> AxisColumns:
    if not isinstance(one.moving, RotorColumns):
        return one
    moving = replace(one.moving, moving=kept, one_spin=ratios)
    return replace(one, moving=moving, moved=moving.places)


def _apart(axis: int) -> Formula:
    """What the column of ROLL or PITCH says beside one inertia."""

    def apart(values: Mapping[str, float]) -> float:
        one = InertiaRatios.of_values(values).of_axis(axis) * values[REACTION.name]
        return values[SPIN_MOMENT[axis].name] - one

    return apart
