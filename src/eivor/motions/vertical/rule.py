"""The rule that turns an estimate into verdicts, one ground at a time.

On the viscous friction K, which is the overall verdict:

* refused: the accelerometer feels a gravity that is off by more than 3 m/s^2, so that it is in another unit
  (gain, hover input and lag as well); no reference varies, K cannot be told from zero (K <= 0, or an interval
  that reaches zero), the input gain is not positive, or a conditional first-stage F is below 10 and K has no
  bounded set that holds however weak the instruments are;
* provisional: no exogenous reference, so that a direct method had to serve;
* identified: every first-stage F 10 or more, K's half-width <= K/2 with what is reserved for an estimator
  (and a lower end above that), the lag's <= 0.1 s, the lag below the
  top of its grid, J's p-value >= .001 (of a pool that of half its flights), the command logged
  at 45 Hz or more, 25 s of flight or more, instruments that contain no feedback, and an intercept that is
  not clearly beyond 5 m/s^2;
* weak otherwise.

Velocity and accelerometer that disagree make weak what their disagreement harms, see `sensors`: an offset the
lag and the gain, a scale gain and friction, a tilt the friction, anything else all three.

The gain, the hover input and the lag have verdicts of their own. Gain and hover input are weak where the
intercept is clearly beyond 0.4 m/s^2: thrust then grows with another power of the command than the input map
says. With m the map's own exponent at hover, d ln U / d ln w, and hover balanced by g = K_u U_h + b, thrust
goes as w^p with p = m K_u U_h / g = m (1 - b / g).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.flights.grounds import (
    disagreement_reasons,
    given_lag_reasons,
    instrument_reasons,
    longest_lag_reasons,
    moved,
    roughly_known,
    untold,
)
from eivor.flights.motion import Circumstances, Strength
from eivor.flights.quantity import Unjudged
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.verdict import Reason, Status
from eivor.models.equation import Parameter
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.motions.vertical.curve_rule import CLEAR_INTERCEPT, curve_reasons
from eivor.motions.vertical.height import near_ground_reasons
from eivor.motions.vertical.left_out import left_out_sentence, missed
from eivor.motions.vertical.model import GRAVITY
from eivor.motions.vertical.sensors import OFFSET, SCALE, TILTS, either_sentence, sentence
from eivor.motions.vertical.terms import GROUND, SUPPLY, TERMS

FRICTION_SHARE = 0.5
GAIN_SHARE = 0.1
HOVER_SHARE = 0.05
LAG_HALF_WIDTH_S = 0.1
LAG_SHARE = 0.5
LAG_KNOWN_S = 0.01
COMMAND_RATE_HZ = 45.0
#: In simulated flights of 15 and 20 s the friction's interval held it in .81 and .85, of 25 s in .93 [s].
SHORT_FLIGHT_S = 25.0
GAIN_RATE_HZ = 20.0
LEAST_EXPONENT = 0.95
LARGE_INTERCEPT = 5.0
#: An accelerometer that feels a gravity so far off is in another unit [m/s^2].
OTHER_UNIT = 3.0

#: Numbers of this motion among those of the circumstances: the exponent of thrust near hover, that of the
#: input map there, and one for a command of thrust, whose map is linear or mixed.
LEAST_INTERCEPT = "least_intercept"
THRUST_EXPONENT, MAP_EXPONENT, IS_THRUST = "thrust_exponent", "map_exponent", "thrust_command"
#: Root mean square of the horizontal speed [m/s]; from where on a tilt between attitude and accelerometer
#: matters, and how well it must be known [rad].
SIDEWAYS = "sideways_speed"
FAST_SIDEWAYS = 3.0
TILT_KNOWN = float(np.deg2rad(1.5))
#: Terms that harm the gain when they are missed, and what to do.
LEFT_OUT = {
    SUPPLY: "Log battery_voltage, start with a full battery, or identify a part of the flight with --window.",
    GROUND: "Fly higher over the ground, four radii of a rotor and more.",
}
#: And the mean of the specific force where the vehicle does not accelerate [m/s^2].
APPARENT_GRAVITY = "apparent_gravity"

FLY = (
    "Fly vertical position steps or a sine sweep of about 2 m/s and 2 m for 60 s in position mode, calm air."
)
QUICKER = "Fly quicker steps, and log command and acceleration at 50 Hz or more."
LOG_REFERENCE = "Log the position setpoint, or the pilot's stick, at 50 Hz or more."
ALIGN = (
    "Correct the time stamps, the filter or the scale of the one that is wrong, or align them with --align."
)
LEVEL = (
    "Check the attitude and the accelerometer's mounting, and calibrate both; or fly without sideways motion."
)
LOG_PLANNED = "Log the trajectory's position setpoint."


def all_grounds(
    quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
) -> dict[str, tuple[Reason, ...]]:
    """Grounds against every quantity; those that one parameter decides share its grounds."""
    shared = (*given_lag_reasons(at), *unit_of_force_reasons(at))
    friction = (
        *friction_reasons(quantities, strength, at),
        *sensor_reasons(at, SCALE, *TILTS.values()),
        *sideways_reasons(at),
        *shared,
    )
    curve = tuple(thrust_curve_reasons(quantities, at))
    gain = (
        *gain_reasons(quantities["input_gain"], strength, at),
        *curve,
        *sensor_reasons(at, OFFSET, SCALE),
        *left_out_reasons(at),
        *near_ground_reasons(at),
        *fast_sideways_reasons(at),
        *shared,
    )
    lag = (*lag_reasons(quantities, strength, at), *sensor_reasons(at, OFFSET), *shared)
    found = (*curve_reasons(quantities, at), *sensor_reasons(at, OFFSET, SCALE), *shared)
    return {
        "viscous_friction": friction,
        "time_constant": friction,
        "input_gain": gain,
        "intercept": gain,
        "hover_input": (
            *hover_reasons(quantities["hover_input"], at),
            *curve,
            *near_ground_reasons(at),
            *unit_of_force_reasons(at),
        ),
        "actuator_lag": lag,
        "delay": (*lag, *delay_reasons(quantities["delay"])),
        "effective_lag": lag,
        "thrust_curve": found,
        **{
            parameter.name: tuple(term_reasons(quantities[parameter.name], parameter, strength, at))
            for parameter in (term.parameter for term in TERMS.values())
            if parameter.name in quantities
        },
    }


def friction_reasons(
    quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
) -> list[Reason]:
    """Grounds against the viscous friction."""
    reasons = instrument_reasons(
        strength,
        at,
        fly=FLY,
        log_reference=LOG_REFERENCE,
        log_planned=LOG_PLANNED,
    )
    if not untold("viscous_friction", strength):
        reasons.extend(_interval_reasons(quantities["viscous_friction"], at))
    reasons.extend(_rough_lag_reasons(quantities, strength))
    reasons.extend(_unit_reasons(quantities))
    remedy = "Keep the tilt small, stay off the ground, and check the input map."
    reasons += disagreement_reasons(strength, moves="moves", remedy=remedy)
    if at.command_rate_hz < COMMAND_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The command is logged at {at.command_rate_hz:.0f} Hz; below {COMMAND_RATE_HZ:.0f} Hz the "
                "intervals do not hold.",
                "Log the thrust setpoint or the rotor commands at 50 Hz or more.",
            )
        )
    if at.used_s < SHORT_FLIGHT_S:
        reasons.append(
            Reason(
                Status.WEAK,
                f"Only {at.used_s:.3g} s could be used: intervals of less than {SHORT_FLIGHT_S:.0f} s hold "
                "the friction too seldom.",
                "Fly longer, or pool several flights.",
            )
        )
    return reasons


def _interval_reasons(friction: Unjudged, at: Circumstances) -> list[Reason]:
    """Grounds against the viscous friction that its interval gives."""
    reasons = []
    low, high = friction.interval
    if high < 0.0:
        reasons.append(
            Reason(
                Status.REFUSED,
                f"The viscous friction came out at {friction.value:.3g} 1/s, which no vehicle has: the air "
                f"or a feedback moved the vehicle more than the reference did.{moved(at)}",
                FLY,
            )
        )
    elif friction.value <= 0.0 or low <= 0.0:
        reasons.append(
            Reason(
                Status.REFUSED,
                f"The viscous friction cannot be told from zero: its interval is [{low:.2g}, {high:.2g}] "
                f"1/s.{moved(at)}",
                FLY,
            )
        )
    elif np.inf > friction.half_width + friction.reserved > FRICTION_SHARE * friction.value:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The viscous friction's interval is +-{friction.half_width / friction.value:.1%} wide"
                f"{_reserve(friction)}; identified asks for +-{FRICTION_SHARE:.0%}.{moved(at)}",
                "Fly longer, faster climbs and descents, or pool several flights.",
            )
        )
    elif low <= friction.reserved and friction.reserved > 0.0:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The viscous friction's interval begins at {low:.2g} 1/s, and up to "
                f"{friction.reserved:.2g} 1/s cannot be told from an estimator's own dynamics.",
                "Fly longer, faster climbs and descents, or log a velocity that is measured.",
            )
        )
    return reasons


def _reserve(friction: Unjudged) -> str:
    """What identified asks for beside the interval, with words before it; empty for nothing."""
    if not friction.reserved:
        return ""
    return f", and the estimator behind velocity or acceleration may add {friction.reserved:.2g} 1/s"


def _unit_reasons(quantities: Mapping[str, Unjudged]) -> list[Reason]:
    """Grounds that speak of signs and units: a gain that pulls down, an intercept that no sensor has."""
    reasons = []
    if quantities["input_gain"].value <= 0.0:
        reasons.append(
            Reason(
                Status.REFUSED,
                "The input gain is not positive: the input, or the acceleration, has the wrong sign.",
                "Check the frame (z up, or NED), the input's sign and its map.",
            )
        )
    intercept = quantities.get("intercept")
    if intercept is not None and abs(intercept.value) - intercept.half_width > LARGE_INTERCEPT:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The intercept is {intercept.value:.1f} m/s^2, far beyond the bias of an accelerometer.",
                "Check the units and signs of velocity and acceleration, the clock, and the input map.",
            )
        )
    return reasons


def unit_of_force_reasons(at: Circumstances) -> list[Reason]:
    """Ground against everything: an accelerometer that feels another gravity is in another unit."""
    felt = at.numbers.get(APPARENT_GRAVITY, np.nan)
    if not abs(felt - GRAVITY) > OTHER_UNIT:
        return []
    unit = next((word for word, size in (("g", 1.0), ("milli-g", 1e3)) if 0.8 < felt / size < 1.25), "")
    sentence = (
        f"The accelerometer feels a gravity of {felt:.3g} m/s^2, where {GRAVITY:.2f} is expected"
        f"{f': its values look like {unit}' if unit else ''}."
    )
    return [Reason(Status.REFUSED, sentence, 'State its unit in a channel map (unit = "g"), and its axes.')]


def _rough_lag_reasons(quantities: Mapping[str, Unjudged], strength: Strength) -> list[Reason]:
    delay = strength.searched.get(DELAY.name)
    if delay is not None and abs(delay.value) >= 0.999 * delay.highest:
        return [
            Reason(
                Status.WEAK,
                f"The delay of the measured rotors ran into the end of its grid "
                f"({delay.highest * 1e3:.0f} ms).",
                "Check the clock of the rotors' telemetry, or use the commands with --input.",
            )
        ]
    lag = strength.searched.get(ACTUATOR_LAG.name)
    if lag is None:
        return []
    reasons = []
    half_width = quantities["effective_lag"].half_width
    if half_width > LAG_HALF_WIDTH_S:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The actuator's lag {roughly_known(half_width)}; "
                f"+-{LAG_HALF_WIDTH_S * 1e3:.0f} ms is needed.",
                QUICKER,
            )
        )
    remedy = "Check that the input is the command of this vehicle, and its time stamps."
    reasons += longest_lag_reasons(strength, remedy=remedy)
    return reasons


def sensor_reasons(at: Circumstances, *harmful: Parameter) -> list[Reason]:
    """Grounds against what some kinds of disagreement between velocity and accelerometer harm."""
    if at.sensors is None:
        return []
    corrected = {OFFSET.name, SCALE.name} if at.aligned else set()
    names = {one.name for one in harmful} - corrected
    reasons = [
        Reason(Status.WEAK, sentence(name, one), ALIGN if name in (OFFSET.name, SCALE.name) else LEVEL)
        for name, one in at.sensors.told.items()
        if name in names
    ]
    if names & at.sensors.either.keys():
        reasons.append(Reason(Status.WEAK, either_sentence(at.sensors), LEVEL))
    if at.sensors.otherwise:
        reasons.append(
            Reason(
                Status.WEAK,
                "Velocity and accelerometer disagree in another way than by an offset, a scale or a tilt "
                f"(p-value {at.sensors.p_value:.1g}).",
                LEVEL,
            )
        )
    return reasons


def left_out_reasons(at: Circumstances) -> list[Reason]:
    """Grounds against the gain: thrust that goes with the supply, or with the height over the ground."""
    reasons = []
    for name, remedy in LEFT_OUT.items():
        if missed(at.numbers, name):
            told = left_out_sentence(at.numbers, name)
            reasons.append(Reason(Status.WEAK, f"{told[0].upper()}{told[1:]}.", remedy))
    return reasons


def sideways_reasons(at: Circumstances) -> list[Reason]:
    """Ground against the friction: fast sideways flight, with an attitude that may lean."""
    speed = at.numbers.get(SIDEWAYS, np.nan)
    if not speed > FAST_SIDEWAYS:
        return []
    tilts = {tilt.name for tilt in TILTS.values()}
    known = {} if at.sensors is None else at.sensors.differences
    widths = [one.half_width for name, one in known.items() if name in tilts]
    if widths and max(widths) <= TILT_KNOWN:
        return []
    degrees = f"to ±{np.rad2deg(max(widths)):.1f} degrees only" if widths else "not at all"
    return [
        Reason(
            Status.WEAK,
            f"The vehicle flew sideways at {speed:.1f} m/s (rms), and the angle between attitude and "
            f"accelerometer is known {degrees}.",
            "Fly up and down without sideways motion, or sideways at other times than up and down.",
        )
    ]


def fast_sideways_reasons(at: Circumstances) -> list[Reason]:
    """Ground against the gain: air that crosses the rotors fast changes what they give."""
    speed = at.numbers.get(SIDEWAYS, np.nan)
    if not speed > FAST_SIDEWAYS:
        return []
    return [
        Reason(
            Status.WEAK,
            f"The vehicle flew sideways at {speed:.1f} m/s (rms): rotors give another thrust in air that "
            "crosses them, and the gain takes it up.",
            "Fly up and down without fast sideways motion.",
        )
    ]


def gain_reasons(gain: Unjudged, strength: Strength, at: Circumstances) -> list[Reason]:
    """Grounds against the input gain."""
    if gain.value <= 0.0:
        return [Reason(Status.REFUSED, "The input gain is not positive.", "Check the input's sign and map.")]
    reasons = []
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the input gain.", LOG_REFERENCE))
    if np.inf > gain.half_width > GAIN_SHARE * gain.value:
        sentence = (
            f"The input gain's interval is +-{gain.half_width / gain.value:.1%} wide; identified asks "
            f"for +-{GAIN_SHARE:.0%}."
        )
        first_stage = strength.first_stage.get("input_gain", np.nan)
        if first_stage < STRONG_FIRST_STAGE:
            sentence += f" {_too_low('input gain', first_stage)}"
        reasons.append(
            Reason(
                Status.WEAK,
                f"{sentence}{moved(at)}",
                "Fly quicker and larger steps, which change the thrust more.",
            )
        )
    if at.response_rate_hz < GAIN_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"Velocity and acceleration are logged at {at.response_rate_hz:.0f} Hz at most.",
                "Log one of them at 20 Hz or more.",
            )
        )
    return reasons


def thrust_curve_reasons(quantities: Mapping[str, Unjudged], at: Circumstances) -> list[Reason]:
    """Grounds against gain and hover input: an intercept that says that the input map is another one."""
    intercept = quantities["intercept"]
    exponent = at.numbers.get(THRUST_EXPONENT, np.nan)
    least = at.numbers.get(LEAST_INTERCEPT, abs(intercept.value) - intercept.half_width)
    if not (least > CLEAR_INTERCEPT and np.isfinite(exponent)):
        return []
    told = (
        f"The intercept is {intercept.value:+.2g} m/s^2, which an input map that fits does not leave: near "
        f"hover thrust grows as the command to the power {exponent:.2f}, and the map says "
        f"{at.numbers[MAP_EXPONENT]:.2f}."
    )
    return [Reason(Status.WEAK, told, _fitting_map(exponent, quantities["hover_input"].value, at))]


def _fitting_map(exponent: float, hover: float, at: Circumstances) -> str:
    """The input map that has an exponent near hover."""
    if exponent < LEAST_EXPONENT:
        return (
            "No propeller's thrust grows so slowly: look for a supply that sags under load, and check that "
            "the input is the command of this vehicle."
        )
    if at.numbers[IS_THRUST] and 1.0 < exponent < 2.0 and 0.0 < hover < 1.0:
        # (1 - s) u + s u^2 has the exponent r at u_h for s = (r - 1) / ((r - 1) + (2 - r) u_h)
        share = (exponent - 1.0) / ((exponent - 1.0) + (2.0 - exponent) * hover)
        return f"Use --input-map mixed:{share:.2g} if nothing else is wrong; a sagging supply looks alike."
    known = {1.0: "linear", 2.0: "square"}.get(round(exponent, 1), f"power:{exponent:.2g}")
    return f"Use --input-map {known} if nothing else is wrong; a supply that sags under load looks alike."


def term_reasons(
    coefficient: Unjudged, parameter: Parameter, strength: Strength, at: Circumstances
) -> list[Reason]:
    """Grounds against the coefficient of an optional term."""
    words = parameter.name.replace("_", " ")
    reasons = []
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, f"A direct method made the {words}.", LOG_REFERENCE))
    first_stage = strength.first_stage.get(parameter.name, np.nan)
    if first_stage < STRONG_FIRST_STAGE:
        reasons.append(Reason(Status.WEAK, _too_low(words, first_stage), FLY))
    low, high = coefficient.interval
    if low <= 0.0 <= high:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The {words} cannot be told from zero: its interval is [{low:.2g}, {high:.2g}]"
                f"{f' {parameter.unit}' if parameter.unit else ''}.",
                "Leave the term out, and what remains is told more closely; or fly so that it shows.",
            )
        )
    return [*reasons, *given_lag_reasons(at), *unit_of_force_reasons(at)]


def hover_reasons(hover: Unjudged, at: Circumstances) -> list[Reason]:
    """Grounds against the hover input."""
    if not (np.isfinite(hover.value) and hover.value > 0.0):
        return [Reason(Status.REFUSED, "The hover input is not positive.", "Check the input's sign and map.")]
    reasons = []
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the hover input.", LOG_REFERENCE))
    if hover.half_width != np.inf and not hover.half_width <= HOVER_SHARE * hover.value:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The hover input's interval is +-{hover.half_width / hover.value:.1%} wide; identified asks "
                f"for +-{HOVER_SHARE:.0%}.",
                "Fly longer, and come to rest between the climbs.",
            )
        )
    return reasons


def lag_reasons(quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances) -> list[Reason]:
    """Grounds against the actuator's lag: those that count against the friction, and a rough lag."""
    reasons = _rough_lag_reasons(quantities, strength)
    lag = quantities["effective_lag"]
    if np.inf > lag.half_width > max(lag.value, LAG_HALF_WIDTH_S):
        low, high = (1e3 * end for end in lag.interval)
        sentence = f"The lag may be anything from {low:.0f} to {high:.0f} ms."
        reasons.append(Reason(Status.REFUSED, sentence, QUICKER))
    elif np.inf > lag.half_width > max(LAG_SHARE * lag.value, LAG_KNOWN_S):
        sentence = f"The lag's interval is +-{lag.half_width * 1e3:.0f} ms wide."
        reasons.append(Reason(Status.WEAK, sentence, QUICKER))
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the lag.", LOG_REFERENCE))
    for name in {ACTUATOR_LAG.name, DELAY.name} & strength.first_stage.keys() if not at.direct else ():
        first_stage = strength.first_stage[name]
        if first_stage < STRONG_FIRST_STAGE:
            sentence = _too_low("lag", first_stage)
            reasons.append(Reason(Status.WEAK, sentence, QUICKER))
    return reasons


def delay_reasons(delay: Unjudged) -> list[Reason]:
    """Grounds against the delay beside those against the lag: that none of those tried can be left out."""
    if (
        delay.choice is None
        or len(delay.choice.tried) < 2
        or len(delay.choice.fitting) < len(delay.choice.tried)
    ):
        return []
    return [Reason(Status.WEAK, "Every delay that was tried fits.", QUICKER)]


def _too_low(name: str, first_stage: float) -> str:
    return f"First-stage F of the {name} is {first_stage:.1f}, and {STRONG_FIRST_STAGE:.0f} is needed."
