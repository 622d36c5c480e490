"""The words of turning: its quantities, the meaning of its verdicts, what to fly and to log."""

from __future__ import annotations

from eivor.flights.estimated import LAG_WORDINGS
from eivor.flights.quantity import Wording
from eivor.flights.words import CardSection, Words
from eivor.inference.verdict import Status
from eivor.logs.formats import advising_format
from eivor.motions.rates.axes import AXES, PITCH, ROLL, YAW, Axis
from eivor.motions.rates.rule import FLY
from eivor.motions.rates.thrust import THRUST

EQUATION = (
    "p' = G_p u_p - D_p p + b; q' alike; r' = G_r u_r + J u_r' - D_r r + b; z'' + g = G_z u_z - K z' + b",
    "(p, q, r) body rates; tau u' + u = torque setpoint(t - d), one lag for all axes",
)
_SUBSCRIPT = {ROLL: "p", PITCH: "q", YAW: "r"}


def _of_axis(axis: Axis) -> dict[str, Wording]:
    subscript, optional = _SUBSCRIPT[axis], axis.reacts
    found = {
        axis.effectiveness.name: Wording(
            f"{axis.name} effectiveness", f"G_{subscript}", "rad/s^2", shown_unit="rad/s²", optional=optional
        ),
        axis.damping.name: Wording(
            f"{axis.name} damping", f"D_{subscript}", "1/s", shown_unit="1/s", optional=optional
        ),
    }
    if axis.reacts:
        found[axis.reaction.name] = Wording(
            f"{axis.name} reaction", "J", "rad/s", shown_unit="rad/s", optional=optional
        )
    return found


#: Every quantity, in the order of results.
QUANTITIES = {
    **{name: wording for axis in AXES for name, wording in _of_axis(axis).items()},
    THRUST.called: Wording("thrust gain", "G_z", "m/s^2", shown_unit="m/s²", optional=True),
    **LAG_WORDINGS,
}
#: The same in the order of reports.
SHOWN = (
    *(axis.effectiveness.name for axis in AXES),
    THRUST.called,
    "effective_lag",
    *(axis.damping.name for axis in AXES),
    YAW.reaction.name,
    "actuator_lag",
    "delay",
)
WORDS = Words(
    title="Turning about the body axes",
    meanings={
        Status.IDENTIFIED: "the flight tells the effectiveness of roll and pitch within the intervals.",
        Status.WEAK: "the numbers are indications; something keeps the intervals from being trusted.",
        Status.PROVISIONAL: "no instrument: least squares has the effectiveness too small, the lag too long.",
        Status.REFUSED: "the flight cannot tell the effectiveness of roll and pitch.",
    },
    fly=FLY,
    no_reference="None is logged: no attitude setpoint, no stick, no injected sweep.",
)

_MANOEUVRES = (
    "Calm air, at least 3 m above the ground, a mode in which the sticks set the attitude "
    "(stabilized or altitude).",
    "60 s of roll and pitch steps of about 15°, to and fro, one every second or two at uneven times, "
    "each axis by itself; a few turns of yaw; and for the thrust gain steps of height.",
    "Or the autopilot's identification mode, which injects a sweep.",
)


def rates_card(log_format_name: str) -> tuple[CardSection, ...]:
    """What to fly and to log; about logs of a format without advice, that of tables."""
    advised = advising_format(log_format_name)
    return (
        CardSection("Fly", _MANOEUVRES),
        CardSection("Log", advised.advice("")),
        CardSection(
            "Setpoints", ("Torque setpoints, rates, and attitude setpoint or sticks, at 50 Hz or more.",)
        ),
    )
