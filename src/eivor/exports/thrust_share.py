"""Hover and thrust curve as autopilots count them: commands that are shares of the largest.

The curve of both autopilots is thrust = (1 - f) s + f s^2, s the signal to a motor. A setpoint of thrust
comes before that curve: its hover value is the autopilot's parameter as it stands, whatever f is in force.
Signals to the motors come behind it: with f found out of them the hover thrust is (1 - f) s_h + f s_h^2, and
both are written or neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

from eivor.errors import UsageError
from eivor.exports.fitted import Fitted, Number
from eivor.motions.vertical.curve_family import family_of, share_of_both

#: Channels that are setpoints of thrust, and signals to the motors.
SETPOINT, MOTORS = "input", "rotor_command"


@dataclass(frozen=True, slots=True)
class ThrustShare:
    """What an autopilot would be told.

    Parameters
    ----------
    hover : Number or None
        Share of thrust at hover; None where it is not known.
    curve : Number or None
        Share f of the square; None where it is not known.
    hover_missing, curve_missing : str
        Why not; empty where it is known.
    """

    hover: Number | None
    curve: Number | None
    hover_missing: str = ""
    curve_missing: str = ""


def thrust_share(fitted: Fitted) -> ThrustShare:
    """Hover and curve of a result whose commands are shares of the largest.

    Raises
    ------
    UsageError
        When its commands are in another unit, such as rotor speeds.
    """
    value = fitted.quantities["hover_input"].value if "hover_input" in fitted.quantities else float("nan")
    if fitted.input not in {SETPOINT, MOTORS} or fitted.input_measured or value >= 1.0:
        raise UsageError(
            "a command that is a share of the largest, from 0 to 1",
            f"'{fitted.input}', with {value:.4g} at hover",
            f"Identify with the log's thrust setpoint, --input {SETPOINT}, or the signals to its motors, "
            f"--input {MOTORS}.",
        )
    hover = fitted.told("hover_input")
    if fitted.input == SETPOINT:
        return ThrustShare(
            hover,
            None,
            "" if hover else fitted.why_not("hover_input"),
            "The curve is that of motors' signals: a thrust setpoint comes before it. "
            f"Identify with --input {MOTORS} --input-map fit.",
        )
    curve = fitted.told("thrust_curve")
    if hover is None or curve is None:
        missing = fitted.why_not("thrust_curve" if curve is None else "hover_input")
        ask = "" if "thrust_curve" in fitted.quantities else " Identify with --input-map fit."
        both = f"Of motors' signals hover and curve are told together or not at all: {missing}{ask}"
        return ThrustShare(None, None, both, both)
    return _of_signals(fitted, hover, curve)


def _of_signals(fitted: Fitted, hover: Number, curve: Number) -> ThrustShare:
    """Both, of signals to the motors; the intervals hold whatever hover and curve are within theirs."""
    family = family_of(fitted.input_map)
    corners = [
        (share_of_both(family, one, signal, 0.0), signal)
        for one, signal in product((curve.value, *curve.interval), (hover.value, *hover.interval))
    ]
    shares = [share for share, _ in corners]
    thrusts = [(1.0 - share) * signal + share * signal**2 for share, signal in corners]
    return ThrustShare(
        Number(thrusts[0], (min(thrusts), max(thrusts))), Number(shares[0], (min(shares), max(shares)))
    )
