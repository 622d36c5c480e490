"""Axes, allowances and verdict of the turning rates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_WORDINGS
from eivor.flights.motion import InstrumentStrength, VerdictInputs
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import (
    CardSection,
    Counts,
    CoupledAxis,
    QuantityEstimate,
    SystematicUncertainty,
    Wording,
    Words,
    clock_uncertainty,
)
from eivor.flights.references import ReferenceSource
from eivor.flights.verdict import (
    disagreement_reasons,
    instrument_reasons,
    lag_prior_reasons,
    longest_lag_reasons,
    moved,
    short_flight_reasons,
    strength_of,
    untold,
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


# -- Allowances --

#: What that does to an effectiveness, as a share of it, and to the lag [s].
ROTOR_SHARE, ROTOR_LAG_S = 0.02, 0.001
ROTORS = "Rotors lag in speed, and their thrust goes with its square: large or noisy setpoints change the "


def all_systematic_uncertainties(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, QuantityEstimate]
) -> dict[str, tuple[SystematicUncertainty, ...]]:
    """Systematic parts of effectiveness and lag."""
    results: dict[str, tuple[SystematicUncertainty, ...]] = {}
    for axis in AXES:
        name = axis.effectiveness.name
        if name in quantities:
            part = ROTOR_SHARE * abs(quantities[name].value)
            results[name] = (
                SystematicUncertainty(Counts.ADDED, part, part, f"{ROTORS}effectiveness by 2 %."),
            )
    by_rotors = SystematicUncertainty(Counts.ADDED, ROTOR_LAG_S, ROTOR_LAG_S, f"{ROTORS}lag by 1 ms.")
    by_stamps = clock_uncertainty(max(flight.command_slack_s for flight in flights))
    return {**results, **dict.fromkeys((ACTUATOR_LAG.name, EFFECTIVE_LAG), (*by_stamps, by_rotors))}


# -- Rule --

EFFECTIVENESS_SHARE = 0.25
DAMPING_SHARE = 0.5
LAG_HALF_WIDTH_S = 0.02
COMMAND_RATE_HZ = 45.0
SHORT_FLIGHT_S = 15.0

FLY = (
    "Fly quick steps of roll and pitch of about 15 degrees to both sides for 60 s, in a mode in which the "
    "sticks set the attitude."
)
LOG_REFERENCE = "Log the attitude setpoint, or the pilot's roll and pitch sticks, at 20 Hz or more."
LOG_PLANNED = "Fly in a mode in which the sticks set the attitude, or inject a sweep."


def all_reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength, inputs: VerdictInputs
) -> dict[str, tuple[Reason, ...]]:
    """Reasons against every quantity that there is."""
    results: dict[str, tuple[Reason, ...]] = {}
    for axis in AXES:
        if axis.effectiveness.name not in quantities:
            continue
        effect, damping = axis.effectiveness.name, axis.damping.name
        results[effect] = (
            *shared_reasons(strength_of(strength, effect), inputs),
            *effectiveness_reasons(axis, quantities[effect], strength, inputs),
            *rough_lag_reasons(quantities, strength),
        )
        results[damping] = (
            *shared_reasons(strength_of(strength, effect, damping), inputs),
            *damping_reasons(axis, quantities[damping], inputs),
            *rough_lag_reasons(quantities, strength),
        )
        if axis.reacts:
            name = axis.reaction.name
            results[name] = (
                *shared_reasons(strength_of(strength, effect, name), inputs),
                *rough_lag_reasons(quantities, strength),
            )
    lag = (*shared_reasons(strength_of(strength), inputs), *rough_lag_reasons(quantities, strength))
    return {**results, ACTUATOR_LAG.name: lag, DELAY.name: lag, "effective_lag": lag}


def shared_reasons(strength: InstrumentStrength, inputs: VerdictInputs) -> list[Reason]:
    """Grounds that instruments, logging and length of the flight give."""
    reasons = instrument_reasons(
        strength, inputs, fly=FLY, log_reference=LOG_REFERENCE, log_planned=LOG_PLANNED
    )
    remedy = "Fly slowly and away from walls and ground; keep the motors from their limits."
    reasons += disagreement_reasons(strength, moves="turns", remedy=remedy)
    if inputs.command_rate_hz < COMMAND_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The torque setpoints are logged at {inputs.command_rate_hz:.0f} Hz; below "
                f"{COMMAND_RATE_HZ:.0f} Hz the intervals do not hold.",
                "Log them at 50 Hz or more.",
            )
        )
    reasons += short_flight_reasons(inputs, SHORT_FLIGHT_S)
    reasons.extend(lag_prior_reasons(inputs))
    return reasons


def effectiveness_reasons(
    axis: Axis, effect: QuantityEstimate, strength: InstrumentStrength, inputs: VerdictInputs
) -> list[Reason]:
    """Grounds that the interval of an axis' effectiveness gives."""
    if untold(axis.effectiveness.name, strength):
        return []
    low, high = effect.interval
    if high < 0.0:
        return [
            Reason(
                Status.REFUSED,
                f"The {axis.name} effectiveness came out at {effect.value:.3g} rad/s^2, below zero: "
                f"setpoint and rate of {axis.name} have opposite signs.",
                f"Check the axes and signs of {axis.torque} and {axis.rate}.",
            )
        ]
    if effect.value <= 0.0 or low <= 0.0:
        return [
            Reason(
                Status.REFUSED,
                f"The {axis.name} effectiveness cannot be distinguished from zero: its interval is "
                f"[{low:.2g}, "
                f"{high:.2g}] rad/s^2.{moved(inputs)}",
                FLY,
            )
        ]
    if inf > effect.half_width > EFFECTIVENESS_SHARE * effect.value:
        return [
            Reason(
                Status.WEAK,
                f"The {axis.name} effectiveness' interval is +-{effect.half_width / effect.value:.1%} "
                f"wide; identified asks for +-{EFFECTIVENESS_SHARE:.0%}.{moved(inputs)}",
                "Fly larger and quicker steps, or longer.",
            )
        ]
    return []


def damping_reasons(axis: Axis, damping: QuantityEstimate, inputs: VerdictInputs) -> list[Reason]:
    """Grounds that the interval of an axis' damping gives."""
    if damping.interval[1] < 0.0:
        return [
            Reason(
                Status.WEAK,
                f"The {axis.name} damping came out at {damping.value:.3g} 1/s, below zero: a torque "
                "of the air moved with the references.",
                "Fly in calm air.",
            )
        ]
    if damping.interval[0] <= 0.0:
        return [
            Reason(
                Status.WEAK,
                f"The {axis.name} damping cannot be distinguished from zero.{moved(inputs)}",
                "Fly turns that last longer.",
            )
        ]
    if inf > damping.half_width > DAMPING_SHARE * damping.value:
        share = damping.half_width / damping.value
        return [
            Reason(
                Status.WEAK,
                f"The {axis.name} damping's interval is +-{share:.0%} wide; identified asks for "
                f"+-{DAMPING_SHARE:.0%}.",
                "Fly turns that last longer.",
            )
        ]
    return []


def rough_lag_reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength
) -> list[Reason]:
    """Grounds that a lag gives that is not well known."""
    if ACTUATOR_LAG.name not in strength.searched:
        return []
    half_width = quantities["effective_lag"].half_width
    quicker = "Fly quicker steps, and log setpoints and rates faster."
    remedy = "Check that the setpoints are those of this vehicle, and their time stamps."
    return [
        *wide_lag_reasons(half_width, LAG_HALF_WIDTH_S, whose="actuators'", remedy=quicker),
        *longest_lag_reasons(strength, remedy=remedy),
    ]


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


# -- Wording --

EQUATION = (
    "p' = G_p u_p - D_p p + b; q' alike; r' = G_r u_r + J u_r' - D_r r + b; z'' + g = G_z u_z - K z' + b",
    "(p, q, r) body rates; tau u' + u = torque setpoint(t - d), one lag for all axes",
)
_SUBSCRIPT = {ROLL: "p", PITCH: "q", YAW: "r"}


def _of_axis(axis: Axis) -> dict[str, Wording]:
    subscript, optional = _SUBSCRIPT[axis], axis.reacts
    results = {
        axis.effectiveness.name: Wording(
            f"{axis.name} effectiveness", f"G_{subscript}", "rad/s^2", shown_unit="rad/s²", optional=optional
        ),
        axis.damping.name: Wording(
            f"{axis.name} damping", f"D_{subscript}", "1/s", shown_unit="1/s", optional=optional
        ),
    }
    if axis.reacts:
        results[axis.reaction.name] = Wording(
            f"{axis.name} reaction", "J", "rad/s", shown_unit="rad/s", optional=optional
        )
    return results


#: Every quantity, in the order of results.
QUANTITIES = {
    **{name: wording for axis in AXES for name, wording in _of_axis(axis).items()},
    THRUST.called: Wording("thrust gain", "G_z", "m/s^2", shown_unit="m/s²", optional=True),
    **LAG_WORDINGS,
}
#: The same in the order of reports.
PLOTTED = (
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
        Status.IDENTIFIED: "the effectiveness of roll and pitch is identified, within its intervals.",
        Status.WEAK: "the numbers are indications; something keeps the intervals from being trusted.",
        Status.PROVISIONAL: "no instrument: least squares has the effectiveness too small, the lag too long.",
        Status.REFUSED: "the flight does not identify the effectiveness of roll and pitch.",
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
