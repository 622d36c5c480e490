"""Systematic parts and verdict of the vertical motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from eivor.flights.lag_prior import EFFECTIVE_LAG
from eivor.flights.motion import InstrumentStrength, VerdictInputs
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import (
    Counts,
    Quantity,
    QuantityEstimate,
    SystematicUncertainty,
    clock_uncertainty,
)
from eivor.flights.verdict import (
    disagreement_reasons,
    has_no_bounds,
    instrument_reasons,
    lag_prior_reasons,
    longest_lag_reasons,
    moved,
    provisional,
    refused,
    weak,
    weak_instrument_sentence,
    wide_lag_reasons,
)
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.verdict import Reason, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, FURTHEST_DELAY_S
from eivor.models.regression import Parameter
from eivor.motions.vertical.misspecification import (
    CURVATURE,
    OFFSET,
    OTHER_UNIT_TIMES,
    PREFIX,
    SCALE,
    TILTS,
    VOLTAGE_CHANGE,
    either_sentence,
    missed,
    omitted_variable_sentence,
    sensor_uncertainties,
    sentence,
    velocity_over_accelerometer,
)
from eivor.motions.vertical.model import GRAVITY
from eivor.motions.vertical.regression import GROUND, SUPPLY, TERMS, ground_height, height_over_ground
from eivor.motions.vertical.select import FLY, LOG_REFERENCE, QUICKER
from eivor.signals.channels import CurveSide
from eivor.signals.recording import Channel, Finding
from eivor.tools import Bool, Float

# -- Systematic parts --

#: No interval of the hover input reaches less far than this share of it.
HOVER_FLOOR = 0.005
#: Friction that an estimator's own dynamics may look like [1/s].
ESTIMATOR_FRICTION = 0.03


def all_systematic_uncertainties(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, QuantityEstimate], inputs: VerdictInputs
) -> dict[str, tuple[SystematicUncertainty, ...]]:
    """Systematic parts by quantity."""
    by_clock = clock_uncertainty(max(flight.command_slack_s for flight in flights))
    of_sensors = sensor_uncertainties(inputs.sensors, quantities, aligned=inputs.aligned)
    parts: dict[str, list[SystematicUncertainty]] = {name: [] for name in quantities}
    roles = sorted({role for flight in flights for role in flight.estimated})
    if roles:
        sentence = (
            f"{' and '.join(roles).capitalize()} from an estimator: its own dynamics can look like a "
            f"friction of up to {ESTIMATOR_FRICTION:g} 1/s; identified keeps as much in reserve."
        )
        reserve = SystematicUncertainty(Counts.RESERVED, ESTIMATOR_FRICTION, ESTIMATOR_FRICTION, sentence)
        parts["viscous_friction"].append(reserve)
    floor = HOVER_FLOOR * quantities["hover_input"].value
    if math.isfinite(floor) and floor > 0.0:
        sentence = (
            f"Valid for this flight's conditions (wind, height, speed, battery): the interval is at least "
            f"±{HOVER_FLOOR:.1%} wide."
        )
        parts["hover_input"].append(SystematicUncertainty(Counts.AT_LEAST, floor, floor, sentence))
    for name in (ACTUATOR_LAG.name, EFFECTIVE_LAG):
        parts[name].extend(by_clock)
    parts = {name: [*part, *of_sensors.get(name, ())] for name, part in parts.items()}
    return {name: tuple(part) for name, part in parts.items() if part}


# -- Curve rule --

CURVE_HALF_WIDTH = 0.15
UNTOLD_HALF_WIDTH = 0.5
#: An intercept clearly beyond it is no bias of an accelerometer [m/s^2].
CLEAR_INTERCEPT = 0.4

LARGER_STEPS = "Fly quicker and larger steps, which change the thrust more."
CHECK_INPUT = "Check units and signs, and that the input is the command of this vehicle."
BIAS = "Say how large the accelerometer's bias may be: --accelerometer-bias 0.1 (m/s^2)."


def curve_reasons(quantities: Mapping[str, QuantityEstimate], inputs: VerdictInputs) -> Iterator[Reason]:
    """Reasons against the curve; none where it was not asked for."""
    curve, intercept = quantities.get("thrust_curve"), quantities["intercept"]
    if curve is None:
        return
    left = abs(intercept.value) - intercept.half_width
    if not np.isfinite(curve.half_width):
        unknown = (
            "Curvature alone does not identify the thrust curve, and the intercept cannot while nothing is "
            "known of the accelerometer's bias."
        )
        yield refused(unknown, BIAS)
    elif np.isfinite(left) and left > CLEAR_INTERCEPT:
        none = (
            f"No thrust curve of this kind fits: the intercept is still {intercept.value:+.2g} m/s^2 with "
            "the one that comes nearest."
        )
        yield refused(none, CHECK_INPUT)
    elif curve.half_width > UNTOLD_HALF_WIDTH:
        wide = (
            f"The thrust curve is known to +-{curve.half_width:.2g} only, which leaves every curve possible."
        )
        yield refused(wide, LARGER_STEPS)
    else:
        if inputs.direct:
            yield provisional("A direct method made the thrust curve.", "Log the position setpoint.")
        if curve.half_width > CURVE_HALF_WIDTH:
            rough = f"The thrust curve is known to +-{curve.half_width:.3g}; identified asks for "
            yield weak(f"{rough}+-{CURVE_HALF_WIDTH:.2g}.", LARGER_STEPS)


# -- Lag rule --

LAG_HALF_WIDTH_S = 0.1
LAG_SHARE = 0.5
LAG_KNOWN_S = 0.01


def lag_reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength, inputs: VerdictInputs
) -> Iterator[Reason]:
    """Reasons against the actuator's lag: those that count against the friction, and a rough lag."""
    yield from rough_lag_reasons(quantities, strength)
    lag = quantities[EFFECTIVE_LAG]
    if np.inf > lag.half_width > max(lag.value, LAG_HALF_WIDTH_S):
        low, high = (1e3 * max(end, 0.0) for end in lag.interval)
        yield refused(f"The lag may be anything from {low:.0f} to {high:.0f} ms.", QUICKER)
    elif np.inf > lag.half_width > max(LAG_SHARE * lag.value, LAG_KNOWN_S):
        yield weak(f"The lag's interval is +-{lag.half_width * 1e3:.0f} ms wide.", QUICKER)
    if inputs.direct:
        yield provisional("A direct method made the lag.", LOG_REFERENCE)
        return
    for name in {ACTUATOR_LAG.name, DELAY.name} & strength.first_stage.keys():
        if strength.first_stage[name] < STRONG_FIRST_STAGE:
            yield weak(weak_instrument_sentence("lag", strength.first_stage[name]), QUICKER)


def rough_lag_reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength
) -> Iterator[Reason]:
    """Reasons that count against the friction as well: a lag that is hardly known, grids that end."""
    delay = strength.searched.get(DELAY.name)
    if delay is not None and abs(delay.value) >= 0.999 * delay.highest:
        end = f"The delay of the measured rotors ran into the end of its grid ({delay.highest * 1e3:.0f} ms)."
        yield weak(end, "Check the clock of the rotors' telemetry, or use the commands with --input.")
    elif ACTUATOR_LAG.name in strength.searched:
        half_width, tried = quantities[EFFECTIVE_LAG].half_width, quantities[DELAY.name]
        remedy = "Check that the input is the command of this vehicle, and its time stamps."
        yield from wide_lag_reasons(half_width, LAG_HALF_WIDTH_S, whose="actuator's", remedy=QUICKER)
        yield from longest_lag_reasons(strength, remedy=remedy)
        if tried.choice is not None and tried.value >= 0.999 * FURTHEST_DELAY_S:
            yield weak(f"The delay ran into the top of its grid ({FURTHEST_DELAY_S:.1f} s).", remedy)


def delay_reasons(delay: QuantityEstimate) -> Iterator[Reason]:
    """Reasons against the delay beside those against the lag: that none of those tried can be left out."""
    if delay.choice is not None and len(delay.choice.fitting) >= len(delay.choice.tried) >= 2:
        yield weak("Every delay that was tried fits.", QUICKER)


# -- Friction rule --

FRICTION_SHARE = 0.5
COMMAND_RATE_HZ = 45.0
#: In simulated flights of 15 and 20 s the friction's interval held it in .81 and .85, of 25 s in .93 [s].
SHORT_FLIGHT_S = 25.0
LARGE_INTERCEPT = 5.0
LOG_PLANNED = "Log the trajectory's position setpoint."


def friction_reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength, inputs: VerdictInputs
) -> Iterator[Reason]:
    """Reasons against the viscous friction."""
    yield from instrument_reasons(
        strength, inputs, fly=FLY, log_reference=LOG_REFERENCE, log_planned=LOG_PLANNED
    )
    if not has_no_bounds("viscous_friction", strength):
        yield from _interval_reasons(quantities["viscous_friction"], inputs)
    yield from rough_lag_reasons(quantities, strength)
    if quantities["input_gain"].value <= 0.0:
        yield refused(
            "The input gain is not positive: the input, or the acceleration, has the wrong sign.",
            "Check the frame (z up, or NED), the input's sign and its map.",
        )
    intercept = quantities.get("intercept")
    if intercept is not None and abs(intercept.value) - intercept.half_width > LARGE_INTERCEPT:
        yield weak(
            f"The intercept is {intercept.value:.1f} m/s^2, far beyond the bias of an accelerometer.",
            "Check the units and signs of velocity and acceleration, the clock, and the input map.",
        )
    remedy = "Keep the tilt small, stay off the ground, and check the input map."
    yield from disagreement_reasons(strength, moves="moves", remedy=remedy)
    if inputs.command_rate_hz < COMMAND_RATE_HZ:
        yield weak(
            f"The command is logged at {inputs.command_rate_hz:.0f} Hz; below {COMMAND_RATE_HZ:.0f} Hz the "
            "intervals do not hold.",
            "Log the thrust setpoint or the rotor commands at 50 Hz or more.",
        )
    if inputs.used_s < SHORT_FLIGHT_S:
        yield weak(
            f"Only {inputs.used_s:.3g} s could be used: intervals of less than {SHORT_FLIGHT_S:.0f} s hold "
            "the friction too seldom.",
            "Fly longer, or pool several flights.",
        )


def _interval_reasons(friction: QuantityEstimate, inputs: VerdictInputs) -> Iterator[Reason]:
    """Reasons against the viscous friction that its interval gives."""
    low, high = friction.interval
    half_width, reserve = friction.half_width, friction.reserved_uncertainty
    if high < 0.0:
        yield refused(
            f"The viscous friction came out at {friction.value:.3g} 1/s, which no vehicle has: the air "
            f"or a feedback moved the vehicle more than the reference did.{moved(inputs)}",
            FLY,
        )
    elif friction.value <= 0.0 or low <= 0.0:
        yield refused(
            "The viscous friction cannot be distinguished from zero: its interval is "
            f"[{low:.2g}, {high:.2g}] 1/s.{moved(inputs)}",
            FLY,
        )
    elif np.inf > half_width + reserve > FRICTION_SHARE * friction.value:
        added = f", and the estimator behind velocity or acceleration may add {reserve:.2g} 1/s"
        yield weak(
            f"The viscous friction's interval is +-{half_width / friction.value:.1%} wide"
            f"{added if reserve else ''}; identified asks for +-{FRICTION_SHARE:.0%}.{moved(inputs)}",
            "Fly longer, faster climbs and descents, or pool several flights.",
        )
    elif low <= reserve and reserve > 0.0:
        yield weak(
            f"The viscous friction's interval begins at {low:.2g} 1/s, and up to {reserve:.2g} 1/s cannot be "
            "distinguished from an estimator's own dynamics.",
            "Fly longer, faster climbs and descents, or log a velocity that is measured.",
        )


# -- Gain rule --

GAIN_SHARE = 0.1
HOVER_SHARE = 0.05
GAIN_RATE_HZ = 20.0
CHECK_SIGN = "Check the input's sign and map."
#: Terms that harm the gain when they are missed, and what to do.
OMITTED = {
    SUPPLY: "Log battery_voltage, start with a full battery, or identify a part of the flight with --window.",
    GROUND: "Fly higher over the ground, four radii of a rotor and more.",
}
#: The same for the supply whose voltage is logged.
WITH_VOLTAGE = "Add the term with --term voltage, or identify a part of the flight with --window."


def gain_reasons(
    gain: QuantityEstimate, strength: InstrumentStrength, inputs: VerdictInputs
) -> Iterator[Reason]:
    """Reasons against the input gain."""
    if gain.value <= 0.0:
        yield refused("The input gain is not positive.", CHECK_SIGN)
        return
    if np.inf > gain.half_width and gain.interval[0] <= 0.0:
        low, high = (f"{end:.3g}" for end in gain.interval)
        sentence = f"The input gain cannot be distinguished from zero: its interval is [{low}, {high}] m/s^2."
        yield refused(f"{sentence}{moved(inputs)}", LARGER_STEPS)
        return
    if inputs.direct:
        yield provisional("A direct method made the input gain.", LOG_REFERENCE)
    if np.inf > gain.half_width > GAIN_SHARE * gain.value:
        width = f"The input gain's interval is +-{gain.half_width / gain.value:.1%} wide"
        sentence = f"{width}; identified asks for +-{GAIN_SHARE:.0%}."
        first_stage = strength.first_stage.get("input_gain", np.nan)
        if first_stage < STRONG_FIRST_STAGE:
            sentence += f" {weak_instrument_sentence('input gain', first_stage)}"
        yield weak(f"{sentence}{moved(inputs)}", LARGER_STEPS)
    if inputs.response_rate_hz < GAIN_RATE_HZ:
        slow = f"Velocity and acceleration are logged at {inputs.response_rate_hz:.0f} Hz at most."
        yield weak(slow, "Log one of them at 20 Hz or more.")


def omitted_variable_reasons(inputs: VerdictInputs) -> Iterator[Reason]:
    """Reasons against the gain: thrust that goes with the supply, or with the height over the ground."""
    for name, remedy in OMITTED.items():
        if missed(inputs.numbers, name):
            sentence = omitted_variable_sentence(inputs.numbers, name)
            by_voltage = name == SUPPLY and VOLTAGE_CHANGE in inputs.numbers
            yield weak(f"{sentence[0].upper()}{sentence[1:]}.", WITH_VOLTAGE if by_voltage else remedy)


def hover_reasons(hover: QuantityEstimate, inputs: VerdictInputs) -> Iterator[Reason]:
    """Reasons against the hover input."""
    if not (np.isfinite(hover.value) and hover.value > 0.0):
        yield refused("The hover input is not positive.", CHECK_SIGN)
        return
    if inputs.direct:
        yield provisional("A direct method made the hover input.", LOG_REFERENCE)
    if hover.half_width != np.inf and not hover.half_width <= HOVER_SHARE * hover.value:
        width = f"The hover input's interval is +-{hover.half_width / hover.value:.1%} wide"
        remedy = "Fly longer, and come to rest between the climbs."
        yield weak(f"{width}; identified asks for +-{HOVER_SHARE:.0%}.", remedy)


# -- Height --

#: A flight is near the ground below so many radii, when it is there for this share of the time used.
NEAR_RADII, NEAR_SHARE = 4.0, 0.01
#: Numbers of this motion: the share of the time near the ground, and the lowest height in radii.
NEAR_GROUND, LOWEST = "near_ground_share", "lowest_radii"


def near_ground(
    flights: Sequence[PreparedFlight], radius: float | None, *, corrected: bool
) -> Mapping[str, float]:
    """Share of the time used that was near the ground, and the lowest height; of the lowest flight."""
    if radius is None or corrected:
        return {}
    shares, lowest = [], []
    for flight in flights:
        height = height_over_ground(flight)
        if height is not None and ground_height(flight) is not None:
            radii = height[flight.used] / radius
            shares.append(float(np.mean(radii < NEAR_RADII)))
            lowest.append(float(radii.min()))
    return {NEAR_GROUND: max(shares), LOWEST: min(lowest)} if shares else {}


def near_ground_reasons(inputs: VerdictInputs) -> Iterator[Reason]:
    """Reason against gain and hover input: a flight near the ground."""
    share = inputs.numbers.get(NEAR_GROUND, 0.0)
    if share >= NEAR_SHARE:
        yield weak(
            f"The vehicle flew below {NEAR_RADII:.0f} rotor radii over the ground for {share:.0%} of the "
            f"time ({inputs.numbers[LOWEST]:.1f} at the lowest): thrust grows there, and the gain takes it "
            "up.",
            "Fly higher, or add --term ground-effect.",
        )


# -- Hover --

#: Parameters in which an autopilot keeps its own idea of the hover input.
HOVER_PARAMETERS = ("MPC_THR_HOVER", "MOT_THST_HOVER")
#: A logged hover parameter that is off by more than this share is pointed out.
HOVER_DISAGREEMENT = 0.15

START, RANGE, ESTIMATE = "MPC_THR_HOVER", "HTE_THR_RANGE", "hover_thrust_estimate"
#: The ends that the range is cut to, lower and upper.
LOWER_END, UPPER_END = (0.0, 0.8), (0.2, 0.9)
#: An estimate so near to an end stands at it, and one so near to its start has not left it.
NEAR_END, NEAR_START = 0.01, 1e-3
#: So long after leaving its start it is still on its way [s].
ON_ITS_WAY_S = 2.0
#: An estimate stands at an end when it is there for this share of the time used.
AT_END_SHARE = 0.5


def hover_findings(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity]
) -> Iterator[Finding]:
    """What the autopilots of flights hold their hover input to be; compared where it is identified."""
    flying = [flight for flight in flights if flight.runs and _is_setpoint(flight)]
    for flight in flying:
        yield from _standing_at_an_end(flight)
    hover = quantities["hover_input"]
    if hover.verdict is not Status.IDENTIFIED or not np.isfinite(hover.value) or not flying:
        return
    for name in HOVER_PARAMETERS:
        value = flying[0].recording.parameters.get(name)
        if value and abs(hover.value / value - 1.0) > HOVER_DISAGREEMENT:
            sentence = f"The log's own {name} is {value:.3g}, but this vehicle hovered at {hover.value:.3g}."
            yield Finding("hover_parameter", sentence)
    values = np.concatenate([comparable_estimates(flight) for flight in flying])
    if values.size:
        median = float(np.median(values))
        off = hover.value / median - 1.0
        yield Finding(
            "hover_estimate",
            f"The autopilot's own estimate of the hover thrust is {median:.3g} (median of {values.size} "
            f"samples); this vehicle hovered at {hover.value:.3g}, {abs(off):.1%} "
            f"{'more' if off > 0.0 else 'less'}.",
        )


def _is_setpoint(flight: PreparedFlight) -> bool:
    """Whether the input is a thrust setpoint, which the autopilot's hover input is a value of."""
    unknown = flight.curve_side is CurveSide.UNKNOWN
    return flight.curve_side is CurveSide.BEFORE or (unknown and flight.input.name == "input")


def comparable_estimates(flight: PreparedFlight) -> Float[np.ndarray, " _"]:
    """Samples of the autopilot's estimate while the flight was used, that say something of the vehicle."""
    channel = flight.recording.channels.get(ESTIMATE)
    if channel is None:
        return np.empty(0)
    within = _within(flight, channel)
    for low, high, _ in _ends(flight):
        within &= ~((channel.values >= low) & (channel.values <= high))
    start = flight.recording.parameters.get(START)
    if start is not None:
        with np.errstate(invalid="ignore"):
            left = np.flatnonzero(np.abs(channel.values - start) > NEAR_START)
        since = channel.time_s[left[0]] if left.size else np.inf
        within &= channel.time_s >= since + ON_ITS_WAY_S
    return np.asarray(channel.values[within])


def _within(flight: PreparedFlight, channel: Channel) -> Bool[np.ndarray, " n"]:
    """Valid samples in the stretch of time that was used."""
    first, last = flight.span_s
    return np.isfinite(channel.values) & (channel.time_s >= first) & (channel.time_s <= last)


def _ends(flight: PreparedFlight) -> list[tuple[float, float, str]]:
    """Lowest and highest value that stands at each end of the estimate's range, and the end in words."""
    logged = flight.recording.parameters
    start, reach = logged.get(START), logged.get(RANGE)
    if start is None or reach is None:
        return []
    low, high = float(np.clip(start - reach, *LOWER_END)), float(np.clip(start + reach, *UPPER_END))
    return [
        (-np.inf, low + NEAR_END, f"lower limit, {low:.3g} ({START} - {RANGE})"),
        (high - NEAR_END, np.inf, f"upper limit, {high:.3g} ({START} + {RANGE})"),
    ]


def _standing_at_an_end(flight: PreparedFlight) -> Iterator[Finding]:
    channel = flight.recording.channels.get(ESTIMATE)
    values = np.empty(0) if channel is None else channel.values[_within(flight, channel)]
    for low, high, words in _ends(flight):
        if values.size and np.mean((values >= low) & (values <= high)) > AT_END_SHARE:
            sentence = f"The autopilot's own estimate of the hover thrust stood at its {words}"
            yield Finding("hover_estimate_at_limit", f"{sentence}: it is not compared.")


# -- Map rule --

LEAST_EXPONENT = 0.95
#: A map does not fit below this p-value.
FITS = 0.05
#: The bend is reported beside the intercept below this p-value.
BENDS = 0.1
#: Numbers of this motion among those of the circumstances: the least intercept in its set, the p-value of
#: the test that the map fits, the exponent of thrust near hover, that of the input map there, and one for a
#: command of thrust: a linear or mixed map.
LEAST_INTERCEPT, MAP_P_VALUE = "least_intercept", "input_map_p_value"
THRUST_EXPONENT, MAP_EXPONENT, IS_THRUST = "thrust_exponent", "map_exponent", "thrust_command"


def thrust_curve_reasons(
    quantities: Mapping[str, QuantityEstimate], inputs: VerdictInputs
) -> Iterator[Reason]:
    """Reasons against the gain: intercept and bend that say that the input map is another one."""
    intercept, exponent = quantities["intercept"], inputs.numbers.get(THRUST_EXPONENT, np.nan)
    if inputs.numbers.get(MAP_P_VALUE, 1.0) < FITS and np.isfinite(exponent):
        yield weak(
            f"The intercept is {intercept.value:+.2g} m/s^2, which an input map that fits does not leave: "
            f"near hover thrust grows as the command to the power {exponent:.2f}, and the map says "
            f"{inputs.numbers[MAP_EXPONENT]:.2f}.{_bend(intercept, inputs)}",
            _fitting_map(exponent, quantities["hover_input"].value, inputs),
        )


def intercept_reasons(quantities: Mapping[str, QuantityEstimate], inputs: VerdictInputs) -> Iterator[Reason]:
    """Reasons against the hover input: the same, of an intercept that is clear without the bend."""
    intercept = quantities["intercept"]
    if inputs.numbers.get(LEAST_INTERCEPT, abs(intercept.value) - intercept.half_width) > CLEAR_INTERCEPT:
        yield from thrust_curve_reasons(quantities, inputs)


def _bend(intercept: QuantityEstimate, inputs: VerdictInputs) -> str:
    """What the bend of the thrust curve adds to that, with a blank before it; empty for nothing."""
    name = f"{PREFIX}{CURVATURE}"
    bend, half = inputs.numbers.get(name, np.nan), inputs.numbers.get(f"{name}_half_width", np.nan)
    if not (inputs.numbers.get(f"{name}_p_value", 1.0) < BENDS and bend * intercept.value < 0.0):
        return ""
    of_power, uncertain = -intercept.value / (2.0 * GRAVITY), intercept.half_width / (2.0 * GRAVITY)
    text = f" The curve bends as well ({bend:+.2g} ± {half:.2g})"
    if bend + half < of_power - uncertain:
        return f"{text}, more than such a power does ({of_power:+.2g}): so does thrust that sags under load."
    return f"{text}."


def _fitting_map(exponent: float, hover: float, inputs: VerdictInputs) -> str:
    if exponent < LEAST_EXPONENT:
        return (
            "No propeller's thrust grows so slowly: look for a supply that sags under load, and check that "
            "the input is the command of this vehicle."
        )
    if inputs.numbers[IS_THRUST] and 1.0 < exponent < 2.0 and 0.0 < hover < 1.0:
        # (1 - s) u + s u^2 has the exponent r at u_h for s = (r - 1) / ((r - 1) + (2 - r) u_h)
        share = (exponent - 1.0) / ((exponent - 1.0) + (2.0 - exponent) * hover)
        return f"Use --input-map mixed:{share:.2g} if nothing else is wrong; a sagging supply looks alike."
    known = {1.0: "linear", 2.0: "square"}.get(round(exponent, 1), f"power:{exponent:.2g}")
    return f"Use --input-map {known} if nothing else is wrong; a supply that sags under load looks alike."


# -- Sensor rule --

#: An accelerometer that feels a gravity so far off is in another unit [m/s^2].
OTHER_UNIT = 3.0
#: And the mean of the specific force where the vehicle does not accelerate [m/s^2].
APPARENT_GRAVITY = "apparent_gravity"
ALIGN = (
    "Correct the time stamps, the filter or the scale of the one that is wrong, or align them with --align."
)
LEVEL = (
    "Check the attitude and the accelerometer's mounting, and calibrate both; or fly without sideways motion."
)


def unit_reasons(inputs: VerdictInputs) -> Iterator[Reason]:
    """Reasons against everything: sensors in another unit, or of another sign."""
    felt = inputs.numbers.get(APPARENT_GRAVITY, np.nan)
    if abs(felt - GRAVITY) > OTHER_UNIT:
        unit = next((word for word, size in (("g", 1.0), ("milli-g", 1e3)) if 0.8 < felt / size < 1.25), "")
        yield refused(
            f"The accelerometer feels a gravity of {felt:.3g} m/s^2, where {GRAVITY:.2f} is expected"
            f"{f': its values look like {unit}' if unit else ''}.",
            'State its unit in a channel map (unit = "g"), and its axes.',
        )
    scale = None if inputs.sensors is None else inputs.sensors.significant.get(SCALE.name)
    times = 1.0 if scale is None else velocity_over_accelerometer(scale.value)
    if scale is not None and not 1.0 / OTHER_UNIT_TIMES < times < OTHER_UNIT_TIMES:
        turn = "Turn one of them: z points up, in a channel map with sign = -1."
        correct = "Correct the unit of one of them, in a channel map with unit = ..."
        yield refused(sentence(SCALE.name, scale), turn if times < 0.0 else correct)


def sensor_reasons(inputs: VerdictInputs, *harmful: Parameter) -> Iterator[Reason]:
    """Reasons against what some kinds of disagreement between velocity and accelerometer harm."""
    sensors = inputs.sensors
    if sensors is None:
        return
    can_be_aligned = {OFFSET.name, SCALE.name}
    names = {item.name for item in harmful} - (can_be_aligned if inputs.aligned else set())
    for name, item in sensors.significant.items():
        if name in names:
            yield weak(sentence(name, item), ALIGN if name in can_be_aligned else LEVEL)
    if names & sensors.either.keys():
        yield weak(either_sentence(sensors), LEVEL)
    if sensors.otherwise:
        yield weak(
            "Velocity and accelerometer disagree in another way than by an offset, a scale or a tilt "
            f"(p-value {sensors.p_value:.1g}).",
            LEVEL,
        )


# -- Sideways motion --

#: Root mean square of the horizontal speed [m/s]; from where on a tilt between attitude and accelerometer
#: matters, and how well it must be known [rad].
SIDEWAYS = "sideways_speed"
FAST_SIDEWAYS = 3.0
TILT_KNOWN = float(np.deg2rad(1.5))


def sideways_reasons(inputs: VerdictInputs) -> Iterator[Reason]:
    """Reason against the friction: fast sideways flight, with an attitude that may lean."""
    speed = inputs.numbers.get(SIDEWAYS, np.nan)
    tilts = {tilt.name for tilt in TILTS.values()}
    known = {} if inputs.sensors is None else inputs.sensors.differences
    width = max((item.half_width for name, item in known.items() if name in tilts), default=math.inf)
    if speed > FAST_SIDEWAYS and width > TILT_KNOWN:
        degrees = f"to ±{np.rad2deg(width):.1f} degrees only" if math.isfinite(width) else "not at all"
        yield weak(
            f"The vehicle flew sideways at {speed:.1f} m/s (rms), and the angle between attitude and "
            f"accelerometer is known {degrees}.",
            "Fly up and down without sideways motion, or sideways at other times than up and down.",
        )


def fast_sideways_reasons(inputs: VerdictInputs) -> Iterator[Reason]:
    """Reason against the gain: air that crosses the rotors fast changes what they give."""
    speed = inputs.numbers.get(SIDEWAYS, np.nan)
    if speed > FAST_SIDEWAYS:
        yield weak(
            f"The vehicle flew sideways at {speed:.1f} m/s (rms): rotors give another thrust in air that "
            "crosses them, and the gain takes it up.",
            "Fly up and down without fast sideways motion.",
        )


# -- Rule --


def term_reasons(
    coefficient: QuantityEstimate, parameter: Parameter, strength: InstrumentStrength, inputs: VerdictInputs
) -> Iterator[Reason]:
    """Reasons against the coefficient of an optional term."""
    words = parameter.name.replace("_", " ")
    if inputs.direct:
        yield provisional(f"A direct method made the {words}.", LOG_REFERENCE)
    first_stage = strength.first_stage.get(parameter.name, np.nan)
    if first_stage < STRONG_FIRST_STAGE:
        yield weak(weak_instrument_sentence(words, first_stage), FLY)
    low, high = coefficient.interval
    if low <= 0.0 <= high:
        interval = f"[{low:.2g}, {high:.2g}] {parameter.unit}".rstrip()
        yield weak(
            f"The {words} cannot be distinguished from zero: its interval is {interval}.",
            "Leave the term out, and what remains is identified more closely; or fly so that it shows.",
        )


def all_reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength, inputs: VerdictInputs
) -> dict[str, tuple[Reason, ...]]:
    """Reasons against every quantity; those that one parameter decides share its reasons."""
    units = tuple(unit_reasons(inputs))
    shared = (*lag_prior_reasons(inputs), *units)
    friction = (
        *friction_reasons(quantities, strength, inputs),
        *sensor_reasons(inputs, SCALE, *TILTS.values()),
        *sideways_reasons(inputs),
        *shared,
    )
    gain = (
        *gain_reasons(quantities["input_gain"], strength, inputs),
        *thrust_curve_reasons(quantities, inputs),
        *sensor_reasons(inputs, OFFSET, SCALE),
        *omitted_variable_reasons(inputs),
        *near_ground_reasons(inputs),
        *fast_sideways_reasons(inputs),
        *shared,
    )
    hover = (
        *hover_reasons(quantities["hover_input"], inputs),
        *intercept_reasons(quantities, inputs),
        *near_ground_reasons(inputs),
        *units,
    )
    lag = (*lag_reasons(quantities, strength, inputs), *sensor_reasons(inputs, OFFSET), *shared)
    curve = (*curve_reasons(quantities, inputs), *sensor_reasons(inputs, OFFSET, SCALE), *shared)
    terms = [term.parameter for term in TERMS.values() if term.parameter.name in quantities]
    return {
        **dict.fromkeys(("viscous_friction", "time_constant"), friction),
        **dict.fromkeys(("input_gain", "intercept"), gain),
        **dict.fromkeys((ACTUATOR_LAG.name, EFFECTIVE_LAG), lag),
        DELAY.name: (*lag, *delay_reasons(quantities[DELAY.name])),
        "hover_input": hover,
        "thrust_curve": curve,
        **{
            item.name: (*term_reasons(quantities[item.name], item, strength, inputs), *shared)
            for item in terms
        },
    }
