"""The words of the vertical motion: its quantities, the meaning of its verdicts, what to fly and to log."""

from __future__ import annotations

from eivor.flights.across import AcrossFlights, Covariate
from eivor.flights.estimated import EFFECTIVE_LAG, LAG_WORDINGS
from eivor.flights.quantity import Kind, Wording
from eivor.flights.words import CardSection, Words
from eivor.inference.verdict import Status
from eivor.logs.formats import advising_format
from eivor.models.lagged_runs import ACTUATOR_LAG
from eivor.motions.vertical.remedies import FLY

EQUATION = (
    "z'' + g = K_u U - K z' + b",
    "U = cos(tilt) * mean(map(w)); tau w' + w = command(t - d)",
)
#: Every quantity, in the order of results.
QUANTITIES = {
    "viscous_friction": Wording("viscous friction", "K", "1/s", shown_unit="1/s"),
    "input_gain": Wording("input gain", "K_u", "m/s^2", shown_unit="m/s²"),
    "quadratic_drag": Wording("quadratic drag", "K_2", "1/m", shown_unit="1/m", optional=True),
    "ground_effect": Wording("ground effect", "k", "", optional=True),
    "voltage_exponent": Wording("voltage exponent", "n", "", optional=True),
    "intercept": Wording("intercept", "b", "m/s^2", shown_unit="m/s²", by_run=True),
    **LAG_WORDINGS,
    "hover_input": Wording("hover input", "u_h", "", Kind.DERIVED),
    "thrust_curve": Wording("thrust curve", "c", "", optional=True),
    "time_constant": Wording("time constant", "1/K", "s", Kind.DERIVED, shown_unit="s", lowest=0.0),
}
#: The same in the order of reports.
SHOWN = (
    "viscous_friction",
    "time_constant",
    "input_gain",
    "hover_input",
    "effective_lag",
    "actuator_lag",
    "delay",
    "intercept",
    "quadratic_drag",
    "ground_effect",
    "voltage_exponent",
    "thrust_curve",
)
#: Thrust is proportional to the density of the air; with the voltage it grows by a power of 0 to 2.
#: What hovers goes against both, by half as much where thrust goes with the square of the command.
#: Forces that a payload leaves as they are accelerate a larger mass less.
ACROSS = (
    AcrossFlights(
        "viscous_friction",
        covariates=(Covariate("air_density"), Covariate("mass", -1.0, 0.3)),
        told_by=("viscous_friction",),
    ),
    AcrossFlights(
        "input_gain",
        logarithm=True,
        covariates=(
            Covariate("air_density", 1.0, 0.3),
            Covariate("battery_voltage", 1.0, 1.0),
            Covariate("mass", -1.0, 0.1),
        ),
        told_by=("input_gain",),
    ),
    AcrossFlights(
        EFFECTIVE_LAG,
        logarithm=True,
        covariates=(Covariate("battery_voltage", 0.0, 1.0),),
        told_by=(ACTUATOR_LAG.name,),
    ),
    AcrossFlights(
        "hover_input",
        logarithm=True,
        largest=1.0,
        covariates=(
            Covariate("air_density", -0.75, 0.3),
            Covariate("battery_voltage", -0.75, 0.75),
            Covariate("mass", 0.75, 0.25),
        ),
    ),
)
WORDS = Words(
    title="Vertical motion",
    meanings={
        Status.IDENTIFIED: "the flight tells the viscous friction within the interval.",
        Status.WEAK: "the numbers are indications; something keeps the intervals from being trusted.",
        Status.PROVISIONAL: "no instrument: the numbers may be biased more than the intervals say.",
        Status.REFUSED: "the flight cannot tell the viscous friction.",
    },
    fly=FLY,
    limits="inside the window and below the largest tilt",
    limited_by="tilt, window and gaps",
    loosen="Widen the window, allow more tilt with --max-tilt, or fly level.",
    no_reference="None is logged: no position, velocity or acceleration setpoint, and no stick.",
    no_lag="The rotor speeds were measured:\nthere is no lag to find.",
)

_MANOEUVRES = (
    "Calm air, at least 3 m above the ground, position (or altitude) mode, tilt below 20°.",
    "60 s of height steps of 2 m, up and down, a new one every 3 to 6 s at uneven times; or a sweep of the "
    "height setpoint of ±1 m from 0.1 to 0.5 Hz. Climb and descend at about 2 m/s.",
    "Fly it two or three times and give all the logs: eivor identify LOG1 LOG2 LOG3 pools them.",
)


def vertical_card(log_format_name: str) -> tuple[CardSection, ...]:
    """What to fly and to log; about logs of a format without advice, that of tables."""
    advised = advising_format(log_format_name)
    return (
        CardSection("Fly", _MANOEUVRES),
        CardSection("Log", advised.advice("")),
        CardSection("Setpoints", (advised.setpoints,)),
    )
