"""What a thrust curve that was fitted means for the autopilot's parameter, in a sentence."""

from __future__ import annotations

from collections.abc import Mapping

from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Quantity
from eivor.inference.verdict import Status
from eivor.motions.vertical.curve_family import (
    CURVE_PARAMETERS,
    DECLARE,
    AutopilotParameter,
    Interval,
    curve_in_force,
    family_of_fitted,
    proposed,
)
from eivor.signals.canonical import CurveSide, common_side
from eivor.signals.input_map import input_map
from eivor.signals.recording import Finding

#: Why nothing is proposed of a command before a curve that is not known.
NOT_IN_FORCE = (
    "The command is before the autopilot's thrust curve, and no value of it that is in force is known "
    "(THR_MDL_FAC, MOT_THST_EXPO): no parameter is proposed."
)


def curve_findings(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity]
) -> tuple[Finding, ...]:
    """The parameter that a curve would set; none where the curve or the hover input is not told."""
    curve, hover = quantities.get("thrust_curve"), quantities["hover_input"]
    if curve is None or not 0.0 < hover.value < 1.0 or flights[0].input.measured:
        return ()
    side = common_side(flight.curve_side for flight in flights)
    in_force = curve_in_force([flight.recording.parameters for flight in flights])
    if Status.REFUSED in (curve.verdict, hover.verdict):
        return _overdone(side, in_force, curve)
    if side is CurveSide.UNKNOWN:
        sentence = (
            f"The log does not say whether {flights[0].input.name} is before or behind the autopilot's "
            f"thrust curve: no parameter is proposed. {DECLARE}"
        )
        return (Finding("thrust_curve", sentence),)
    family = family_of_fitted(input_map(flights[0].input_map))
    before = side is CurveSide.BEFORE
    sentences = []
    for parameter in [one for one in CURVE_PARAMETERS if one.name in in_force or not (in_force or before)]:
        value = in_force.get(parameter.name)
        if before and value is not None and not parameter.takes(value):
            continue
        share, _ = proposed(
            parameter,
            family,
            (curve.value, curve.interval),
            (hover.value, hover.interval),
            value if before else None,
        )
        sentences.append(_sentence(parameter, share, value, curve.verdict))
    return (Finding("thrust_curve", " ".join(sentences) or NOT_IN_FORCE),)


def _overdone(side: CurveSide, in_force: Mapping[str, float], curve: Quantity) -> tuple[Finding, ...]:
    """Say that a curve in force bends too much, which no share of the square brings back."""
    large = [f"{name} {value:.2g}" for name, value in in_force.items() if value > 0.0]
    if side is not CurveSide.BEFORE or not large or not curve.interval[1] < 0.0:
        return ()
    sentence = (
        f"Thrust grows more slowly than its setpoint: {' and '.join(large)}, which is in force, is too large "
        "for this vehicle, unless the supply sags. Identify with motor signals behind the curve, or fly with "
        "a smaller value."
    )
    return (Finding("thrust_curve", sentence),)


def _sentence(parameter: AutopilotParameter, share: Interval, in_force: float | None, verdict: Status) -> str:
    """What the curve would set a parameter to, or why it does not."""
    now = "" if in_force is None else f" The log has {parameter.name} {in_force:.2g}."
    beyond = parameter.beyond(share)
    if beyond:
        return f"No {parameter.name} is proposed: {beyond}{now}"
    value, (low, high) = share
    return (
        f"{parameter.name} ({parameter.autopilot}) would be set to {value:.2f} [{low:.2f}, {high:.2f}] by "
        f"the thrust curve that was fitted, which is {verdict.value}.{now}"
    )
