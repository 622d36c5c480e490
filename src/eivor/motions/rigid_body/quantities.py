"""Quantities of the rigid body: drag and damping as they are at hover."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from eivor.flights.quantity import Unjudged
from eivor.models.lagged_runs import LaggedRuns
from eivor.motions.rigid_body.flights import RotorColumns
from eivor.motions.rigid_body.parameters import DAMPING, DRAG, THRUST
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.input_map import input_map


def at_hover(problem: LaggedRuns, joint: Mapping[str, Unjudged]) -> dict[str, Unjudged]:
    """Parameters with drag and damping for the rotors' state at hover, where thrust tells that.

    What rotors drag grows with their state; the estimate is for that of the flight's mean thrust, which
    differs from hover's by little: the ratio is taken as known.
    """
    columns = problem.columns[0].moving
    found = dict(joint)
    if THRUST.name not in joint or not isinstance(columns, RotorColumns):
        return found
    gain = joint[THRUST.name].value * columns.states.layout.count
    if not gain > 0.0:
        return found
    ratio = input_map(columns.states.flight.input_map).inverse(GRAVITY / gain) / columns.usual
    for parameter in (*DRAG, *DAMPING):
        one = found.get(parameter.name)
        if one is not None:
            low, high = one.interval
            found[parameter.name] = replace(
                one,
                value=ratio * one.value,
                std_error=ratio * one.std_error,
                interval=(ratio * low, ratio * high),
            )
    return found
