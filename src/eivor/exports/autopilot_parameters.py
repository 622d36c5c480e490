"""Parameters of an autopilot out of a result: which are written, and which are comments.

Both autopilots count hover as a share of thrust and the curve as in `eivor.motions.vertical.curve_family`.
With a curve that was fitted, curve and hover belong together. Of a command before the curve the hover command
alone is the parameter as long as the curve in force stays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from eivor.errors import UsageError
from eivor.exports.fitted import Fitted, Number
from eivor.motions.vertical.curve_family import DECLARE, AutopilotParameter, family_of_fitted, proposed
from eivor.signals.canonical import CurveSide


@dataclass(frozen=True, slots=True)
class Autopilot:
    """What an autopilot calls hover and thrust curve.

    Parameters
    ----------
    name : str
        In words.
    hover, curve : AutopilotParameter
        Share of thrust at hover, and share of the square in the thrust curve.
    not_of : tuple of str
        Formats of the other autopilots' logs, whose shares are counted otherwise.
    """

    name: str
    hover: AutopilotParameter
    curve: AutopilotParameter
    not_of: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Chosen:
    """What is written of a result.

    Parameters
    ----------
    written : tuple of (str, Number)
        Names and numbers.
    comments : tuple of str
        Sentences above them.
    left_out : tuple of str
        Those of the comments that say what is missing.
    """

    written: tuple[tuple[str, Number], ...]
    comments: tuple[str, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Found:
    """Numbers by the autopilot's names, and why others are missing."""

    numbers: dict[str, Number] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)


def chosen_parameters(fitted: Fitted, autopilot: Autopilot) -> Chosen:
    """Return the parameters of an autopilot that a result tells.

    Raises
    ------
    UsageError
        When the result is of another motion or another autopilot's log, or its commands are no shares.
    """
    fitted.check_vertical(autopilot.name)
    _check_autopilot(fitted, autopilot)
    _check_shares(fitted)
    found = _found(fitted, autopilot)
    written = tuple(found.numbers.items())
    missing = tuple(f"{name} is not written: {reason}" for name, reason in found.missing.items())
    told = tuple(f"{name}: {number.words}" for name, number in written)
    return Chosen(written, (*fitted.origin(), *told, *missing), missing)


def _check_autopilot(fitted: Fitted, autopilot: Autopilot) -> None:
    """Refuse results of a log of another autopilot."""
    others = [f"format {one}" for one in fitted.formats if one in autopilot.not_of]
    if fitted.curve_in_force and autopilot.curve.name not in fitted.curve_in_force:
        others.append(f"a vehicle with {' and '.join(fitted.curve_in_force)}")
    if others:
        raise UsageError(
            f"a flight of {autopilot.name}, since each autopilot counts shares of thrust in its own way",
            f"a result of a log of {others[0]}",
            "Export to the autopilot that flew.",
        )


def _check_shares(fitted: Fitted) -> None:
    """Refuse results whose command is in another unit, such as rotor speeds or pulse widths."""
    value = fitted.quantities["hover_input"].value if "hover_input" in fitted.quantities else float("nan")
    if fitted.input_measured or value >= 1.0:
        raise UsageError(
            "a command that is a share of the largest, from 0 to 1",
            f"'{fitted.input}', with {value:.4g} at hover",
            "Identify with the log's thrust setpoint, --input input, or with its motor outputs, "
            "--input actuator_output, where parameters tell their range.",
        )


def _found(fitted: Fitted, autopilot: Autopilot) -> _Found:
    """Curve and hover together, hover alone where the curve in force stays, or neither."""
    hover, curve = fitted.told("hover_input"), fitted.told("thrust_curve")
    names = autopilot.hover.name, autopilot.curve.name
    if fitted.curve_side is CurveSide.UNKNOWN:
        reason = (
            f"the result does not say whether '{fitted.input}' is before or behind the autopilot's thrust "
            f"curve. Identify the log again. {DECLARE}"
        )
        return _Found(missing=dict.fromkeys(names, reason))
    before = fitted.curve_side is CurveSide.BEFORE
    if hover is None:
        return _Found(missing=dict.fromkeys(names, fitted.why_not("hover_input")))
    reasons = list(_against(fitted, autopilot, curve))
    if curve is not None and not reasons:
        share, thrust = proposed(
            autopilot.curve,
            family_of_fitted(fitted.input_map),
            (curve.value, curve.interval),
            (hover.value, hover.interval),
            fitted.curve_in_force[autopilot.curve.name] if before else None,
        )
        beyond = autopilot.curve.beyond(share)
        if not beyond:
            beyond = autopilot.hover.beyond(thrust)
            beyond = f"it goes with {autopilot.hover.name}, and {beyond}" if beyond else ""
        if not beyond:
            return _Found({autopilot.hover.name: Number(*thrust), autopilot.curve.name: Number(*share)})
        reasons = [beyond]
    sentence = " ".join(reasons)
    if not before:
        together = f"of motor signals, hover and curve are written together or not at all: {sentence}"
        return _Found(missing=dict.fromkeys(names, together))
    beyond = autopilot.hover.beyond((hover.value, hover.interval))
    missing = {autopilot.hover.name: beyond} if beyond else {}
    missing[autopilot.curve.name] = f"{sentence} The value in force stays."
    return _Found({} if beyond else {autopilot.hover.name: hover}, missing)


def _against(fitted: Fitted, autopilot: Autopilot, curve: Number | None) -> Iterator[str]:
    """Why no curve can be proposed, whatever its value."""
    if curve is None:
        yield fitted.why_not("thrust_curve")
        if "thrust_curve" not in fitted.quantities:
            yield "Identify with --input-map fit."
    elif fitted.curve_side is CurveSide.BEFORE:
        in_force = fitted.curve_in_force.get(autopilot.curve.name)
        if in_force is None:
            yield f"'{fitted.input}' is before the curve, and the result has no value of it that is in force."
        elif not autopilot.curve.takes(in_force):
            yield f"'{fitted.input}' is before the curve, whose value in force is beyond what is taken."
