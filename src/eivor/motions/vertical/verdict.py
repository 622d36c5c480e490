"""Systematic parts and verdict of the vertical motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eivor.flights import verdict
from eivor.flights.lag_prior import EFFECTIVE_LAG
from eivor.flights.options import ACCELEROMETER_BIAS
from eivor.flights.prepared import CommandLimit, Difference, PreparedFlight
from eivor.flights.quantity import Counts, Quantity
from eivor.flights.timestamps import are_among
from eivor.flights.verdict import VerdictInputs
from eivor.inference.verdict import Cause, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.regression import Parameter
from eivor.motions.equation import OFFSET, SCALE
from eivor.motions.vertical import misspecification
from eivor.motions.vertical.misspecification import OTHER_UNIT_TIMES, change_by, sentence
from eivor.motions.vertical.regression import GROUND, SUPPLY, TERMS, ThrustDrift, height_over_ground
from eivor.motions.vertical.select import QUANTITIES, TABLES
from eivor.signals.channels import CurveSide
from eivor.signals.recording import GRAVITY, Finding
from eivor.tools import Bool, Float

# -- Checks --

#: A flight is near the ground below so many radii.
NEAR_RADII = 4.0


@dataclass(frozen=True, slots=True)
class VerticalChecks(verdict.MotionChecks):
    """Results of the vertical motion's own tests of an estimate."""

    map_p_value: float = 1.0  # Of the test that the input map fits
    thrust_exponent: float = math.nan  # Of thrust near hover
    map_exponent: float = math.nan  # Of the input map there
    input_spread: float = 0.0  # Standard deviation of the mapped input, as a share of that of hover
    thrust_command: bool = False  # The input is a command of thrust: a linear or mixed map
    #: Mean of the specific force where the vehicle does not accelerate [m/s^2]
    apparent_gravity: float = math.nan
    turned: tuple[str, str] = ("", "")  # The sensor that goes against others, and a sentence
    sideways_speed: float = math.nan  # Root mean square of the horizontal speed [m/s]
    #: Share of the time used near the ground, and the lowest height in radii; None where not known
    near_ground: tuple[float, float] | None = None
    omitted: misspecification.OmittedTerms = field(default_factory=misspecification.OmittedTerms)
    drift: ThrustDrift | None = None  # Line in time that rows lose
    mean_command: float = 1.0  # Of the rotors, over the command of their mean thrust
    sensitivities: misspecification.Sensitivities = field(default_factory=dict)
    velocity: misspecification.Spectrum = misspecification.NO_SPECTRUM  # As far as the references explain it
    command_limit: CommandLimit | None = None

    @property
    def numbers(self) -> dict[str, float]:
        share, lowest = self.near_ground or (math.nan, math.nan)
        of_input = ("thrust_exponent", "map_exponent", "thrust_command")
        names = (*of_input, "apparent_gravity", "sideways_speed")
        return {
            "input_map_p_value": self.map_p_value,
            **{name: float(getattr(self, name)) for name in names},
            **({"near_ground_share": share, "lowest_radii": lowest} if self.near_ground else {}),
            **({} if self.drift is None else self.drift.numbers),
            **self.omitted.numbers,
            **(dict([self.command_limit]) if self.command_limit else {}),
        }

    @property
    def report(self) -> tuple[tuple[str, str], ...]:
        drift = () if self.drift is None else (("drift", self.drift.sentence),)
        sign = (("sign", self.turned[1]),) if self.turned[0] == "height" else ()
        return (*sign, *drift, *self.omitted.report)


def near_ground(
    flights: Sequence[PreparedFlight], radius: float | None, *, corrected: bool
) -> tuple[float, float] | None:
    """Share of the time used near the ground, and the lowest height in radii; of the lowest flight."""
    if radius is None or corrected:
        return None
    shares, lowest = [], []
    for flight in flights:
        height, landed = height_over_ground(flight)
        if height is not None and landed:
            radii = height[flight.used] / radius
            shares.append(float(np.mean(radii < NEAR_RADII)))
            lowest.append(float(radii.min()))
    return (max(shares), min(lowest)) if shares else None


FRICTION, GAIN, HOVER, CURVE = "viscous_friction", "input_gain", "hover_input", "thrust_curve"
OF_FRICTION, OF_GAIN = (FRICTION, "time_constant"), (GAIN, "intercept")
SEARCHED = (ACTUATOR_LAG.name, EFFECTIVE_LAG)
OF_LAG = (*SEARCHED, DELAY.name)
OF_TERMS = tuple(term.parameter for term in TERMS.values())
MOVING = (FRICTION, GAIN, *SEARCHED)

# -- Systematic parts --

#: No interval of the hover input reaches less far than this share of it: repeats of one vehicle differ.
HOVER_FLOOR = 0.02
#: Friction that an estimator's own dynamics add: one that learns a bias in a time T adds 1/T [1/s].
ESTIMATOR_FRICTION = 0.03
#: A tilt moves the friction by so many times what the accelerometer alone suffers: the weight's component
#: along the leaning attitude adds as much.
TILT_FACTOR = 2.5
#: What a tilt that is not measured may be at most [rad].
TILT_UNKNOWN = float(np.deg2rad(1.5))
#: Formats whose channels a single machine stamps by a single clock.
ONE_CLOCK = frozenset({"blackbox", "crazyflie", "dataflash", "ulog", "ulog2csv"})
#: Share of the gain that rotors change by in air that crosses them at 3 m/s; it grows with the square.
CROSSFLOW, CROSSFLOW_SPEED = 0.008, 3.0
#: An intercept clearly beyond it is no bias of an accelerometer [m/s^2].
CLEAR_INTERCEPT = 0.4

#: Lengths of intervals of T seconds are sqrt(1 + SHORT (SHORT_S / T)^4) times those of long flights: with .45
#: and a square those of 15 s covered .90, and those of 30 s .96.
SHORT, SHORT_S = 0.6, 15.0
#: Smaller shares of a quantity are not worth a sentence.
LEAST_SHARE = 0.002

_TILTS = tuple(tilt.name for tilt in misspecification.TILTS.values())


def _few_seconds(inputs: VerdictInputs) -> float:
    """Factor of errors for power spectra that are estimated from few seconds."""
    return math.sqrt(1.0 + SHORT * (SHORT_S / inputs.used_s) ** 4) if inputs.used_s else 1.0


def _difference(inputs: VerdictInputs, name: str) -> Difference | None:
    """A difference between velocity and accelerometer that is there, or may be in place of another."""
    sensors = inputs.sensors
    return None if sensors is None else {**sensors.either, **sensors.significant}.get(name)


def _sensor_sentence(name: str) -> Callable[[VerdictInputs], str]:
    def words(inputs: VerdictInputs) -> str:
        difference, right = _difference(inputs, name), "Which is right is not known."
        if inputs.corrected(name):
            right = "It was corrected, as well as that is known."
        return "" if difference is None else f"{sentence(name, difference)} {right}"

    return words


def _size(inputs: VerdictInputs, name: str) -> float:
    """Largest possible difference between the sensors; zero for none."""
    difference = _difference(inputs, name)
    if difference is None:
        return 0.0
    return difference.half_width if inputs.corrected(name) else abs(difference.value)


def _scale(inputs: VerdictInputs, name: str) -> tuple[float, float] | float:
    both = _size(inputs, SCALE.name) * abs(inputs.value(name))
    difference = _difference(inputs, SCALE.name)
    if difference is None or inputs.corrected(SCALE.name) or name != FRICTION:
        return both
    return (0.0, both) if difference.value > 0.0 else (both, 0.0)


def _left(inputs: VerdictInputs) -> list[str]:
    """Tilts that are there and were not taken out."""
    return [tilt for tilt in _TILTS if not inputs.corrected(tilt) and _difference(inputs, tilt) is not None]


def _unknown_tilt(inputs: VerdictInputs, name: str) -> float:
    """Tilts that may be there: as far as they are not known."""
    known = {} if inputs.sensors is None else inputs.sensors.differences
    widths = {tilt: known[tilt].half_width if tilt in known else TILT_UNKNOWN for tilt in _TILTS}
    return _tilt(inputs, name, {tilt: min(width, TILT_UNKNOWN) for tilt, width in widths.items()})


def _tilt(inputs: VerdictInputs, name: str, sizes: Mapping[str, float]) -> float:
    known = inputs.checks.sensitivities
    return TILT_FACTOR * math.hypot(*(size * change_by(tilt, name, known) for tilt, size in sizes.items()))


def _by_offset(inputs: VerdictInputs, name: str, size_s: float) -> float:
    """Systematic parts by an offset in time between the sensors, or of the command."""
    return size_s * abs(change_by(OFFSET.name, name, inputs.checks.sensitivities))


def _offset(inputs: VerdictInputs, name: str) -> tuple[float, float]:
    """One-sided systematic part by an offset between the sensors, unless it was removed."""
    difference, size = _difference(inputs, OFFSET.name), _size(inputs, OFFSET.name)
    if difference is None:
        return 0.0, 0.0
    both = inputs.corrected(OFFSET.name)
    if name in SEARCHED:
        return size, size if both else 0.0
    low, high = misspecification.behind(size if both else difference.value, name, inputs.checks.sensitivities)
    return (max(low, high),) * 2 if both else (low, high)


def _clocks_apart_s(inputs: VerdictInputs) -> tuple[float, float]:
    """Drift between the clocks of command and motion, and its uncertainty [s]."""
    several = False  # whether what was measured may have another clock than the commands
    for flight in inputs.flights:
        known = flight.recording.channels
        stamps = [known[name].time_s for name in flight.signals.channels if name in known]
        rows = max(stamps, key=len)
        same = all(are_among(item, rows) for item in stamps)
        several |= not same and flight.recording.format not in ONE_CLOCK
    apart: tuple[float, float] = inputs.checks.omitted.clocks_apart_s(several)
    return apart


def _unless_given(inputs: VerdictInputs, name: str, size: float) -> float:
    """The size, and nothing where the lag is given exactly."""
    low, high = inputs.quantities[name].interval
    return size if low < high else 0.0


def _shifted(inputs: VerdictInputs, name: str, size: float) -> float:
    """Commands that come later: the lag takes it up, unless it is given, and else the others do."""
    return (_unless_given if name in SEARCHED else _by_offset)(inputs, name, size)


def _secant(inputs: VerdictInputs, name: str) -> tuple[float, float]:
    gain, intercept = inputs.value(name), inputs.value("intercept")
    left = 1.0 - intercept / GRAVITY  # g / U_h over K_u is one over this
    secant = gain / left if left > 0.0 else gain
    if abs(secant - gain) < LEAST_SHARE * abs(gain):
        return 0.0, 0.0
    hover, of_map = inputs.quantities[HOVER], inputs.checks.map_exponent
    error = secant * hover.half_width / hover.value if 0.0 < hover.half_width < hover.value else 0.0
    if math.isfinite(of_map):  # a wrong exponent moves the input of hover with the input's variance
        wrong = abs(of_map - inputs.checks.thrust_exponent) * inputs.checks.input_spread**2
        error = of_map * error + secant * wrong / (2.0 * of_map)
    error = math.hypot(error, secant * ACCELEROMETER_BIAS / GRAVITY)  # which the intercept holds
    return (gain - secant + error, 0.0) if secant < gain else (0.0, secant - gain + error)


def _secant_sentence(inputs: VerdictInputs) -> str:
    gain, intercept, checks = inputs.value(GAIN), inputs.value("intercept"), inputs.checks
    secant = f"{gain / (1.0 - intercept / GRAVITY):.3g} as weight over hover input"
    words = f"The gain is {gain:.3g} m/s^2 as a slope near hover, and {secant}."
    if not (checks.map_p_value < FITS and math.isfinite(checks.thrust_exponent)):
        return words
    return (
        f"{words} The intercept of {intercept:+.2g} m/s^2 says that near hover thrust grows as the command "
        f"to the power {checks.thrust_exponent:.2f}, and the map says {checks.map_exponent:.2f}."
        f"{_bend(inputs)} {_fitting_map(inputs)}"
    )


def _supply(inputs: VerdictInputs, name: str) -> float:
    omitted, drift = inputs.checks.omitted, inputs.checks.drift
    change = omitted.supply_change
    if drift is not None and omitted.voltage_change is None:  # the line in time is the same, and known closer
        change = min(change, (abs(drift.rate) + drift.half_width) * drift.duration_s / GRAVITY)
    share = (0.5 if name == GAIN else 0.25) * change * (change >= misspecification.LEAST_TERM[SUPPLY])
    return 0.0 if name == HOVER and drift is not None else float(share * abs(inputs.value(name)))


def _drift(inputs: VerdictInputs, name: str) -> float:
    """A quarter of what the hover input changes by in a flight: the mean distance from its middle."""
    drift = inputs.checks.drift
    share = 0.0 if drift is None else 0.25 * abs(drift.hover_change) / max(len(inputs.flights), 1)
    return share * inputs.value(name) if share > LEAST_SHARE else 0.0


def _uneven(inputs: VerdictInputs, name: str) -> tuple[float, float]:
    share = inputs.checks.mean_command - 1.0
    away = share * inputs.value(name) if abs(share) > LEAST_SHARE else 0.0
    return max(-away, 0.0), max(away, 0.0)


def _periodic(inputs: VerdictInputs, _name: str) -> float:
    swing = inputs.swing
    if swing is None:
        return 0.0
    friction = misspecification.coherent_friction(inputs.checks.velocity, 1.0 / swing.period, inputs.used_s)
    return float(swing.amplitude / math.sqrt(2.0) * friction)


def _periodic_sentence(inputs: VerdictInputs) -> str:
    swing = inputs.swing
    if swing is None:
        return ""
    return (
        f"A push of {swing.amplitude:.2g} m/s^2 with a period of {swing.period:.3g} s is left over (p-value "
        f"{swing.p_value:.1g}): the part of the reference at that period may answer it."
    )


def _missed(term: str, remedy: str) -> verdict.SystematicPart:
    return verdict.SystematicPart(
        (*MOVING, DELAY.name),
        Counts.ADDED,
        lambda inputs, name: inputs.checks.omitted.change(term, name),
        lambda inputs: (
            f"{inputs.checks.omitted.spoken(term)}. Intervals reach as much further as this term changes the "
            f"values. {remedy}"
        ),
    )


#: What widens the intervals: quantities, how it counts, how large it is, and its sentence.
PARTS = (
    verdict.SystematicPart(
        (*MOVING, DELAY.name),
        Counts.FACTOR,
        lambda inputs, name: inputs.factor(_few_seconds(inputs), name),
        lambda inputs: (
            f"{inputs.used_s:.3g} s are few: errors are {_few_seconds(inputs):.2f} times as large."
        ),
    ),
    verdict.disagreement_part((*MOVING, DELAY.name)),
    verdict.SystematicPart(
        (FRICTION,),
        Counts.ADDED,
        lambda inputs, _: (
            0.0 if all("velocity" in flight.measured for flight in inputs.flights) else ESTIMATOR_FRICTION,
            0.0,
        ),
        "The velocity is not declared as measured: the dynamics of an estimator may be "
        f"{ESTIMATOR_FRICTION:g} 1/s of the friction.",
    ),
    verdict.SystematicPart(
        MOVING,
        Counts.ADDED,
        lambda inputs, name: _tilt(inputs, name, {tilt: _size(inputs, tilt) for tilt in _left(inputs)}),
        lambda inputs: " ".join(_sensor_sentence(tilt)(inputs) for tilt in _left(inputs)),
    ),
    verdict.SystematicPart(
        MOVING,
        Counts.INDEPENDENT,
        _unknown_tilt,
        "The tilt between attitude and accelerometer is not known better: sideways motion enters.",
    ),
    verdict.SystematicPart(MOVING, Counts.ADDED, _offset, _sensor_sentence(OFFSET.name)),
    verdict.SystematicPart((FRICTION, GAIN), Counts.ADDED, _scale, _sensor_sentence(SCALE.name)),
    verdict.SystematicPart(
        OF_LAG,
        Counts.ADDED,
        lambda inputs, _: inputs.half_hold_s,
        lambda inputs: (
            f"The command is logged at {inputs.command_rate_hz:.3g} Hz, which lacks some that were issued: "
            f"the lag may be {1e3 * inputs.half_hold_s:.2g} ms longer or shorter."
        ),
    ),
    verdict.SystematicPart(
        MOVING,
        Counts.ADDED,
        lambda inputs, name: _shifted(inputs, name, _clocks_apart_s(inputs)[0]),
        lambda inputs: (
            f"{inputs.checks.omitted.spoken(misspecification.CLOCK_DRIFT)}: up to "
            f"{1e3 * _clocks_apart_s(inputs)[0]:.2g} ms in this flight."
        ),
    ),
    verdict.SystematicPart(
        SEARCHED,
        Counts.INDEPENDENT,
        lambda inputs, name: _unless_given(inputs, name, _clocks_apart_s(inputs)[1]),
        lambda inputs: (
            "The log may have several clocks, whose drift is not known better: they may be "
            f"{1e3 * _clocks_apart_s(inputs)[1]:.2g} ms apart."
        ),
    ),
    verdict.SystematicPart(
        (FRICTION, GAIN),
        Counts.ADDED,
        lambda inputs, name: _by_offset(
            inputs,
            name,
            inputs.half_hold_s
            if inputs.command_rate_hz < verdict.SLOW_COMMAND_HZ
            else inputs.command_slack_s,
        ),
        lambda inputs: f"The command is logged at {inputs.command_rate_hz:.0f} Hz: its edges are not known.",
    ),
    verdict.SystematicPart((GAIN,), Counts.AT_LEAST, _secant, _secant_sentence),
    _missed(misspecification.CURVATURE, "Have it in the equation by --input-map fit."),
    _missed(misspecification.DESCENT, "Descend more slowly, or forward, out of the air of the rotors."),
    _missed(GROUND, "Fly four radii of a rotor and more over the ground, or add --term ground-effect."),
    verdict.SystematicPart(
        (GAIN,),
        Counts.ADDED,
        lambda inputs, name: (
            CROSSFLOW * (inputs.checks.sideways_speed / CROSSFLOW_SPEED) ** 2 * abs(inputs.value(name))
        ),
        lambda inputs: (
            f"The vehicle flew sideways at {inputs.checks.sideways_speed:.1f} m/s (rms): rotors give another "
            "thrust in air that crosses them."
        ),
    ),
    verdict.SystematicPart(
        (GAIN, HOVER), Counts.ADDED, _supply, lambda inputs: inputs.checks.omitted.supply_sentence
    ),
    verdict.SystematicPart(
        (HOVER,),
        Counts.INDEPENDENT,
        _drift,
        lambda inputs: f"The {inputs.checks.drift.sentence}: the value is that of the middle.",
    ),
    verdict.SystematicPart(
        (HOVER,),
        Counts.ADDED,
        _uneven,
        lambda inputs: (
            "The rotors' commands differ: their mean at hover is "
            f"{abs(inputs.checks.mean_command - 1.0):.1%} from the command of their mean thrust."
        ),
    ),
    verdict.SystematicPart((FRICTION,), Counts.ADDED, _periodic, _periodic_sentence),
    verdict.SystematicPart(
        (HOVER,),
        Counts.AT_LEAST,
        lambda inputs, name: max(HOVER_FLOOR * inputs.value(name), 0.0),
        "Valid for this flight's conditions (wind, height, speed, battery, temperature): the interval is at "
        f"least ±{HOVER_FLOOR:.1%} wide.",
    ),
)

# -- Limits and rules --

WORDS = TABLES.words
QUICKER = "Fly quicker steps, and log command and acceleration at 50 Hz or more."
LARGER_STEPS = "Fly quicker and larger steps, which change the thrust more."
LONGER = "Fly longer, faster climbs and descents, or pool several flights."
CHECK_INPUT = "Check units and signs, and that the input is the command of this vehicle."
CHECK_SIGN = "Check the frame (z up, or NED), the input's sign and its map."
CHECK_STAMPS = "Check that the input is the command of this vehicle, and its time stamps."
#: Half-widths of identified and weak, as shares of the value or in its unit; wider is refused.
LIMITS = {
    FRICTION: verdict.Limit(0.5, 1.0, zero=Status.REFUSED, narrower=LONGER, away_from_zero=WORDS.fly),
    GAIN: verdict.Limit(0.1, 0.25, zero=Status.REFUSED, narrower=LARGER_STEPS),
    EFFECTIVE_LAG: verdict.Limit(0.25, 0.5, 0.02, 0.02, narrower=QUICKER),
    HOVER: verdict.Limit(0.025, 0.05, narrower="Fly longer, and come to rest between the climbs."),
    CURVE: verdict.Limit(0.0, 0.0, 0.15, 0.5, narrower=LARGER_STEPS),
}
LARGE_INTERCEPT = 5.0
#: A flight is near the ground when it is there for this share of the time used.
NEAR_SHARE = 0.01
#: A map does not fit below this p-value, and the bend is reported beside the intercept below the other.
FITS, BENDS = 0.05, 0.1
LEAST_EXPONENT = 0.95
#: An accelerometer that feels a gravity so far off is in another unit [m/s^2].
OTHER_UNIT = 3.0


def _bend(inputs: VerdictInputs) -> str:
    """Words on the curvature's part in the intercept, after a blank; empty for none."""
    bend, intercept = (
        inputs.checks.omitted.differences.get(misspecification.CURVATURE),
        inputs.quantities["intercept"],
    )
    if bend is None or not (bend.p_value < BENDS and bend.value * intercept.value < 0.0):
        return ""
    of_power, uncertain = -intercept.value / (2.0 * GRAVITY), intercept.half_width / (2.0 * GRAVITY)
    text = f" The curve bends as well ({bend.value:+.2g} ± {bend.half_width:.2g})"
    if bend.value + bend.half_width < of_power - uncertain:
        return f"{text}, more than such a power does ({of_power:+.2g}): so does thrust that sags under load."
    return f"{text}."


def _fitting_map(inputs: VerdictInputs) -> str:
    exponent, hover = inputs.checks.thrust_exponent, inputs.value(HOVER)
    if exponent < LEAST_EXPONENT:
        return (
            "No propeller's thrust grows so slowly: look for a supply that sags under load, and check that "
            "the input is the command of this vehicle."
        )
    if inputs.checks.thrust_command and 1.0 < exponent < 2.0 and 0.0 < hover < 1.0:
        # (1 - s) u + s u^2 has the exponent r at u_h for s = (r - 1) / ((r - 1) + (2 - r) u_h)
        share = (exponent - 1.0) / ((exponent - 1.0) + (2.0 - exponent) * hover)
        return f"Use --input-map mixed:{share:.2g} if nothing else is wrong; a sagging supply looks alike."
    known = {1.0: "linear", 2.0: "square"}.get(round(exponent, 1), f"power:{exponent:.2g}")
    return f"Use --input-map {known} if nothing else is wrong; a supply that sags under load looks alike."


def _gravity_sentence(inputs: VerdictInputs) -> str:
    felt = inputs.checks.apparent_gravity
    unit = next((word for word, size in (("g", 1.0), ("milli-g", 1e3)) if 0.8 < felt / size < 1.25), "")
    looks = f": its values look like {unit}" if unit else ""
    return f"The accelerometer feels a gravity of {felt:.3g} m/s^2, where {GRAVITY:.2f} is expected{looks}."


def _times(inputs: VerdictInputs) -> float:
    """Ratio of the velocity's reading to the accelerometer's."""
    scale = None if inputs.sensors is None else inputs.sensors.significant.get(SCALE.name)
    return 1.0 if scale is None else misspecification.velocity_over_accelerometer(scale.value)


def _sensor_remedy(inputs: VerdictInputs) -> str:
    scale = _difference(inputs, SCALE.name)
    if scale is not None and misspecification.may_stand_still(scale):
        return "Log both at 50 Hz or more: vibration folds into slower samples."
    return "Correct the unit of one of them (in a table by a channel map: unit = ...)."


def _beyond(inputs: VerdictInputs, limit: float) -> bool:
    return abs(inputs.value("intercept")) - inputs.quantities["intercept"].half_width > limit


#: A delay that is known less closely is not separated from the lag [s].
DELAY_HALF_WIDTH_S = 0.02


def _term_rules(parameter: Parameter) -> tuple[verdict.Rule, ...]:
    leave_out = "Leave the term out, and what remains is identified more closely; or fly so that it shows."
    limit = replace(LIMITS[FRICTION], narrower=leave_out, away_from_zero=leave_out)
    names = (parameter.name,)
    # of instruments that there are not, or are weak
    weak = verdict.flight_rules(WORDS, names, names, parameter.name)[:3]
    return (*weak, *limit.rules(parameter.name, QUANTITIES[parameter.name]))


_STAGES = (FRICTION, GAIN, ACTUATOR_LAG.name, DELAY.name)
_INSTRUMENTED = ((OF_FRICTION, FRICTION), ((*OF_GAIN, CURVE), GAIN), (OF_LAG, EFFECTIVE_LAG))
_EVERYTHING = (*OF_FRICTION, *OF_GAIN, *OF_LAG, CURVE, *(term.name for term in OF_TERMS))
#: The hover input rests on means of the input, which no accelerometer moves.
_NOT_HOVER = tuple(name for name in QUANTITIES if name != HOVER)
#: When a sentence speaks against quantities: first contradictions, then intervals that are too wide.
RULES = (
    verdict.Rule(
        _NOT_HOVER,
        lambda inputs: abs(inputs.checks.apparent_gravity - GRAVITY) > OTHER_UNIT,
        Status.REFUSED,
        _gravity_sentence,
        'Check its unit and axes (in a table by a channel map: unit = "g").',
        Cause.CONTRADICTION,
    ),
    verdict.Rule(
        _NOT_HOVER,
        lambda inputs: inputs.checks.turned[0] == "velocity",
        Status.REFUSED,
        lambda inputs: inputs.checks.turned[1],
        "Turn it, so that z points up (in a table by a channel map: sign = -1, or frame of the whole log).",
        Cause.CONTRADICTION,
    ),
    verdict.Rule(
        _NOT_HOVER,
        lambda inputs: not 1.0 / OTHER_UNIT_TIMES < _times(inputs) < OTHER_UNIT_TIMES,
        Status.REFUSED,
        _sensor_sentence(SCALE.name),
        _sensor_remedy,
        Cause.CONTRADICTION,
    ),
    *(rule for names, of in _INSTRUMENTED for rule in verdict.flight_rules(WORDS, names, _STAGES, of)),
    verdict.Rule(
        OF_FRICTION,
        lambda inputs: inputs.quantities[FRICTION].interval[1] < 0.0,
        Status.REFUSED,
        lambda inputs: (
            f"The viscous friction came out at {inputs.value(FRICTION):.3g} 1/s, which no vehicle has: the "
            f"air or a feedback moved the vehicle more than the reference did.{inputs.moved}"
        ),
        WORDS.fly,
    ),
    verdict.Rule(
        (*OF_FRICTION, *OF_GAIN),
        lambda inputs: inputs.quantities[GAIN].interval[1] < 0.0,
        Status.REFUSED,
        "The input gain is not positive: the input, or the acceleration, has the wrong sign.",
        CHECK_SIGN,
        Cause.CONTRADICTION,
    ),
    verdict.Rule(
        (HOVER,),
        lambda inputs: not 0.0 < inputs.value(HOVER) < math.inf,
        Status.REFUSED,
        "The hover input is not positive.",
        CHECK_SIGN,
        Cause.CONTRADICTION,
    ),
    verdict.Rule(
        OF_FRICTION,
        lambda inputs: _beyond(inputs, LARGE_INTERCEPT),
        Status.WEAK,
        lambda inputs: (
            f"The intercept is {inputs.value('intercept'):.1f} m/s^2, far beyond the bias of an "
            "accelerometer."
        ),
        "Check the units and signs of velocity and acceleration, the clock, and the input map.",
    ),
    verdict.Rule(
        (CURVE,),
        lambda inputs: _beyond(inputs, CLEAR_INTERCEPT),
        Status.REFUSED,
        lambda inputs: (
            "No thrust curve of this kind fits: the intercept is still "
            f"{inputs.value('intercept'):+.2g} m/s^2 with the one that comes nearest."
        ),
        CHECK_INPUT,
        Cause.CONTRADICTION,
    ),
    verdict.Rule(
        (*OF_GAIN, HOVER),
        lambda inputs: inputs.checks.near_ground is not None and inputs.checks.near_ground[0] >= NEAR_SHARE,
        Status.WEAK,
        lambda inputs: (
            f"The vehicle flew below {NEAR_RADII:.0f} rotor radii over the ground for "
            f"{inputs.checks.near_ground[0]:.0%} of the time ({inputs.checks.near_ground[1]:.1f} at the "
            "lowest): thrust grows there, and the gain takes it up."
        ),
        "Fly higher, or add --term ground-effect.",
    ),
    verdict.longest_lag_rule(_EVERYTHING, CHECK_STAMPS),
    verdict.end_of_grid_rule(
        DELAY.name,
        _EVERYTHING,
        lambda highest, inputs: (
            f"The delay ran into the top of its grid ({highest:.1f} s)."
            if ACTUATOR_LAG.name in inputs.searched
            else f"The delay of the measured rotors ran into the end of its grid ({highest * 1e3:.0f} ms)."
        ),
        lambda inputs: (
            CHECK_STAMPS
            if ACTUATOR_LAG.name in inputs.searched
            else "Check the clock of the rotors' telemetry, or use the commands with --input."
        ),
    ),
    verdict.Rule(
        (DELAY.name,),
        lambda inputs: inputs.quantities[DELAY.name].half_width >= DELAY_HALF_WIDTH_S,
        Status.WEAK,
        "The flight does not separate the delay from the lag.",
        QUICKER,
    ),
    *LIMITS[FRICTION].rules(FRICTION, QUANTITIES[FRICTION], "time_constant"),
    *LIMITS[GAIN].rules(GAIN, QUANTITIES[GAIN], "intercept"),
    *verdict.lag_rules(LIMITS[EFFECTIVE_LAG], QUANTITIES[EFFECTIVE_LAG]),
    *LIMITS[HOVER].rules(HOVER, QUANTITIES[HOVER]),
    *LIMITS[CURVE].rules(CURVE, QUANTITIES[CURVE]),
    *(rule for term in OF_TERMS for rule in _term_rules(term)),
)

# -- Hover --

START, RANGE, ESTIMATE = "MPC_THR_HOVER", "HTE_THR_RANGE", "hover_thrust_estimate"
#: The ends that the range is cut to, lower and upper.
LOWER_END, UPPER_END = (0.0, 0.8), (0.2, 0.9)
#: An estimate so near to an end stands at it, and one so near to its start has not left it.
NEAR_END, NEAR_START = 0.01, 1e-3
#: So long after leaving its start it is still on its way [s]: PX4's is a filter, ArduPilot's learns in 10 s.
ON_ITS_WAY_S = {START: 2.0, "MOT_THST_HOVER": 30.0}
#: An estimate stands at an end when it is there for this share of the time used.
AT_END_SHARE = 0.5


def hover_findings(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity]
) -> Iterator[Finding]:
    """Hover inputs that the flights' autopilots have estimated, compared where ours is identified."""
    flying = [flight for flight in flights if flight.runs and is_setpoint(flight)]
    for flight in flying:
        yield from _standing_at_an_end(flight)
    hover = quantities["hover_input"]
    values = np.concatenate([np.empty(0), *map(comparable_estimates, flying)])
    if hover.verdict is Status.IDENTIFIED and np.isfinite(hover.value) and values.size:
        median = float(np.median(values))
        off = hover.value / median - 1.0
        yield Finding(
            "hover_estimate",
            f"The autopilot's own estimate of the hover thrust is {median:.3g} (median of {values.size} "
            f"samples); this vehicle hovered at {hover.value:.3g}, {abs(off):.1%} "
            f"{'more' if off > 0.0 else 'less'}.",
        )


def is_setpoint(flight: PreparedFlight) -> bool:
    """Whether the input is a thrust setpoint, which the autopilot's hover input is a value of."""
    unknown = flight.curve_side is CurveSide.UNKNOWN
    return flight.curve_side is CurveSide.BEFORE or (unknown and flight.input.name == "input")


def comparable_estimates(flight: PreparedFlight) -> Float[np.ndarray, " _"]:
    """Samples of the autopilot's estimate while the flight was used, that say something of the vehicle."""
    time_s, values, within = _estimates(flight)
    for low, high, _ in _ends(flight):
        within &= ~((values >= low) & (values <= high))
    for name, wait_s in ON_ITS_WAY_S.items():
        start = flight.recording.parameters.get(name, np.nan)
        with np.errstate(invalid="ignore"):
            left = np.flatnonzero(np.abs(values - start) > NEAR_START)
        since = time_s[left[0]] if left.size else np.inf
        within &= np.isnan(start) | (time_s >= since + wait_s)
    return values[within]


def _estimates(
    flight: PreparedFlight,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Stamps and values of the autopilot's estimate, and which are numbers within the time that was used."""
    channel = flight.recording.channels.get(ESTIMATE)
    time_s, values = (np.empty(0), np.empty(0)) if channel is None else (channel.time_s, channel.values)
    first, last = flight.span_s
    return time_s, values, np.isfinite(values) & (time_s >= first) & (time_s <= last)


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
    _, values, within = _estimates(flight)
    values = values[within]
    for low, high, words in _ends(flight):
        if values.size and np.mean((values >= low) & (values <= high)) > AT_END_SHARE:
            sentence = f"The autopilot's own estimate of the hover thrust stood at its {words}"
            yield Finding("hover_estimate_at_limit", f"{sentence}: it is not compared.")
