"""The words of the rigid body: its quantities, the meaning of its verdicts, what to fly and to log."""

from __future__ import annotations

from eivor.flights.estimated import LAG_WORDINGS
from eivor.flights.quantity import Kind, Wording
from eivor.flights.words import CardSection, Words
from eivor.inference.verdict import Status
from eivor.logs.formats import advising_format
from eivor.motions.rigid_body.parameters import (
    ALONG,
    COUPLING,
    DAMPING,
    DRAG,
    DRAG_MOMENT,
    FRICTION,
    GAIN,
    LIFT,
    LIFT_MOMENT,
    OFFSET,
    QUADRATIC_DRAG,
    REACTION,
    SPIN_MOMENT,
    THRUST,
    TURNING,
)
from eivor.motions.rigid_body.rule import FLY

EQUATION = (
    "p' = beta_1 q r + alpha_p sum y phi - d_p p + b; "
    "s_z = alpha_z sum phi - d_z v_z - c_z |v| v_z + h (v_x^2 + v_y^2) + b",
    "phi = map(n); tau n' + n = command(t - d); p rate, v velocity, s force on body axes; others alike",
)
_RATES = "pqr"
QUANTITIES = {
    THRUST.name: Wording("thrust gain", "α_z", "m/s^2", shown_unit="m/s²", optional=True),
    **{
        one.name: Wording(f"{name} gain", f"α_{rate}", one.unit, shown_unit=unit)
        for one, name, rate, unit in zip(
            GAIN, TURNING, _RATES, ("rad/s²/m", "rad/s²/m", "rad/s²"), strict=True
        )
    },
    **{
        one.name: Wording(f"{name} coupling", f"β_{number}", "")
        for number, (one, name) in enumerate(zip(COUPLING, TURNING, strict=True), start=1)
    },
    **{
        one.name: Wording(f"{name} damping", f"d_{rate}", "1/s", shown_unit="1/s")
        for one, name, rate in zip(DAMPING, TURNING, _RATES, strict=True)
    },
    **{
        one.name: Wording(f"drag along {axis}", f"d_{axis}", "1/s", shown_unit="1/s", optional=True)
        for one, axis in zip(DRAG, ALONG, strict=True)
    },
    **{
        one.name: Wording(f"quadratic drag along {axis}", f"c_{axis}", "1/m", shown_unit="1/m", optional=True)
        for one, axis in zip(QUADRATIC_DRAG, ALONG, strict=True)
    },
    FRICTION.name: Wording(
        "viscous friction", "K", FRICTION.unit, kind=Kind.DERIVED, shown_unit="1/s", optional=True
    ),
    LIFT.name: Wording("translational lift", "h", "1/m", shown_unit="1/m", optional=True),
    **{
        one.name: Wording(f"{name} by lift", f"h_{rate}", one.unit, shown_unit="1/m³", optional=True)
        for one, name, rate in zip(LIFT_MOMENT, TURNING, _RATES, strict=False)
    },
    **{
        one.name: Wording(
            f"{name} by drag along {axis}", f"{letter}_{axis}", one.unit, shown_unit="1/(m s)", optional=True
        )
        for name, letter, pair, axes in zip(TURNING, "LMN", DRAG_MOMENT, ("yz", "xz", "xy"), strict=True)
        for one, axis in zip(pair, axes, strict=True)
    },
    **{
        one.name: Wording(f"{name} by spin", f"j_{rate}", "")
        for one, name, rate in zip(SPIN_MOMENT, TURNING, _RATES, strict=False)
    },
    REACTION.name: Wording("rotor reaction", "j", ""),
    **{
        one.name: Wording(f"{name} offset", f"o_{rate}", "rad/s^2", shown_unit="rad/s²")
        for one, name, rate in zip(OFFSET, TURNING, _RATES, strict=False)
    },
    **LAG_WORDINGS,
}
#: The same in the order of reports.
SHOWN = (
    THRUST.name,
    *(one.name for one in GAIN),
    "effective_lag",
    *(name for name in QUANTITIES if name not in {THRUST.name, "effective_lag"} | {one.name for one in GAIN}),
)
WORDS = Words(
    title="Rigid body",
    meanings={
        Status.IDENTIFIED: "the flight tells thrust, roll and pitch gain and the lag within the intervals.",
        Status.WEAK: "the numbers are indications; something keeps the intervals from being trusted.",
        Status.PROVISIONAL: "no instrument: the numbers may be biased more than the intervals say.",
        Status.REFUSED: "the flight cannot tell the gains of thrust, roll and pitch.",
    },
    fly=FLY,
    no_reference="None is logged: no setpoint of height or attitude, no injected sweep.",
    no_lag="The rotor speeds were measured:\nthere is no lag to find.",
)
_MANOEUVRES = (
    "Calm air, at least 3 m above the ground.",
    "60 s: steps of roll and pitch of about 15°, of yaw of about 45°, and of height of 1 m, at uneven times, "
    "each by itself and some together; a few fast straight legs along the body's axes.",
)


def rigid_body_card(log_format_name: str) -> tuple[CardSection, ...]:
    """What to fly and to log; about logs of a format without advice, that of tables."""
    advised = advising_format(log_format_name)
    needed = (
        "Rotor commands, rates, accelerometer, velocity and attitude, and what was asked of height and "
        "attitude."
    )
    return (
        CardSection("Fly", _MANOEUVRES),
        CardSection("Log", (needed, *advised.advice(""))),
        CardSection("Setpoints", (advised.setpoints,)),
    )
