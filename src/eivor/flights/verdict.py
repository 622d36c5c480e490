"""Inputs of a verdict, the rules that make it, and the systematic parts of intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import Any

import msgspec

from eivor.flights.lag_prior import EFFECTIVE_LAG, NO_LAG, LagPrior
from eivor.flights.prepared import PreparedFlight, SensorAgreement
from eivor.flights.quantity import Counts, QuantityEstimate, QuantitySpec, SystematicUncertainty, Words
from eivor.flights.references import HEADED
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.diagnostics.excitation import Periodicity, Swing
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE, OverIdentification
from eivor.inference.diagnostics.record import SIGNIFICANT
from eivor.inference.distributions import chi_square_quantile
from eivor.inference.verdict import Cause, Reason, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, SECOND_LAG, STAGES
from eivor.models.separable import InstrumentRule, NoInstruments
from eivor.tools import plain

# -- Inputs --

#: Smallest part of a factor that is worth a sentence.
LEAST_FACTOR = 0.02
#: Edges of commands below this rate are not known: they move lag and gain by half a hold [Hz].
SLOW_COMMAND_HZ = 45.0


class Instruments(msgspec.Struct, frozen=True):
    """Instruments of a method."""

    rule: InstrumentRule
    exogenous: bool = True  # They do not answer the vehicle
    missing: str = ""  # Why there are none although the method needs them
    constant: bool = False  # There are none, and a reference that is logged is constant
    names: tuple[str, ...] = ()  # The references among them
    past_inputs: bool = False  # They are past inputs, which a controller computes

    @property
    def direct(self) -> bool:
        """Whether there are none."""
        return isinstance(self.rule, NoInstruments)


@dataclass(frozen=True, slots=True)
class MotionChecks:
    """Tests of an estimate by a motion itself, for its rules, reports and documents."""

    @property
    def numbers(self) -> dict[str, float]:
        """Diagnostics by name."""
        return {}

    @property
    def report(self) -> tuple[tuple[str, str], ...]:
        """A title and a sentence for each check that reports show."""
        return ()


@dataclass(frozen=True, slots=True)
class VerdictInputs:
    """Inputs of rules and systematic parts."""

    flights: tuple[PreparedFlight, ...]  # Those used
    #: Slowest command, and the fastest of what was measured over the slowest flight [Hz]
    command_rate_hz: float
    response_rate_hz: float
    instruments: Instruments
    excitation: str = ""  # How much the flights moved, as a sentence; empty when it is not known
    single_frequency_hz: float = 0.0  # The frequency of a reference that has only one; zero for others [Hz]
    checks: Any = field(default_factory=MotionChecks)  # What the motion adds, see `Motion.checks`
    lag_prior: LagPrior | None = None  # What was known of the lag from elsewhere
    periodicity: Periodicity | None = None
    #: Joint parameters before and after they change; none where they do not
    sides: tuple[Mapping[str, float], ...] = ()
    sensors: SensorAgreement | None = None  # Whether two measurements of one response agree
    used_s: float = math.inf  # Time used of all flights [s]
    order_given: bool = False  # Of the response
    #: Share of the variance of each joint parameter that comes from priors
    prior_share: Mapping[str, float] = field(default_factory=dict)
    #: Conditional first-stage F of each joint parameter; NaN without instruments
    first_stage: Mapping[str, float] = field(default_factory=dict)
    agreement: OverIdentification | None = None  # Over-identification test of the flights by themselves
    #: Nuisance parameters on grids: value, and the grid's top
    searched: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: Sets of parameters whose interval is theirs: where instruments are weak or the sets have no bounds,
    #: those that hold all the same; and those of a pool
    robust: Mapping[str, ConfidenceSet] = field(default_factory=dict)
    quantities: Mapping[str, QuantityEstimate] = field(default_factory=dict)

    def value(self, name: str) -> float:
        """Value of a quantity."""
        return self.quantities[name].value

    @property
    def p_value(self) -> float:
        """P-value of the over-identification test; 1 without surplus instruments."""
        return 1.0 if self.agreement is None else self.agreement.p_value

    def weakest(self, names: Sequence[str]) -> tuple[str, float] | None:
        """Parameter out of some with the least F, where that is weak."""
        listed = [(name, F) for name, F in self.first_stage.items() if name in names]
        weak = [item for item in listed if not item[1] >= STRONG_FIRST_STAGE]
        return min(weak, key=lambda item: math.inf if math.isnan(item[1]) else item[1], default=None)

    def corrected(self, name: str) -> bool:
        """Whether a difference between the sensors was taken out."""
        return any(name in flight.corrected for flight in self.flights)

    @property
    def swing(self) -> Swing | None:
        """Significant periodic variation of the residual; None without."""
        left_over = () if self.periodicity is None else self.periodicity.left_over
        significant = [item for item in left_over if item.p_value < SIGNIFICANT]
        return min(significant, key=lambda item: item.p_value, default=None)

    def factor(self, times: float, name: str) -> tuple[float, float]:
        """Factor of an interval for larger errors of the flights, which do not change its prior part."""
        given = self.prior_share.get(ACTUATOR_LAG.name if name == EFFECTIVE_LAG else name, 0.0)
        whole = math.sqrt(times**2 * (1.0 - given) + given)
        return (whole, whole) if whole > 1.0 + LEAST_FACTOR else (0.0, 0.0)

    @property
    def moved(self) -> str:
        """Excitation of the flights in words, after a blank."""
        return f" {self.excitation}" if self.excitation else ""

    @property
    def command_slack_s(self) -> float:
        """Uncertainty of the times at which commands were issued [s]."""
        return max((flight.command_slack_s for flight in self.flights), default=0.0)

    @property
    def locked_s(self) -> float:
        """Largest distance of commands from the middle of their hold in a loop in step with the log [s]."""
        return max((flight.locked_s for flight in self.flights), default=0.0)

    @property
    def half_hold_s(self) -> float:
        """Half the time between commands that the log lacks; of its own where that is not known [s]."""
        without_lag = self.lag_prior is not None and self.lag_prior.known == NO_LAG
        if without_lag or any(flight.input.measured for flight in self.flights):
            return 0.0
        issued_s = max((flight.unlogged_step_s for flight in self.flights), default=0.0)
        if self.command_slack_s or (issued_s and self.command_rate_hz < SLOW_COMMAND_HZ):
            return max(0.5 / self.command_rate_hz, self.command_slack_s)
        return 0.5 * issued_s


# -- Systematic parts --

#: A part smaller than this share of half an interval changes nothing.
NEGLIGIBLE = 1e-3
#: References that disagree by a smaller p-value lengthen intervals.
DOUBTFUL = 0.05


class SystematicPart(msgspec.Struct, frozen=True):
    """A row of a motion's table: effect of one cause on some quantities."""

    quantities: tuple[str, ...]
    counts: Counts
    #: From the inputs and the quantity's name to the part below and above, or to both alike; zero for none
    size: Callable[[VerdictInputs, str], tuple[float, float] | float]
    sentence: Callable[[VerdictInputs], str] | str


def disagreement_part(quantities: tuple[str, ...]) -> SystematicPart:
    """Row of references or sensors that disagree: errors are larger than the residual says (Birge 1932)."""

    def factors(inputs: VerdictInputs) -> tuple[float, float]:
        # an estimated tilt shows by references, another one in the sensors
        sensors = inputs.sensors
        blind = sensors is not None and not any(name.startswith("tilt") for name in sensors.differences)
        of_sensors = sensors.agreement if sensors is not None and blind else None
        return birge_factor(inputs.agreement), birge_factor(of_sensors)

    def factor(inputs: VerdictInputs, name: str) -> tuple[float, float]:
        return inputs.factor(max(factors(inputs)), name)

    def sentence(inputs: VerdictInputs) -> str:
        by_references, by_sensors = factors(inputs)
        who, p_value, times = "The references disagree", inputs.p_value, max(by_references, by_sensors)
        if by_sensors > by_references and inputs.sensors is not None:
            who = "Velocity and accelerometer disagree in another way than by an offset, a scale or a tilt"
            p_value = inputs.sensors.p_value
        return f"{who} (J p-value {p_value:.1g}): errors are {times:.2f} times as large."

    return SystematicPart(quantities, Counts.FACTOR, factor, sentence)


def birge_factor(test: OverIdentification | None) -> float:
    """Ratio of residual errors of surplus equations to their expectation; 1 where these agree."""
    if test is None or not test.degrees or not test.p_value < DOUBTFUL:
        return 1.0
    if test.p_value < SIGNIFICANT:
        return max(math.sqrt(test.J / test.degrees), 1.0)
    return max(math.sqrt(test.J / chi_square_quantile(1.0 - DOUBTFUL, test.degrees)), 1.0)


def clock_part(quantities: tuple[str, ...], counts: Counts = Counts.ADDED) -> SystematicPart:
    """Row of commands that may have been issued between those that are logged."""
    return SystematicPart(
        quantities,
        counts,
        lambda inputs, _: inputs.command_slack_s,
        lambda inputs: f"{UNSEEN}the lag may be {1e3 * inputs.command_slack_s:.2g} ms longer or shorter.",
    )


UNSEEN = "The log does not show how often its command was issued: "
#: Gain of a loop of rates over its lag, that of rotors and of sensors [s]; half of an attitude's hold [s].
RATE_LOOP, SENSING_S, ATTITUDE_HOLD_S = 0.45, 0.005, 0.0025
#: Ratio of its effects on damping and on gains: the loop's gain [1/s], in PX4 6.5, of a Crazyflie 6.
ATTITUDE_GAIN = 6.5
LOCKED = "The log's stamps are even, and a slower loop of the controller may run in step with them: "


def clock_parts(
    lags: tuple[str, ...],
    gains: tuple[str, ...],
    dampings: tuple[str, ...] = (),
    counts: Counts = Counts.ADDED,
    reaction_s: Callable[[VerdictInputs, str], float] = lambda *_: 0.0,
) -> tuple[SystematicPart, ...]:
    """Rows of when commands were issued, and of a slower loop that runs in step with their stamps."""

    def sensed_s(inputs: VerdictInputs) -> float:
        return max(inputs.value(EFFECTIVE_LAG), 0.0) + SENSING_S

    def share(inputs: VerdictInputs, by_s: float) -> float:
        return RATE_LOOP * by_s / sensed_s(inputs)

    def locked(inputs: VerdictInputs) -> float:
        # attitudes of a position loop are demanded as slowly as its own step
        by_position = {*chain.from_iterable(HEADED.values())} & {*inputs.instruments.names}
        return share(inputs, inputs.locked_s if by_position else min(inputs.locked_s, ATTITUDE_HOLD_S))

    def unseen(inputs: VerdictInputs) -> float:
        delay = inputs.quantities.get(DELAY.name)  # which takes up what it can: it is never below zero
        return share(inputs, max(inputs.command_slack_s - (max(delay.value, 0.0) if delay else 0.0), 0.0))

    def of_gains(size: Callable[[VerdictInputs], float], why: str) -> SystematicPart:
        return SystematicPart(
            gains,
            Counts.INDEPENDENT,
            lambda inputs, name: (  # a reaction is there at once, where thrusts are behind the lag
                size(inputs) * abs(inputs.value(name)) * max(reaction_s(inputs, name) / sensed_s(inputs), 1.0)
            ),
            lambda inputs: f"{why}a gain may be {100.0 * size(inputs):.2g} % larger or smaller.",
        )

    return (
        clock_part(lags, counts),
        SystematicPart(
            lags,
            Counts.INDEPENDENT,
            lambda inputs, _: inputs.locked_s,
            lambda inputs: f"{LOCKED}the lag may be {1e3 * inputs.locked_s:.2g} ms longer or shorter.",
        ),
        of_gains(unseen, UNSEEN),
        of_gains(locked, LOCKED),
        SystematicPart(
            dampings,
            Counts.INDEPENDENT,
            lambda inputs, _: ATTITUDE_GAIN * locked(inputs),
            lambda inputs: f"{LOCKED}it may be {ATTITUDE_GAIN * locked(inputs):.2g} 1/s larger or smaller.",
        ),
    )


def systematic_uncertainties(
    parts: Iterable[SystematicPart], inputs: VerdictInputs
) -> dict[str, tuple[SystematicUncertainty, ...]]:
    """Parts by quantity, without negligible ones."""
    results: dict[str, tuple[SystematicUncertainty, ...]] = {}
    for part in parts:
        for name in part.quantities:
            if name not in inputs.quantities:
                continue
            size = part.size(inputs, name)
            # unknown quantities have no part
            below, above = size if isinstance(size, tuple) else 2 * (size if math.isfinite(size) else 0.0,)
            half = inputs.quantities[name].half_width
            if max(below, above) > (NEGLIGIBLE * half if math.isfinite(half) else 0.0):
                item = SystematicUncertainty(part.counts, below, above, _said(part.sentence, inputs))
                results[name] = (*results.get(name, ()), item)
    return results


@dataclass(frozen=True, slots=True)
class Rule:
    """A row of a motion's table: when a sentence speaks against some quantities, and what to do."""

    quantities: tuple[str, ...]  # None are all
    when: Callable[[VerdictInputs], bool]
    status: Status  # The best that it allows
    sentence: Callable[[VerdictInputs], str] | str
    remedy: Callable[[VerdictInputs], str] | str = ""
    cause: Cause = Cause.OTHER

    def reason(self, inputs: VerdictInputs) -> Reason:
        """The reason that it gives."""
        return Reason(self.status, _said(self.sentence, inputs), _said(self.remedy, inputs), self.cause)


def _said(words: Callable[[VerdictInputs], str] | str, inputs: VerdictInputs) -> str:
    return words if isinstance(words, str) else words(inputs)


def reasons_by_quantity(
    rules: Iterable[Rule], inputs: VerdictInputs, wording: Mapping[str, QuantitySpec]
) -> dict[str, tuple[Reason, ...]]:
    """Reasons against each quantity, by the rules, by an interval without two ends, and by what it needs."""
    results: dict[str, tuple[Reason, ...]] = dict.fromkeys(inputs.quantities, ())
    for rule in rules:
        names = [name for name in rule.quantities or results if name in results]
        if names and rule.when(inputs):
            reason = rule.reason(inputs)
            results |= {name: (*results[name], reason) for name in names}
    for name, reasons in results.items():
        unbounded = any(math.isinf(end) for end in inputs.quantities[name].interval)
        if unbounded and not any(reason.status is Status.REFUSED for reason in reasons):
            sentence = f"The {wording[name].words} has no interval with two ends: these data fit numbers "
            remedy = "Fly larger and quicker movements, or longer."
            reason = Reason(Status.REFUSED, f"{sentence}however far away.", remedy, Cause.WIDE)
            results[name] = (*reasons, reason)
    for name in results:
        needed = (reason for item in wording[name].needs for reason in results.get(item, ()))
        results[name] = tuple(dict.fromkeys((*results[name], *needed)))
    return results


# -- Limits of intervals --


@dataclass(frozen=True, slots=True)
class Limit:
    """Limits of a quantity's half-width, as a share of the value or in its unit."""

    identified: float = 0.0  # Share of the value
    weak: float = math.inf  # The same; wider is refused
    identified_within: float = 0.0  # What is always narrow enough [unit of the quantity]
    weak_within: float = 0.0  # The same for weak
    zero: Status | None = None  # What an interval that reaches zero allows; None where zero is a value
    #: What to do about an interval that is too wide, and about one that reaches zero
    narrower: Callable[[VerdictInputs], str] | str = "Fly larger and quicker steps, or longer."
    away_from_zero: str = ""

    def half_widths(self, value: float) -> tuple[float, float]:
        """Largest half-widths of identified and of weak at a value."""
        size = abs(value)
        identified = max(self.identified * size, self.identified_within)
        weak = math.inf if math.isinf(self.weak) else max(self.weak * size, self.weak_within)
        return identified, weak

    def rules(self, name: str, wording: QuantitySpec, *following: str) -> tuple[Rule, ...]:
        """Rows of a quantity and of those that follow from it: reaches zero, too wide for either status."""

        def level(inputs: VerdictInputs) -> int:
            """0 of an interval that is narrow enough, 1 and 2 of wider ones, 3 of one that holds zero."""
            quantity = inputs.quantities[name]
            (low, high), half = quantity.interval, quantity.half_width
            if self.zero is not None and -math.inf < low <= 0.0 <= high < math.inf:
                return 3
            identified, weak = self.half_widths(quantity.value)
            return 0 if half == math.inf or half <= identified else 1 if half <= weak else 2

        def zero_sentence(inputs: VerdictInputs) -> str:
            low, high = inputs.quantities[name].interval
            interval = f"[{plain(low)}, {plain(high)}] {wording.unit}".rstrip()
            words = f"The {wording.words} cannot be distinguished from zero: its interval is {interval}."
            return f"{words}{inputs.moved}"

        def wide_sentence(inputs: VerdictInputs) -> str:
            value, half, which = inputs.value(name), inputs.quantities[name].half_width, level(inputs) - 1
            needed, needs = self.half_widths(value)[which], ("identified needs", "it needs")[which]
            shares = (self.identified, self.weak)[which] * abs(value) >= needed
            wide, narrow = (
                f"±{plain(100.0 * size / abs(value), 3)}%"
                if shares and value
                else f"±{plain(size * wording.scale)} {wording.shown_unit or wording.unit}".rstrip()
                for size in (half, needed)
            )
            return f"The interval of the {wording.words} is {wide} wide; {needs} {narrow}.{inputs.moved}"

        def row(at: int, status: Status, *words: Any) -> Rule:
            return Rule((name, *following), lambda inputs: level(inputs) == at, status, *words)

        reaches_zero = zero_sentence, self.away_from_zero or self.narrower, Cause.ZERO
        too_wide = wide_sentence, self.narrower, Cause.WIDE
        rows = row(1, Status.WEAK, *too_wide), row(2, Status.REFUSED, *too_wide)
        return rows if self.zero is None else (row(3, self.zero, *reaches_zero), *rows)


# -- Rules that motions share --

#: References that disagree by a smaller p-value contradict the model: no interval is long enough for that.
CONTRADICTION = 1e-6
GIVE_RATE = "Give --controller-rate where it is known. "
GIVE_LAG = "Or give the lag, where it is known: --lag MS:STD or --lag LOW..HIGH."


def seconds_rule(least_s: float) -> Rule:
    """Row of few seconds."""
    return Rule(
        (),
        lambda inputs: inputs.used_s < least_s,
        Status.WEAK,
        lambda inputs: f"Only {inputs.used_s:.3g} s could be used; {least_s:.0f} s are needed.",
        "Fly longer, or pool several flights.",
    )


def below_zero_rule(name: str, of: QuantitySpec, status: Status, why: str, remedy: str) -> Rule:
    """Row of a quantity below zero."""

    def sentence(inputs: VerdictInputs) -> str:
        came_out = f"{of.words} came out at {inputs.value(name):.3g} {of.unit}".rstrip()
        return f"The {came_out}, below zero: {why}."

    return Rule(
        (name,),
        lambda inputs: inputs.quantities[name].interval[1] < 0.0,
        status,
        sentence,
        remedy,
        Cause.CONTRADICTION,
    )


def _anywhere(low: float, high: float) -> str:
    """A bounded or unbounded set in words."""
    if math.isfinite(low) and math.isfinite(high):
        return f"anywhere in [{plain(low)}, {plain(high)}]"
    bounds = [f"above {plain(low)}"] * math.isfinite(low) + [f"below {plain(high)}"] * math.isfinite(high)
    return f"anywhere{''.join(f' {bound}' for bound in bounds)}"


def flight_rules(
    words: Words, quantities: tuple[str, ...], stages: tuple[str, ...], set_of: str = ""
) -> tuple[Rule, ...]:
    """Rows of what instruments are to identify: quantities by some first stages, judged by one robust set."""

    def unidentified(inputs: VerdictInputs) -> bool:
        known = inputs.robust.get(set_of)
        weak = inputs.weakest(stages) is not None if known is None else not known.is_bounded
        return bool(set_of) and weak and not (inputs.instruments.direct or inputs.instruments.constant)

    def weakness(inputs: VerdictInputs) -> str:
        weakest, F = inputs.weakest(stages) or ("", math.nan)
        sentence = "The instruments do not identify how long the lag is at most."
        if weakest:
            about = f"about the {weakest.replace('_', ' ')}: first-stage F is {F:.1f}"
            needed = f"and {STRONG_FIRST_STAGE:.0f} is needed"
            sentence = f"The instruments carry too little information {about}, {needed}."
        count = len([name for name in inputs.first_stage if name in stages])
        if inputs.single_frequency_hz and count > 2:
            sentence += (
                f" The reference has one frequency ({inputs.single_frequency_hz:.2g} Hz), which identifies "
                f"two of {count} numbers: two frequencies are needed."
            )
        known = inputs.robust.get(set_of)
        if known is not None and not known.is_empty:
            low, high = known.hull
            sentence += f" They leave the {set_of.replace('_', ' ')} {_anywhere(low, high)}."
        return f"{sentence}{inputs.moved}"

    def direct(inputs: VerdictInputs) -> str:
        if not inputs.instruments.missing:
            return "A direct method is biased by disturbances in closed loop."
        return (
            f"No reference can serve as an instrument ({inputs.instruments.missing}), so the numbers come "
            "from nonlinear least squares, which disturbances bias."
        )

    def answering(inputs: VerdictInputs) -> bool:
        chosen = inputs.instruments
        return not (chosen.exogenous or chosen.past_inputs or chosen.direct or chosen.constant)

    def fly(inputs: VerdictInputs) -> str:
        searched = inputs.lag_prior is None and ACTUATOR_LAG.name in inputs.searched
        return f"{words.fly} {GIVE_LAG}" if searched else words.fly

    against = partial(Rule, quantities)
    return (
        against(
            lambda inputs: inputs.instruments.constant,
            Status.REFUSED,
            lambda inputs: f"The reference never moved ({inputs.instruments.missing}).{inputs.moved}",
            words.fly,
            Cause.EXCITATION,
        ),
        against(
            lambda inputs: inputs.instruments.direct and not inputs.instruments.constant,
            Status.PROVISIONAL,
            direct,
            lambda inputs: (
                words.log_reference if inputs.instruments.missing else "Use reference_iv for a verdict."
            ),
            Cause.INSTRUMENT,
        ),
        against(unidentified, Status.REFUSED, weakness, fly, Cause.EXCITATION),
        against(
            lambda inputs: inputs.instruments.past_inputs,
            Status.PROVISIONAL,
            "Past inputs are the instruments: under control they answer past disturbances, which moves "
            "the numbers.",
            words.log_reference,
            Cause.INSTRUMENT,
        ),
        against(
            answering,
            words.of_answers,
            "The instruments answer the vehicle's own disturbances (a setpoint that a position loop "
            "computes).",
            words.log_planned,
        ),
        against(
            lambda inputs: inputs.p_value < CONTRADICTION,
            Status.WEAK,
            lambda inputs: (
                f"The references disagree about the parameters (J p-value {inputs.p_value:.1g}): "
                f"{'the log may lack commands, or ' if inputs.command_slack_s else ''}"
                f"something {words.moves} the vehicle that the model does not have."
            ),
            lambda inputs: f"{GIVE_RATE if inputs.command_slack_s else ''}{words.undisturbed}",
        ),
        against(
            lambda inputs: inputs.lag_prior is not None and inputs.lag_prior.contradicted,
            Status.WEAK,
            lambda inputs: (
                "The lag that was given contradicts the flight: "
                f"{'' if inputs.lag_prior is None else inputs.lag_prior.sentence}."
            ),
            "Check what was given: it is the lag and the delay together, in ms.",
        ),
    )


def end_of_grid_rule(
    nuisance: str,
    quantities: tuple[str, ...],
    sentence: Callable[[float, VerdictInputs], str],
    remedy: Callable[[VerdictInputs], str] | str,
) -> Rule:
    """Row of a lag or a delay that ended at the end of its grid, of which the sentence speaks [s]."""

    def at_the_end(inputs: VerdictInputs) -> bool:
        value, highest = inputs.searched.get(nuisance, (0.0, math.inf))
        return abs(value) >= 0.999 * highest

    return Rule(
        quantities,
        at_the_end,
        Status.WEAK,
        lambda inputs: sentence(inputs.searched[nuisance][1], inputs),
        remedy,
    )


SECOND_STAGE_RULE = Rule(
    STAGES,
    lambda inputs: not inputs.quantities[SECOND_LAG].interval[0] > 0.0,
    Status.WEAK,
    "A second stage of the actuators cannot be distinguished from none: its interval reaches zero.",
    "Fly a sweep, or quicker steps.",
    Cause.ZERO,
)


#: A lag at the bottom of its grid: both parts have the interval of the sum.
UNSPLIT_RULE = Rule(
    (ACTUATOR_LAG.name, DELAY.name),
    lambda inputs: (
        inputs.quantities[ACTUATOR_LAG.name].interval == inputs.quantities[DELAY.name].interval
        and inputs.quantities[DELAY.name].interval[1] > 0.0
    ),
    Status.WEAK,
    "How much of the effective lag is delay cannot be distinguished.",
    "Fly a sweep, or quicker steps.",
)


def lag_rules(limit: Limit, wording: QuantitySpec) -> tuple[Rule, ...]:
    """Rows of the effective lag, of its parts, and of a second stage."""
    parts = (ACTUATOR_LAG.name, DELAY.name, *STAGES)
    return (*limit.rules(EFFECTIVE_LAG, wording, *parts), SECOND_STAGE_RULE, UNSPLIT_RULE)


def longest_lag_rule(quantities: tuple[str, ...], remedy: str) -> Rule:
    """Row of a lag that ended at the longest that is searched."""
    return end_of_grid_rule(
        ACTUATOR_LAG.name,
        quantities,
        lambda highest, _: f"The lag ran into the top of its grid ({highest:.1f} s).",
        remedy,
    )
