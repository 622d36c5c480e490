"""Quantities of the rigid body: drag and damping as they are at hover, and the friction of climbs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.flights.estimated import joint_quantities
from eivor.flights.quantity import Unjudged
from eivor.models.lagged_runs import AxisColumns, LaggedRuns
from eivor.motions.rigid_body.flights import RotorColumns
from eivor.motions.rigid_body.parameters import DAMPING, DRAG, FORCE_Z, FRICTION, QUADRATIC_DRAG, THRUST
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float
from eivor.signals.input_map import input_map


def at_hover(problem: LaggedRuns, joint: Mapping[str, Unjudged]) -> dict[str, Unjudged]:
    """Parameters with drag and damping for the rotors' state at hover, where thrust tells that.

    What rotors drag grows with their state; the estimate is for that of the flight's mean thrust, which
    differs from hover's by little: the ratio is taken as known.
    """
    found, ratio = dict(joint), _hover_over_usual(problem, joint)
    for parameter in (*DRAG, *DAMPING):
        one = found.get(parameter.name)
        if one is not None:
            found[parameter.name] = one.times(ratio)
    return found


def viscous_friction(problem: LaggedRuns, estimate: Estimate) -> dict[str, Unjudged]:
    """Friction along z at the speeds of the flights: d_z at hover, and c_z sum |v| v_z^2 / sum v_z^2.

    It is what the vertical motion calls viscous friction. Where speeds are alike, what rotors and what the
    body drag trade, and each has a long interval; their sum has a short one. Nothing where either is unknown.
    """
    linear, quadratic = DRAG[2].name, QUADRATIC_DRAG[2].name
    climbs = [one for one in problem.columns if one.axis == FORCE_Z]
    if not {linear, quadratic} <= set(estimate.parameters) or not climbs:
        return {}
    products = np.sum([_climbed(one) for one in climbs], axis=0)
    if not products[1] > 0.0:
        return {}
    ratio = _hover_over_usual(problem, joint_quantities(estimate))
    share = float(products[0] / products[1])
    gradient = ratio * estimate.direction(linear) + share * estimate.direction(quadratic)
    places = [estimate.names.index(name) for name in (linear, quadratic)]

    def friction(candidate: Candidate) -> tuple[float, Float[np.ndarray, " n"]]:
        of_rotors, of_body = candidate.values[places].tolist()
        return ratio * of_rotors + share * of_body, gradient

    value, _ = friction(estimate.best)
    error = estimate.best.covariance.std_error(gradient)
    return {FRICTION.name: Unjudged(value, FRICTION.unit, error, estimate.interval_of(friction))}


def _climbed(one: AxisColumns) -> Float[np.ndarray, " 2"]:
    """Sums of |v| v_z^2 and of v_z^2 over what counts of a flight."""
    if not isinstance(one.moving, RotorColumns):
        return np.zeros(2)
    velocity = one.moving.states.velocity
    counted = np.zeros(velocity.shape[1], dtype=np.bool_)
    for run in one.runs:
        inside = one.counted(run)
        counted[run] = True if inside is None else inside
    squared = velocity[2, counted] ** 2
    return np.array([np.linalg.norm(velocity[:, counted], axis=0) @ squared, squared.sum()])


def _hover_over_usual(problem: LaggedRuns, joint: Mapping[str, Unjudged]) -> float:
    """State of a rotor at hover over that which drag and damping are told for; one where nothing tells it."""
    columns = problem.columns[0].moving
    if THRUST.name not in joint or not isinstance(columns, RotorColumns):
        return 1.0
    gain = joint[THRUST.name].value * columns.states.layout.count
    if not gain > 0.0:
        return 1.0
    return input_map(columns.states.flight.input_map).inverse(GRAVITY / gain) / columns.usual
