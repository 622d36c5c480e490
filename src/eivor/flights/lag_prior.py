"""Prior knowledge of the actuator lag: from rates, telemetry or the user."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import hypot, sqrt

import msgspec
import numpy as np

from eivor.errors import EstimationError
from eivor.estimation.estimate import Estimate, ratio
from eivor.estimation.methods import identify, least_squares
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import NAN, NO_INTERVAL, QuantityEstimate, QuantitySpec
from eivor.inference.diagnostics.record import BEYOND_DOUBT, outcome_word
from eivor.inference.distributions import chi_square_tail
from eivor.models import lagged_runs
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.regression import Parameter
from eivor.models.separable import Bounds, Prior, SeparableProblem, Values
from eivor.signals.filters import actuator_state
from eivor.signals.recording import Channel
from eivor.strict_toml import package_tables
from eivor.tools import Float

#: Sum of lag and delay, which a flight identifies better than either.
EFFECTIVE_LAG = "effective_lag"
#: The nuisances of which each lag is the sum.
LAG_SUMS = {
    ACTUATOR_LAG.name: (ACTUATOR_LAG.name,),
    DELAY.name: (DELAY.name,),
    EFFECTIVE_LAG: (ACTUATOR_LAG.name, DELAY.name),
}
LEVEL = 0.95

#: Lags as all motions call them, and the same as specifications.
LAG_TABLES = package_tables("eivor.flights", "lags.toml")
LAG_QUANTITIES = msgspec.convert(LAG_TABLES, dict[str, QuantitySpec])


def joint_quantities(estimate: Estimate) -> dict[str, QuantityEstimate]:
    """Every parameter of the joint vector."""
    return {
        name: QuantityEstimate(
            estimate.parameters[name], unit, estimate.std_error(name), estimate.interval(name)
        )
        for name, unit in zip(estimate.names, estimate.units, strict=True)
    }


def ratio_quantity(
    estimate: Estimate, numerator: str | float, denominator: str, unit: str
) -> QuantityEstimate:
    """Ratio of two parameters, or of a number and a parameter, see `eivor.ratio`."""
    parameters, divisor = estimate.parameters, estimate.parameters[denominator]
    dividend = parameters[numerator] if isinstance(numerator, str) else float(numerator)
    interval = ratio(estimate, numerator, denominator).hull
    if not divisor:
        return QuantityEstimate(NAN, unit, NAN, interval)
    gradient = -dividend / divisor**2 * estimate.direction(denominator)
    if isinstance(numerator, str):
        gradient = gradient + estimate.direction(numerator) / divisor
    return QuantityEstimate(dividend / divisor, unit, estimate.joint_covariance.std_error(gradient), interval)


def reciprocal(original: QuantityEstimate, unit: str) -> QuantityEstimate:
    """One over a quantity; without bounds where its interval is not to one side of zero."""
    low, high = original.interval
    excludes_zero = low > 0.0 or high < 0.0
    interval = (1.0 / high, 1.0 / low) if excludes_zero else NO_INTERVAL
    if not original.value:
        return QuantityEstimate(NAN, unit, NAN, interval)
    return QuantityEstimate(1.0 / original.value, unit, original.std_error / original.value**2, interval)


def linear_quantity(
    estimate: Estimate, unit: str, value: float, gradient: Float[np.ndarray, " n"], variance: float = 0.0
) -> QuantityEstimate:
    """Quantity with a gradient in the joint vector, and an additional variance."""
    covariance = estimate.joint_covariance
    half_width = covariance.half_width(gradient, LEVEL, variance)
    error = hypot(covariance.std_error(gradient), sqrt(variance))
    return QuantityEstimate(value, unit, error, (value - half_width, value + half_width))


def limited_by_sum(
    estimates: Mapping[str, QuantityEstimate], *, unsplit: bool = False
) -> dict[str, QuantityEstimate]:
    """Quantities with lag and delay limited by their sum; `unsplit` extends both to it."""
    names = [name for name in LAG_SUMS[EFFECTIVE_LAG] if name in estimates]
    results = dict(estimates)
    if EFFECTIVE_LAG in estimates and all(estimates[name].lowest == 0.0 for name in names):
        for name in names:
            low, high = estimates[name].interval
            highest = max(estimates[EFFECTIVE_LAG].interval[1], estimates[name].value)
            ends = (0.0, highest) if unsplit else (low, min(high, highest))
            results[name] = replace(estimates[name], interval=ends)
    return results


def lag_quantities(problem: SeparableProblem, estimate: Estimate) -> dict[str, QuantityEstimate]:
    """Lag, delay and their sum, zero for what was not searched for; two lags in series, or up and down."""
    joint = joint_quantities(estimate)
    fixed = {item.name: item.first for item in problem.nuisances if item.name not in joint}
    joint |= {name: QuantityEstimate(value, "s", 0.0, (value, value)) for name, value in fixed.items()}
    lag, delay = replace(joint[ACTUATOR_LAG.name], lowest=0.0), joint[DELAY.name]
    if all(item.first >= 0.0 for item in problem.nuisances if item.name == DELAY.name):  # of commands
        delay = replace(delay, lowest=0.0)
    value, searched = lag.value + delay.value, [name for name in LAG_SUMS[EFFECTIVE_LAG] if name not in fixed]
    if len(searched) == 2:
        gradient = np.sum([*map(estimate.direction, searched)], axis=0)
        effective = replace(linear_quantity(estimate, "s", value, gradient), lowest=0.0)
    else:
        single = joint[searched[0]] if searched else lag
        low, high = (end + (value - single.value) for end in single.interval)
        effective = replace(single, value=value, interval=(low, high), lowest=delay.lowest)
    quantities = {ACTUATOR_LAG.name: lag, DELAY.name: delay, EFFECTIVE_LAG: effective}
    if lagged_runs.SECOND_STAGE.name in joint and lag.value > 0.0:
        low, high = joint[lagged_runs.SECOND_STAGE.name].interval
        stage = replace(joint[lagged_runs.SECOND_STAGE.name], interval=(max(low, 0.0), min(high, 0.25)))
        ends = np.array([stage.value, *stage.interval])
        second, low, high = (0.5 * lag.value * (1.0 - np.sqrt(1.0 - 4.0 * ends))).tolist()
        error = 0.5 * (high - low) / NORMAL_QUANTILE
        quantities[lagged_runs.SECOND_LAG] = QuantityEstimate(second, "s", error, (low, high), lowest=0.0)
        quantities[lagged_runs.SECOND_STAGE.name] = stage
    if lagged_runs.ASYMMETRY.name in joint:
        quantities[lagged_runs.ASYMMETRY.name] = joint[lagged_runs.ASYMMETRY.name]
        for name, sign in zip(lagged_runs.LAGS_UP_AND_DOWN, (1.0, -1.0), strict=True):
            share = 1.0 / (1.0 + sign * joint[lagged_runs.ASYMMETRY.name].value)
            by_lag, by_asymmetry = map(estimate.direction, (ACTUATOR_LAG.name, lagged_runs.ASYMMETRY.name))
            direction = share * by_lag - sign * lag.value * share**2 * by_asymmetry
            quantities[name] = replace(
                linear_quantity(estimate, "s", share * lag.value, direction), lowest=0.0
            )
    return quantities


NO_LAG = Bounds(0.0, 0.0)
#: Lags of rotors by class of vehicle, as published, for `--lag typical:CLASS`.
TYPICAL_LAGS: dict[str, Prior | Bounds] = {
    "nano": Prior(0.072, 0.015),  # 71.6 ms, a Crazyflie of 27 g (Eschmann et al. 2024, arXiv:2404.07837)
    # racers with propellers of 3 and 5 inches (Ferede et al. 2025, arXiv:2504.21586)
    "5in": Bounds(0.010, 0.100),
    "multirotor": Bounds(0.030, 0.100),  # from 20 g to 5 kg (Eschmann et al. 2025, arXiv:2509.11481)
}
NO_FLIGHT_LAG = QuantityEstimate(NAN, "s", NAN, NO_INTERVAL)
#: Standard error of a lag that is known exactly [s].
EXACT_S = 1e-4
#: Standard deviation of a uniform distribution, as a share of its half-width.
UNIFORM_STD = 3.0**-0.5
#: Half of a normal 95 % interval, in standard deviations.
NORMAL_QUANTILE = 1.96


@dataclass(frozen=True)
class LagPrior:
    """Prior knowledge of a lag, and the lag by the flight alone."""

    known: Prior | Bounds  # [s]
    #: [s]; NaN where the instruments are too few for a lag
    flight_lag: QuantityEstimate = NO_FLIGHT_LAG
    slack_s: float = 0.0
    strong: bool = False  # The flight's own interval holds: its instruments are strong
    source: str = ""  # "telemetry", or the name of a motion; empty where a user gave it
    who: str = ""  # The same in words
    #: By the source: lag and delay together, as they were estimated, systematic parts included [s]
    measured: QuantityEstimate | None = None
    why_wider: str = ""  # Why more is not known, after "with"

    @classmethod
    def by_measurement(
        cls, source: str, who: str, measured: QuantityEstimate, apart_s: float, why_wider: str
    ) -> LagPrior:
        """Prior by telemetry or another motion, with half of its 95 % interval as two standard errors."""
        std_error = max(0.5 * measured.half_width, measured.std_error)
        known = Prior(measured.value, hypot(std_error, apart_s))
        return cls(known, source=source, who=who, measured=measured, why_wider=why_wider)

    @property
    def std(self) -> float:
        """Standard deviation of the prior [s], with the command's lateness."""
        known = self.known
        std = known.std if isinstance(known, Prior) else UNIFORM_STD * 0.5 * (known.high - known.low)
        return hypot(std, self.slack_s * UNIFORM_STD)

    @property
    def for_the_log(self) -> Prior | Bounds:
        """Prior of the lag as logged, which includes the command's lateness."""
        known = self.known
        if known == NO_LAG:
            return known
        if isinstance(known, Prior):
            return replace(known, std=self.std)
        low, high = self._ends(known)
        own_low, own_high = self.flight_lag.interval if self.strong else (low, high)
        limits = max(low, own_low), min(high, own_high)
        return Bounds(*limits) if limits[0] < limits[1] else Bounds(low, high)

    def _ends(self, bounds: Bounds) -> tuple[float, float]:
        """Bounds that were given, widened by the command's lateness."""
        return max(bounds.low - self.slack_s, 0.0), bounds.high + self.slack_s

    @property
    def p_value(self) -> float:
        """P-value of the test that prior and flight agree in the lag."""
        known, flight = self.known, self.flight_lag
        if math.isnan(flight.value):
            return 1.0
        if isinstance(known, Prior):
            difference, variance = flight.value - known.mean, flight.std_error**2 + known.std**2
        else:
            difference = flight.value - min(max(flight.value, known.low), known.high)
            variance = flight.std_error**2
        variance += (self.slack_s * UNIFORM_STD) ** 2
        return chi_square_tail(difference**2 / variance, 1) if difference else 1.0

    @property
    def contradicted(self) -> bool:
        """Whether prior and flight differ beyond doubt."""
        return self.p_value <= BEYOND_DOUBT

    @property
    def closer_alone(self) -> bool:
        """Whether the flight's own interval lies within the bounds, which then add nothing."""
        known, (low, high) = self.known, self.flight_lag.interval
        return self.strong and isinstance(known, Bounds) and known.low < low and high < known.high

    def limited(self, interval: tuple[float, float], value: float) -> tuple[float, float]:
        """Interval limited by the prior, or extended to the flight's own lag where they differ."""
        known = self.known
        if known == NO_LAG:
            return interval
        if isinstance(known, Prior):
            low, high = known.mean - NORMAL_QUANTILE * self.std, known.mean + NORMAL_QUANTILE * self.std
        else:  # the flight's own interval is no such end: it has no systematic parts
            low, high = self._ends(known)
        if low <= value <= high and self.p_value >= 1.0 - LEVEL:
            return max(interval[0], low), min(interval[1], high)
        flight = self.flight_lag.value if math.isfinite(self.flight_lag.value) else value
        return min(interval[0], flight), max(interval[1], flight)

    @property
    def given(self) -> str:
        """The prior in words."""
        if isinstance(self.known, Prior):
            value = f"{1e3 * self.known.mean:.3g}"
            std = f"± {1e3 * self.known.std:.2g} ms (one standard deviation)"
            if self.measured is None:
                return f"{value} {std}"
            low, high = (1e3 * max(end, 0.0) for end in self.measured.interval)
            return f"{value} [{low:.3g}, {high:.3g}] ms, with {self.why_wider} {std}"
        if self.known == NO_LAG:
            return "neither lag nor delay"
        if self.known.low == self.known.high:
            return f"{1e3 * self.known.low:.3g} ms exactly"
        return f"{1e3 * self.known.low:.3g} to {1e3 * self.known.high:.3g} ms"

    @property
    def sentence(self) -> str:
        """The prior, the flight's own lag, and whether they agree."""
        who = f"{self.who} says" if self.who else "given"
        if math.isnan(self.flight_lag.value):
            return f"{who} {self.given}; the flight alone has too few instruments for a lag"
        low, high = self.flight_lag.interval
        low, high = (1e3 * max(end, 0.0) for end in (low - self.slack_s, high + self.slack_s))
        closer = ", and the flight alone is closer" if self.closer_alone else ""
        words = ("agree", "may contradict each other", "contradict each other")
        return (
            f"{who} {self.given}; "
            f"the flight alone says {1e3 * self.flight_lag.value:.3g} [{low:.3g}, {high:.3g}] ms: "
            f"they {outcome_word(self.p_value, words)}{closer}"
        )


def with_lag_prior(problem: SeparableProblem, known: Prior | Bounds) -> SeparableProblem:
    """Return the problem with a prior of the sum of lag and delay."""
    nuisances = {nuisance.name: nuisance for nuisance in problem.nuisances}
    if known == NO_LAG:
        lags = (*LAG_SUMS, lagged_runs.SECOND_STAGE.name)
        nuisances |= {name: item.known_at(0.0) for name, item in nuisances.items() if name in lags}
    elif ACTUATOR_LAG.name in nuisances:
        if isinstance(known, Bounds):
            half_width = 0.5 * (known.high - known.low)
            known = Prior(known.low + half_width, max(UNIFORM_STD * half_width, EXACT_S))
        lag = replace(nuisances[ACTUATOR_LAG.name], prior=known, known_with=(DELAY.name,))
        nuisances[ACTUATOR_LAG.name] = lag
    return problem.with_nuisances(tuple(nuisances.values()))


def lag_searched(problem: SeparableProblem) -> bool:
    """Whether the problem has an actuators' lag to search."""
    return any(nuisance.name == ACTUATOR_LAG.name and nuisance.searched for nuisance in problem.nuisances)


TELEMETRY = "telemetry"
#: Slower telemetry identifies no lag [Hz]: that of 20 Hz does.
TELEMETRY_RATE_HZ = 19.5
#: Standard deviation of telemetry's own delay [s]; that of a time within its period is added.
OWN_DELAY_S = 0.015
#: Telemetry follows the commands when its residual is less than this share of its variance.
LARGEST_RESIDUAL_SHARE = 0.5

SLOPE, CURVATURE = Parameter("telemetry_slope", ""), Parameter("telemetry_curvature", "")


def telemetry_lag(flights: tuple[PreparedFlight, ...], families: tuple[str, ...]) -> LagPrior | None:
    """Lag of the actuators by the telemetry of flights that have it: the first family that the log has."""
    columns: list[lagged_runs.AxisColumns] = []
    for number, flight in enumerate(flights):
        channels = next(filter(None, map(flight.recording.family, families)), [])
        fast = all(channel.rate_hz >= TELEMETRY_RATE_HZ for channel in channels)
        if channels and fast and not flight.input.measured:
            columns.append(_columns(number, flight.shortened, channels))
    if not any(column.runs for column in columns):
        return None
    problem = lagged_runs.LaggedRuns(tuple(columns), (SLOPE, CURVATURE), lagged_runs.lag_and_delay())
    try:
        estimate = identify(problem, least_squares())
        lag_quantity = lag_quantities(problem, estimate)[EFFECTIVE_LAG]
    except EstimationError:
        return None
    response = estimate.rows.response
    residual_share = float(estimate.residuals @ estimate.residuals) / float(response @ response)
    at_grid_end = estimate.nuisances[ACTUATOR_LAG.name] >= 0.999 * lagged_runs.LAG_GRID_S[-1]
    if not residual_share < LARGEST_RESIDUAL_SHARE or at_grid_end or not np.isfinite(lag_quantity.half_width):
        return None
    own_delay_s = hypot(OWN_DELAY_S, max(column.step_s for column in columns) / sqrt(12.0))
    return LagPrior.by_measurement(
        TELEMETRY, "telemetry of the actuators", lag_quantity, own_delay_s, "a delay of its own"
    )


def _columns(number: int, flight: PreparedFlight, channels: list[Channel]) -> lagged_runs.AxisColumns:
    """Mean telemetry at the stamps of its first channel, with the runs of the flight."""
    masks = [(channel, np.isfinite(channel.values)) for channel in channels]
    known = [(channel.time_s[good], channel.values[good]) for channel, good in masks if good.any()]
    time_s = known[0][0] if known else np.empty(0)
    mean = np.mean([np.interp(time_s, *item) for item in known], axis=0) if known else time_s
    commands, grid = flight.signals.family(flight.input.name), flight.grid

    def lagged_parabola(values: Values) -> Float[np.ndarray, "n 2"]:
        lag_s, delay_s = values[ACTUATOR_LAG.name], values[DELAY.name]
        state = actuator_state(commands, step_s=grid.step_s, lag_s=lag_s, delay_s=delay_s).mean(axis=1)
        deviation = np.interp(time_s, grid.time_s, state) - commands.mean()
        return np.column_stack([deviation, deviation**2])

    ends = [np.searchsorted(time_s, grid.time_s[[run.start, run.stop - 1]]).tolist() for run in flight.runs]
    return lagged_runs.AxisColumns(
        step_s=1.0 / channels[0].rate_hz,
        runs=tuple(slice(first, last) for first, last in ends if last - first > 2),
        responses=mean[:, None],
        fixed=np.empty((time_s.size, 0)),
        moving=lagged_parabola,
        instruments=np.empty((time_s.size, 0)),
        flight=number,
    )
