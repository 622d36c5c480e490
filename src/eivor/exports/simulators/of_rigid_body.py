"""What a flight of the rigid body tells of a vehicle: only of combinations that are identified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from eivor.exports.fitted import Fitted, Number
from eivor.exports.simulators.parts import DRAGS, INERTIAS, Column, Columns, Part, Parts, itself, of_mass
from eivor.inference.verdict import Status
from eivor.motions.rigid_body.combinations import Combinations
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.motions.rigid_body.physical import physical_parameters
from eivor.motions.rigid_body.physical_ways import Way, sought
from eivor.motions.rigid_body.yaw_inertia import yaw_inertia

GAIN, LAG, DELAY = "thrust_gain", "actuator_lag", "delay"
PHYSICAL = (*INERTIAS, *DRAGS, "torque_ratio")
LEVEL = 0.95


def rigid_body_parts(fitted: Fitted, given: dict[str, Number], vehicle: KnownVehicle, std: float) -> Parts:
    """Thrust, drags, inertias, torque ratio, lag and delay.

    Parameters
    ----------
    fitted : Fitted
        Of the rigid body.
    given : mapping of str to Number
        What the flight does not tell; the mass among it.
    vehicle : KnownVehicle
        Its arms and ratios.
    std : float
        Standard deviation of the mass [kg].
    """
    known = replace(vehicle, mass=KnownNumber(given["mass"].value, std))
    found = _identified(fitted)
    told: dict[str, Part] = {}
    missing: dict[str, str] = {}
    rows = physical_parameters(found, known, LEVEL)
    ways = {one.name: one.ways[0] for one in sought(yaw_inertia(found, known, LEVEL), fitted.input_map)}
    for name in PHYSICAL:
        row = rows[name]
        if row.told is not None and row.told.value > 0.0:
            told[name] = Part(
                Number(row.told.value, row.told.interval, f"identified. {row.sentence}"), _by_rows(ways[name])
            )
        else:
            missing[name] = _why_not(fitted, ways[name]) or row.sentence
    for name, root in (("thrust", GAIN), (LAG, LAG), (DELAY, DELAY)):
        number = fitted.told(root) or given.get(root)
        if number is None:
            missing[name] = fitted.why_not(root)
        elif name == "thrust":
            told[name] = Part(of_mass(given["mass"], number), lambda c: c["mass"] * c[GAIN])
        else:
            told[name] = Part(number, itself(root))
    return Parts(told, missing)


def _identified(fitted: Fitted) -> Combinations:
    """Those of the joint vector that are."""
    if not fitted.candidates:
        return Combinations((), ())
    names = frozenset(name for name in fitted.names if _is_told(fitted, name))
    return Combinations(fitted.names, fitted.candidates).only(names)


def _is_told(fitted: Fitted, name: str) -> bool:
    one = fitted.quantities.get(name)
    return one is not None and one.verdict is Status.IDENTIFIED


def _why_not(fitted: Fitted, way: Way) -> str:
    """Verdicts of what a formula takes; empty where all of it is identified."""
    return " ".join(fitted.why_not(name) for name in way.found if not _is_told(fitted, name))


def _by_rows(way: Way) -> Callable[[Columns], Column]:
    names = (*way.found, *way.supplied)

    def column(columns: Columns) -> Column:
        rows = zip(*(columns[name] for name in names), strict=True)
        return np.array([way.formula(dict(zip(names, row, strict=True))) for row in rows])

    return column
