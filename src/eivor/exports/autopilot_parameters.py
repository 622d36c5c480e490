"""Parameters of an autopilot out of a result: which are written, and which are comments."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.errors import UsageError
from eivor.exports.fitted import Fitted, Number
from eivor.exports.thrust_share import thrust_share


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an autopilot.

    Parameters
    ----------
    name : str
        As the autopilot calls it.
    lowest, highest : float
        What the autopilot takes.
    """

    name: str
    lowest: float
    highest: float


@dataclass(frozen=True, slots=True)
class Autopilot:
    """What an autopilot calls hover and thrust curve.

    Parameters
    ----------
    name : str
        In words.
    hover, curve : Parameter
        Share of thrust at hover, and share of the square in the thrust curve.
    not_of : tuple of str
        Formats of the other autopilots' logs, whose shares are counted otherwise.
    """

    name: str
    hover: Parameter
    curve: Parameter
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


def chosen_parameters(fitted: Fitted, autopilot: Autopilot) -> Chosen:
    """Return the parameters of an autopilot that a result tells.

    Raises
    ------
    UsageError
        When the result is of another motion or another autopilot's log, or its commands are no shares.
    """
    fitted.check_vertical(autopilot.name)
    for one in fitted.formats:
        if one in autopilot.not_of:
            raise UsageError(
                f"a flight of {autopilot.name}, since each autopilot counts shares of thrust in its own way",
                f"a result of a log of format {one}",
                "Export to the autopilot that flew.",
            )
    found = thrust_share(fitted)
    wanted = (
        (autopilot.hover, found.hover, found.hover_missing),
        (autopilot.curve, found.curve, found.curve_missing),
    )
    missing = {
        parameter.name: f"{parameter.name} is not written: {_missing(parameter, number, reason)}"
        for parameter, number, reason in wanted
        if number is None or not parameter.lowest <= number.value <= parameter.highest
    }
    if found.curve is not None and missing:  # of motors' signals hover and curve belong together
        for parameter, _, _ in wanted:
            missing.setdefault(
                parameter.name, f"{parameter.name} is not written: it goes with {next(iter(missing))}."
            )
    written = tuple(
        (parameter.name, number)
        for parameter, number, _ in wanted
        if number is not None and parameter.name not in missing
    )
    told = tuple(f"{name}: {number.words}" for name, number in written)
    return Chosen(written, (*fitted.origin(), *told, *missing.values()), tuple(missing.values()))


def _missing(parameter: Parameter, number: Number | None, reason: str) -> str:
    if number is None:
        return reason
    return (
        f"{number.words}, is beyond what the autopilot takes, {parameter.lowest:g} to {parameter.highest:g}."
    )
