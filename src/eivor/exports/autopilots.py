"""Exports to PX4 and ArduPilot parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import msgspec
import numpy as np

from eivor.errors import UsageError
from eivor.exports.fitted import (
    VERTICAL,
    Exported,
    Fitted,
    Number,
    Supplied,
    hash_comments,
    rendered,
    targets,
)
from eivor.inference.verdict import Status
from eivor.motions.vertical import model as vertical
from eivor.signals.channels import CurveSide
from eivor.signals.thrust_map import InputMap, Mixed, Power

#: Quantities that parameters are made of, and what parameters of the first are.
HOVER, CURVE, HOVER_WORDS = "hover_input", "thrust_curve", "hover throttle"


class Autopilot(msgspec.Struct, frozen=True):
    """What an autopilot calls hover and thrust curve."""

    name: str
    hover: vertical.AutopilotParameter
    curve: vertical.AutopilotParameter
    not_of: tuple[str, ...]


def _parameter_export(autopilot: Autopilot, template: str) -> Callable[[Fitted, Supplied], Exported]:
    """Export of the parameters of an autopilot that a result holds, old and new in comments above them."""

    def export(fitted: Fitted, supplied: Supplied) -> Exported:
        supplied.check_only((), autopilot.name.lower(), body=False)
        fitted.check_vertical(autopilot.name)
        _check_autopilot(fitted, autopilot)
        numbers, reasons = _proposals(fitted, autopilot)
        unwritten = tuple(f"{name} is not written: {reason}" for name, reason in reasons.items())
        old = {name: f"{fitted.logged[name]:.6g} -> " for name in numbers if name in fitted.logged}
        lines = [f"{name}: {old.get(name, '')}{number.words}" for name, number in numbers.items()]
        values = {name: number.value for name, number in numbers.items()}
        return Exported(rendered(template, (*fitted.origin(), *lines, *unwritten), rows=values), unwritten)

    return export


def _check_autopilot(fitted: Fitted, autopilot: Autopilot) -> None:
    """Refuse a flight of another autopilot, and a command that is no share."""
    others = [f"format {log_format}" for log_format in fitted.formats if log_format in autopilot.not_of]
    if fitted.curve_in_force and autopilot.curve.name not in fitted.curve_in_force:
        others.append(f"a vehicle with {' and '.join(fitted.curve_in_force)}")
    if others:
        raise UsageError(
            f"a flight of {autopilot.name}, since each autopilot counts shares of thrust in its own way",
            f"a result of a log of {others[0]}",
            "Export to the autopilot that flew.",
        )
    value = fitted.quantities[HOVER].value if HOVER in fitted.quantities else float("nan")
    if fitted.input_measured or value >= 1.0:
        raise UsageError(
            "a command that is a share of the largest, from 0 to 1",
            f"'{fitted.input}'{f', with {value:.4g} at hover' if value >= 1.0 else ', which was measured'}",
            "Identify with the log's thrust setpoint, --input input, or with its motor outputs, "
            "--input actuator_output, where parameters determine their range.",
        )


def _proposals(fitted: Fitted, autopilot: Autopilot) -> tuple[dict[str, Number], dict[str, str]]:
    """Curve and hover, hover where the curve in force stays, or neither; and why others are missing."""
    hover, curve = fitted.identified_number(HOVER), fitted.identified_number(CURVE)
    names = autopilot.hover.name, autopilot.curve.name
    if fitted.curve_side is CurveSide.UNKNOWN:
        reason = (
            f"the result does not say whether '{fitted.input}' is before or behind the autopilot's thrust "
            f"curve. Identify the log again. {vertical.DECLARE}"
        )
        return {}, dict.fromkeys(names, reason)
    if hover is None:
        return {}, dict.fromkeys(names, fitted.why_not(HOVER))
    before_curve = fitted.curve_side is CurveSide.BEFORE
    reasons = list(_objections(fitted, autopilot, curve))
    if curve is not None and not reasons:
        share, thrust = vertical.proposed(
            autopilot.curve,
            vertical.family_of(fitted.input_map),
            (curve.value, curve.interval),
            (hover.value, hover.interval),
            fitted.curve_in_force[autopilot.curve.name] if before_curve else None,
        )
        beyond = autopilot.hover.beyond(thrust)
        beyond = autopilot.curve.beyond(share) or (beyond and f"it goes with {names[0]}, and {beyond}")
        if not beyond:
            source = fitted.source(HOVER, CURVE)
            return dict(zip(names, (Number(*thrust, source), Number(*share, source)), strict=True)), {}
        reasons = [beyond]
    sentence = " ".join(reasons)
    if not before_curve:
        joint_reason = f"of motor signals, hover and curve are written together or not at all: {sentence}"
        return {}, dict.fromkeys(names, joint_reason)
    beyond = autopilot.hover.beyond((hover.value, hover.interval))
    unwritten = ({names[0]: beyond} if beyond else {}) | {names[1]: f"{sentence} The value in force stays."}
    return ({} if beyond else {names[0]: hover}), unwritten


def _objections(fitted: Fitted, autopilot: Autopilot, curve: Number | None) -> Iterator[str]:
    """Why no curve can be proposed, whatever its value."""
    if curve is None:
        yield fitted.why_not(CURVE)
        if CURVE not in fitted.quantities:
            yield "Identify with --input-map fit."
    elif fitted.curve_side is CurveSide.BEFORE:
        in_force = fitted.curve_in_force.get(autopilot.curve.name)
        if in_force is None:
            yield f"'{fitted.input}' is before the curve, and the result has no value of it that is in force."
        elif not autopilot.curve.takes(in_force):
            yield f"'{fitted.input}' is before the curve, whose value in force is beyond what is taken."


PX4 = Autopilot(
    "PX4",
    vertical.AutopilotParameter("MPC_THR_HOVER", "PX4", 0.1, 0.8, HOVER_WORDS),
    vertical.THR_MDL_FAC,
    ("dataflash",),
)
#: MOT_THST_HOVER is documented from 0.2 to 0.8, and the motors' library uses no more than 0.6875 of it.
ARDUPILOT = Autopilot(
    "ArduPilot",
    vertical.AutopilotParameter("MOT_THST_HOVER", "ArduPilot", 0.2, 0.6875, HOVER_WORDS),
    vertical.MOT_THST_EXPO,
    ("ulog",),
)

#: Names of the parameters that results propose.
PARAMETERS = frozenset(item.name for pilot in (PX4, ARDUPILOT) for item in (pilot.hover, pilot.curve))


class ParameterChange(msgspec.Struct, frozen=True):
    """A parameter that a log has, beside what a result says of it."""

    parameter: vertical.AutopilotParameter
    quantity: str  # What it is made of
    old: float
    new: Number | None  # What an export would set; None of what is not identified
    estimate: Number | None  # What the vehicle has in the parameter's own terms, rough or not
    missing: str  # Why there is no new value, when that of the quantity is identified


def parameter_changes(fitted: Fitted, logged: Mapping[str, float]) -> tuple[ParameterChange, ...]:
    """Parameters of hover and thrust curve that a log of an autopilot has, old and new."""
    hover = fitted.quantities.get(HOVER)
    if fitted.model != VERTICAL or fitted.input_measured or hover is None or not 0.0 < hover.value < 1.0:
        return ()
    changes = []
    for autopilot in (PX4, ARDUPILOT):
        if set(fitted.formats) & set(autopilot.not_of):
            continue
        numbers, reasons = _proposals(fitted, autopilot)
        usable = fitted.curve_side is CurveSide.BEFORE and hover.verdict in (Status.IDENTIFIED, Status.WEAK)
        for parameter, quantity in ((autopilot.hover, HOVER), (autopilot.curve, CURVE)):
            name = parameter.name
            if name in logged and quantity in fitted.quantities:
                new = numbers.get(name)
                estimate = Number(hover.value, hover.interval) if usable and quantity == HOVER else new
                missing = reasons.get(name, "") if fitted.is_identified(quantity) else ""
                changes.append(ParameterChange(parameter, quantity, logged[name], new, estimate, missing))
    return tuple(changes)


#: Percent that Betaflight takes, and the outputs over which a curve is made straight.
MOST_LINEAR, OUTPUTS = 150, np.linspace(0.05, 1.0, 96)


def thrust_linear(curve: InputMap) -> int:
    """Percent t with which x (1 + t (1 - x)^2) makes thrust go with x, by least squares."""
    percents = np.arange(MOST_LINEAR + 1)
    motor = OUTPUTS * (1.0 + np.multiply.outer(0.01 * percents, (1.0 - OUTPUTS) ** 2))
    unlike = curve(np.minimum(motor, 1.0)) / float(curve(np.ones(1))[0]) - OUTPUTS
    return int(percents[np.argmin(np.square(unlike).sum(axis=1))])


def _betaflight(fitted: Fitted, supplied: Supplied) -> Exported:
    """A line of the command line of Betaflight, made of a fitted curve of motor outputs."""
    supplied.check_only((), "betaflight", body=False)
    fitted.check_vertical("Betaflight")
    if not set(fitted.formats) <= {"blackbox"} or fitted.curve_side is CurveSide.BEFORE:
        expected = "motor outputs of a Betaflight log"
        raise UsageError(expected, f"'{fitted.input}' of {', '.join(fitted.formats)}", "Give its log.")
    curve = fitted.identified_number(CURVE)
    if curve is None:
        unwritten = f"thrust_linear is not written: {fitted.why_not(CURVE)} Identify with --input-map fit."
        return Exported(hash_comments((*fitted.origin(), unwritten)) + "\n", (unwritten,))
    family = Mixed if isinstance(fitted.input_map, Mixed) else Power
    low, value, high = (
        thrust_linear(family(exponent)) for exponent in (curve.interval[0], curve.value, curve.interval[1])
    )
    line = f"thrust_linear: {value}, 95 % interval [{low}, {high}], of the curve {curve.words}"
    return Exported(f"{hash_comments((*fitted.origin(), line))}\nset thrust_linear = {value}\nsave\n")


AUTOPILOTS = targets(
    {
        "px4": _parameter_export(PX4, "px4.params"),
        "ardupilot": _parameter_export(ARDUPILOT, "ardupilot.param"),
        "betaflight": _betaflight,
    }
)
