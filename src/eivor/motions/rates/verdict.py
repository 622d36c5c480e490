"""Axes, systematic parts and verdict of the turning rates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf

from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_QUANTITIES
from eivor.flights.motion import InstrumentStrength, VerdictInputs
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import (
    CardSection,
    Counts,
    CoupledAxis,
    QuantityEstimate,
    QuantitySpec,
    QuantityTable,
    SystematicUncertainty,
    Words,
    clock_uncertainty,
)
from eivor.flights.references import ReferenceSource
from eivor.flights.verdict import (
    FlightRule,
    has_no_bounds,
    longest_lag_reasons,
    moved,
    refused,
    strength_of,
    weak,
    wide_lag_reasons,
)
from eivor.inference.verdict import Reason, Status
from eivor.logs.read import advising_format
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.regression import Parameter

# -- Axes --


@dataclass(frozen=True)
class Axis:
    """One axis."""

    name: str  # "roll", "pitch" or "yaw"
    letter: str
    number: int
    reacts: bool = False

    @property
    def rate(self) -> str:
        """Channel of the rate."""
        return f"angular_rate_{self.letter}"

    @property
    def torque(self) -> str:
        """Channel of the setpoint."""
        return f"torque_setpoint_{self.letter}"

    @property
    def effectiveness(self) -> Parameter:
        """Control effectiveness G."""
        return Parameter(f"{self.name}_effectiveness", "rad/s^2")

    @property
    def damping(self) -> Parameter:
        """Damping D."""
        return Parameter(f"{self.name}_damping", "1/s")

    @property
    def reaction(self) -> Parameter:
        """Reaction to the rotors' acceleration J."""
        return Parameter(f"{self.name}_reaction", "rad/s")

    @property
    def references(self) -> tuple[ReferenceSource, ...]:
        """Channels that may be instruments."""
        return (
            ReferenceSource(f"injected_torque_{self.letter}", axis=self.name),
            ReferenceSource(f"reference_{self.name}", axis=self.name),
            ReferenceSource(f"reference_angular_rate_{self.letter}", axis=self.name),
            ReferenceSource(f"pilot_{self.name}", in_control="pilot_sets_attitude", axis=self.name),
            ReferenceSource(f"feedback_reference_{self.name}", axis=self.name),
        )


ROLL, PITCH, YAW = Axis("roll", "x", 0), Axis("pitch", "y", 1), Axis("yaw", "z", 2, reacts=True)
AXES = (ROLL, PITCH, YAW)
#: Family of the setpoints.
TORQUE = "torque_setpoint"


# -- Systematic parts --

#: What that does to an effectiveness, as a share of it, and to the lag [s].
ROTOR_SHARE, ROTOR_LAG_S = 0.02, 0.001
ROTORS = "Rotors lag in speed, and their thrust goes with its square: large or noisy setpoints change the "


def all_systematic_uncertainties(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, QuantityEstimate]
) -> dict[str, tuple[SystematicUncertainty, ...]]:
    """Systematic parts of effectiveness and lag."""
    sizes = {
        axis.effectiveness.name: ROTOR_SHARE * abs(quantities[axis.effectiveness.name].value)
        for axis in AXES
        if axis.effectiveness.name in quantities
    }
    by_rotors = SystematicUncertainty(Counts.ADDED, ROTOR_LAG_S, ROTOR_LAG_S, f"{ROTORS}lag by 1 ms.")
    slack_s = max(flight.command_slack_s for flight in flights)
    of_lag = (*clock_uncertainty(slack_s), by_rotors)
    return {
        **{
            name: (SystematicUncertainty(Counts.ADDED, size, size, f"{ROTORS}effectiveness by 2 %."),)
            for name, size in sizes.items()
        },
        **dict.fromkeys((ACTUATOR_LAG.name, EFFECTIVE_LAG), of_lag),
    }


# -- Rule --

EFFECTIVENESS_SHARE = 0.25
DAMPING_SHARE = 0.5
LAG_HALF_WIDTH_S = 0.02

FLY = (
    "Fly quick steps of roll and pitch of about 15 degrees to both sides for 60 s, in a mode in which the "
    "sticks set the attitude."
)
TURN_LONGER = "Fly turns that last longer."
OF_FLIGHT = FlightRule(
    fly=FLY,
    log_reference="Log the attitude setpoint, or the pilot's roll and pitch sticks, at 20 Hz or more.",
    log_planned="Fly in a mode in which the sticks set the attitude, or inject a sweep.",
    moves="turns",
    undisturbed="Fly slowly and away from walls and ground; keep the motors from their limits.",
    command_rate_hz=45.0,
    slow_command="The torque setpoints are logged at {rate:.0f} Hz; below {least:.0f} Hz the intervals do "
    "not hold.",
    log_faster="Log them at 50 Hz or more.",
    least_s=15.0,
)


def all_reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength, inputs: VerdictInputs
) -> dict[str, tuple[Reason, ...]]:
    """Reasons against every quantity that there is."""

    def reasons(own: Iterable[Reason], *names: str) -> tuple[Reason, ...]:
        shared = OF_FLIGHT.reasons(strength_of(strength, *names), inputs)
        return (*shared, *own, *rough_lag_reasons(quantities, strength))

    results = dict.fromkeys((ACTUATOR_LAG.name, DELAY.name, EFFECTIVE_LAG), reasons(()))
    for axis in AXES:
        effect, damping = axis.effectiveness.name, axis.damping.name
        if effect in quantities:
            own = (
                ()
                if has_no_bounds(effect, strength)
                else effectiveness_reasons(axis, quantities[effect], inputs)
            )
            results[effect] = reasons(own, effect)
            results[damping] = reasons(damping_reasons(axis, quantities[damping], inputs), effect, damping)
            if axis.reacts:
                results[axis.reaction.name] = reasons((), effect, axis.reaction.name)
    return results


def effectiveness_reasons(axis: Axis, effect: QuantityEstimate, inputs: VerdictInputs) -> Iterator[Reason]:
    """Reasons that the interval of an axis' effectiveness gives."""
    (low, high), words = effect.interval, f"The {axis.name} effectiveness"
    if high < 0.0:
        yield refused(
            f"{words} came out at {effect.value:.3g} rad/s^2, below zero: setpoint and rate of {axis.name} "
            "have opposite signs.",
            f"Check the axes and signs of {axis.torque} and {axis.rate}.",
        )
    elif effect.value <= 0.0 or low <= 0.0:
        zero = f"{words} cannot be distinguished from zero: its interval is [{low:.2g}, {high:.2g}] rad/s^2."
        yield refused(f"{zero}{moved(inputs)}", FLY)
    elif inf > effect.half_width > EFFECTIVENESS_SHARE * effect.value:
        yield weak(
            f"{words}' interval is +-{effect.half_width / effect.value:.1%} wide; identified asks for "
            f"+-{EFFECTIVENESS_SHARE:.0%}.{moved(inputs)}",
            "Fly larger and quicker steps, or longer.",
        )


def damping_reasons(axis: Axis, damping: QuantityEstimate, inputs: VerdictInputs) -> Iterator[Reason]:
    """Reasons that the interval of an axis' damping gives."""
    (low, high), words = damping.interval, f"The {axis.name} damping"
    if high < 0.0:
        below = f"{words} came out at {damping.value:.3g} 1/s, below zero: a torque of the air moved with "
        yield weak(f"{below}the references.", "Fly in calm air.")
    elif low <= 0.0:
        yield weak(f"{words} cannot be distinguished from zero.{moved(inputs)}", TURN_LONGER)
    elif inf > damping.half_width > DAMPING_SHARE * damping.value:
        share = damping.half_width / damping.value
        wide = f"{words}'s interval is +-{share:.0%} wide; identified asks for +-{DAMPING_SHARE:.0%}."
        yield weak(wide, TURN_LONGER)


def rough_lag_reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength
) -> Iterator[Reason]:
    """Reasons that a lag gives that is not well known."""
    if ACTUATOR_LAG.name in strength.searched:
        half_width = quantities[EFFECTIVE_LAG].half_width
        quicker = "Fly quicker steps, and log setpoints and rates faster."
        yield from wide_lag_reasons(half_width, LAG_HALF_WIDTH_S, whose="actuators'", remedy=quicker)
        remedy = "Check that the setpoints are those of this vehicle, and their time stamps."
        yield from longest_lag_reasons(strength, remedy=remedy)


# -- Thrust --

THRUST = CoupledAxis(
    motion="vertical",
    quantity="input_gain",
    called="thrust_gain",
    input="input",
    input_map="linear",  # a setpoint of thrust, whatever map the rotors of the same log have
    needs={
        "thrust setpoint": ("input",),
        "accelerometer": ("specific_force_body_z", "specific_force_z", "acceleration_z"),
    },
)


# -- QuantitySpec --

EQUATION = (
    "p' = G_p u_p - D_p p + b; q' alike; r' = G_r u_r + J u_r' - D_r r + b; z'' + g = G_z u_z - K z' + b",
    "(p, q, r) body rates; tau u' + u = torque setpoint(t - d), one lag for all axes",
)
#: Every quantity: effectiveness of each axis, what all axes share, damping.
QUANTITIES = QuantityTable(
    {
        **{
            axis.effectiveness.name: QuantitySpec(
                f"{axis.name} effectiveness",
                f"G_{rate}",
                "rad/s^2",
                shown_unit="rad/s²",
                optional=axis.reacts,
                headline=not axis.reacts,
                in_rows=not axis.reacts,
            )
            for axis, rate in zip(AXES, "pqr", strict=True)
        },
        THRUST.called: QuantitySpec("thrust gain", "G_z", "m/s^2", shown_unit="m/s²", optional=True),
        EFFECTIVE_LAG: replace(LAG_QUANTITIES[EFFECTIVE_LAG], in_rows=True),
        **{
            axis.damping.name: QuantitySpec(
                f"{axis.name} damping", f"D_{rate}", "1/s", shown_unit="1/s", optional=axis.reacts
            )
            for axis, rate in zip(AXES, "pqr", strict=True)
        },
        YAW.reaction.name: QuantitySpec("yaw reaction", "J", "rad/s", shown_unit="rad/s", optional=True),
        ACTUATOR_LAG.name: LAG_QUANTITIES[ACTUATOR_LAG.name],
        DELAY.name: LAG_QUANTITIES[DELAY.name],
    }
)

_MANOEUVRES = (
    "Calm air, at least 3 m above the ground, a mode in which the sticks set the attitude "
    "(stabilized or altitude).",
    "60 s of roll and pitch steps of about 15°, to and fro, one every second or two at uneven times, "
    "each axis by itself. A few turns of yaw, and for the thrust gain steps of height.",
    "Or the autopilot's identification mode, which injects a sweep.",
)


def rates_card(log_format_name: str) -> tuple[CardSection, ...]:
    """What to fly and to log; about logs of a format without advice, that of tables."""
    setpoints = "Torque setpoints, rates, and attitude setpoint or sticks, at 50 Hz or more."
    return (
        CardSection("Fly", _MANOEUVRES),
        CardSection("Log", advising_format(log_format_name).advice("")),
        CardSection("Setpoints", (setpoints,)),
    )


WORDS = Words(
    title="Turning about the body axes",
    model="body_rates",
    meanings={
        Status.IDENTIFIED: "the effectiveness of roll and pitch is identified, within its intervals.",
        Status.WEAK: "the numbers are indications; something keeps the intervals from being trusted.",
        Status.PROVISIONAL: "no instrument: least squares has the effectiveness too small, the lag too long.",
        Status.REFUSED: "the flight does not identify the effectiveness of roll and pitch.",
    },
    fly=FLY,
    no_reference="None is logged: no attitude setpoint, no stick, no injected sweep.",
    advice=rates_card,
)
