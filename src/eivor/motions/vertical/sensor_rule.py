"""Grounds from what is measured: velocity and accelerometer that disagree, and forces in another unit."""

from __future__ import annotations

import numpy as np

from eivor.flights.circumstances import Circumstances
from eivor.inference.verdict import Reason, Status
from eivor.models.equation import Parameter
from eivor.motions.vertical.model import GRAVITY
from eivor.motions.vertical.sensors import (
    OFFSET,
    OTHER_UNIT_TIMES,
    SCALE,
    either_sentence,
    sentence,
    velocity_over_accelerometer,
)

#: An accelerometer that feels a gravity so far off is in another unit [m/s^2].
OTHER_UNIT = 3.0
#: And the mean of the specific force where the vehicle does not accelerate [m/s^2].
APPARENT_GRAVITY = "apparent_gravity"
ALIGN = (
    "Correct the time stamps, the filter or the scale of the one that is wrong, or align them with --align."
)
LEVEL = (
    "Check the attitude and the accelerometer's mounting, and calibrate both; or fly without sideways motion."
)


def unit_reasons(at: Circumstances) -> list[Reason]:
    """Grounds against everything: sensors in another unit, or of another sign."""
    return [*_unit_of_force_reasons(at), *_unit_of_velocity_reasons(at)]


def _unit_of_velocity_reasons(at: Circumstances) -> list[Reason]:
    """Ground of a velocity that reads many times what the accelerometer does, or goes the other way."""
    scale = None if at.sensors is None else at.sensors.told.get(SCALE.name)
    if scale is None:
        return []
    times = velocity_over_accelerometer(scale.value)
    if 1.0 / OTHER_UNIT_TIMES < times < OTHER_UNIT_TIMES:
        return []
    remedy = (
        "Turn one of them: z points up, in a channel map with sign = -1."
        if times < 0.0
        else "Correct the unit of one of them, in a channel map with unit = ..."
    )
    return [Reason(Status.REFUSED, sentence(SCALE.name, scale), remedy)]


def _unit_of_force_reasons(at: Circumstances) -> list[Reason]:
    """Ground of an accelerometer that feels another gravity: it is in another unit."""
    felt = at.numbers.get(APPARENT_GRAVITY, np.nan)
    if not abs(felt - GRAVITY) > OTHER_UNIT:
        return []
    unit = next((word for word, size in (("g", 1.0), ("milli-g", 1e3)) if 0.8 < felt / size < 1.25), "")
    sentence = (
        f"The accelerometer feels a gravity of {felt:.3g} m/s^2, where {GRAVITY:.2f} is expected"
        f"{f': its values look like {unit}' if unit else ''}."
    )
    return [Reason(Status.REFUSED, sentence, 'State its unit in a channel map (unit = "g"), and its axes.')]


def sensor_reasons(at: Circumstances, *harmful: Parameter) -> list[Reason]:
    """Grounds against what some kinds of disagreement between velocity and accelerometer harm."""
    if at.sensors is None:
        return []
    corrected = {OFFSET.name, SCALE.name} if at.aligned else set()
    names = {one.name for one in harmful} - corrected
    reasons = [
        Reason(Status.WEAK, sentence(name, one), ALIGN if name in (OFFSET.name, SCALE.name) else LEVEL)
        for name, one in at.sensors.told.items()
        if name in names
    ]
    if names & at.sensors.either.keys():
        reasons.append(Reason(Status.WEAK, either_sentence(at.sensors), LEVEL))
    if at.sensors.otherwise:
        reasons.append(
            Reason(
                Status.WEAK,
                "Velocity and accelerometer disagree in another way than by an offset, a scale or a tilt "
                f"(p-value {at.sensors.p_value:.1g}).",
                LEVEL,
            )
        )
    return reasons
