"""Axes, systematic parts and verdict of the turning rates."""

from __future__ import annotations

from dataclasses import dataclass, replace

from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_QUANTITIES
from eivor.flights.quantity import (
    CardSection,
    Counts,
    CoupledAxis,
    QuantitySpec,
    QuantityTable,
    Words,
)
from eivor.flights.references import ReferenceSource
from eivor.flights.verdict import (
    FlightWords,
    Limit,
    Rule,
    SystematicPart,
    VerdictInputs,
    clock_part,
    disagreement_part,
    flight_rules,
    longest_lag_rule,
)
from eivor.inference.verdict import Status
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
LAGS = (ACTUATOR_LAG.name, EFFECTIVE_LAG)


def _by_rotors(inputs: VerdictInputs, name: str) -> tuple[float, float]:
    size = ROTOR_SHARE * abs(inputs.quantities[name].value)
    return size, size


PARTS = (
    disagreement_part(
        (*LAGS, *(item.name for axis in AXES for item in (axis.effectiveness, axis.damping, axis.reaction)))
    ),
    clock_part(LAGS),
    SystematicPart(
        LAGS, Counts.ADDED, lambda *_: (ROTOR_LAG_S, ROTOR_LAG_S), lambda _: f"{ROTORS}lag by 1 ms."
    ),
    SystematicPart(
        tuple(axis.effectiveness.name for axis in AXES),
        Counts.ADDED,
        _by_rotors,
        lambda _: f"{ROTORS}effectiveness by 2 %.",
    ),
)

# -- Rule --

FLY = (
    "Fly quick steps of roll and pitch of about 15 degrees to both sides for 60 s, in a mode in which the "
    "sticks set the attitude."
)
TURN_LONGER = "Fly turns that last longer."
QUICKER = "Fly quicker steps, and log setpoints and rates faster."
COMMAND_RATE_HZ, LEAST_S = 45.0, 15.0
FLIGHT_WORDS = FlightWords(
    fly=FLY,
    log_reference="Log the attitude setpoint, or the pilot's roll and pitch sticks, at 20 Hz or more.",
    log_planned="Fly in a mode in which the sticks set the attitude, or inject a sweep.",
    moves="turns",
    undisturbed="Fly slowly and away from walls and ground; keep the motors from their limits.",
)
EFFECTIVENESS = Limit(0.1, 0.25, zero=Status.REFUSED, narrower="Fly larger and quicker steps, or longer.")
DAMPING = Limit(0.5, zero=Status.WEAK, narrower=TURN_LONGER)
LAG = Limit(0.25, 0.5, 0.02, 0.02, narrower=QUICKER)


def axis_rules(axis: Axis) -> tuple[Rule, ...]:
    """Rows of the quantities of an axis."""
    effect, damping, reaction = axis.effectiveness.name, axis.damping.name, axis.reaction.name
    shown, turns = QUANTITIES[effect], QUANTITIES[damping]
    return (
        *flight_rules(FLIGHT_WORDS, (effect,), (effect, ACTUATOR_LAG.name), effect),
        *flight_rules(FLIGHT_WORDS, (damping,), (effect, damping, ACTUATOR_LAG.name), damping),
        *flight_rules(FLIGHT_WORDS, (reaction,), (effect, reaction, ACTUATOR_LAG.name), reaction),
        Rule(
            (effect,),
            lambda inputs: inputs.quantities[effect].interval[1] < 0.0,
            Status.REFUSED,
            lambda inputs: (
                f"The {shown.words} came out at {inputs.quantities[effect].value:.3g} rad/s^2, below zero: "
                f"setpoint and rate of {axis.name} have opposite signs."
            ),
            f"Check the axes and signs of {axis.torque} and {axis.rate}.",
        ),
        Rule(
            (damping,),
            lambda inputs: inputs.quantities[damping].interval[1] < 0.0,
            Status.WEAK,
            lambda inputs: (
                f"The {turns.words} came out at {inputs.quantities[damping].value:.3g} 1/s, below zero: a "
                "torque of the air moved with the references."
            ),
            "Fly in calm air.",
        ),
        *EFFECTIVENESS.rules(effect, shown),
        *DAMPING.rules(damping, turns),
    )


#: Columns of turning are known to their published widths within these only.
_RECORD = (
    Rule(
        (),
        lambda inputs: inputs.command_rate_hz < COMMAND_RATE_HZ,
        Status.WEAK,
        lambda inputs: (
            f"The torque setpoints are logged at {inputs.command_rate_hz:.0f} Hz; below "
            f"{COMMAND_RATE_HZ:.0f} Hz the intervals do not hold."
        ),
        "Log them at 50 Hz or more.",
    ),
    Rule(
        (),
        lambda inputs: inputs.used_s < LEAST_S,
        Status.WEAK,
        lambda inputs: f"Only {inputs.used_s:.3g} s could be used; {LEAST_S:.0f} s are needed.",
        "Fly longer, or pool several flights.",
    ),
)

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
#: When a sentence speaks against quantities.
RULES = (
    *_RECORD,
    *flight_rules(FLIGHT_WORDS, (*LAGS, DELAY.name), (ACTUATOR_LAG.name,), EFFECTIVE_LAG),
    longest_lag_rule((), "Check that the setpoints are those of this vehicle, and their time stamps."),
    *LAG.rules(EFFECTIVE_LAG, QUANTITIES[EFFECTIVE_LAG], ACTUATOR_LAG.name, DELAY.name),
    *(rule for axis in AXES for rule in axis_rules(axis)),
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
