"""Tracking of a parameter over a flight."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.recursive import HELD, NORMAL_MEDIAN, ChangeDetector, Follower, Moment
from eivor.estimation.streaming import MEMORIES, Forgetting, TimedRows, counted_rows
from eivor.flights.result import FlightEstimate
from eivor.inference.distributions import normal_quantile
from eivor.inference.random_effects import FEWEST, Grouped, one_group
from eivor.models.lagged_runs import AxisColumns
from eivor.models.separable import Values
from eivor.tools import Float

#: Memory [s] when none is chosen.
MEMORY_S = 5.0
#: Sums are held against the newest estimate: a battery that sags is followed, and is no change.
DETECTOR = ChangeDetector(held_looks=1)
#: Looks between intercepts that are compared: two memories.
LOOKS_APART = 16
#: Memories between residuals that are compared.
LAGS = (1, 2, 4)


@dataclass(frozen=True)
class Track:
    """A parameter over a flight."""

    result: FlightEstimate
    name: str
    unit: str
    memory_s: float  # Sum of the weights of the time before [s]
    nuisances: Values
    moments: tuple[Moment, ...]  # An eighth of the memory apart, in order
    known: tuple[str, ...]

    @property
    def precise_moments(self) -> tuple[Moment, ...]:
        """Those at which the parameter is identified."""
        return tuple(moment for moment in self.moments if moment.is_precise)

    @property
    def changes(self) -> tuple[Moment, ...]:
        """Those after which it was another one."""
        return tuple(moment for moment in self.moments if moment.change)

    def change_at(self, change: Moment) -> tuple[float, float] | None:
        """Change from the memory before a detected one to the memory after it, see `relative_change`."""
        # a change may be as old as the memory: values before that, and within the memory after it
        since = [(moment.time_s - change.time_s, moment) for moment in self.precise_moments]
        before = [moment for seconds, moment in since if seconds < -self.memory_s]
        after = [moment for seconds, moment in since if 0.25 * self.memory_s < seconds < self.memory_s]
        return relative_change(before[-1], after[-1]) if before and after else None


def relative_change(before: Moment, after: Moment) -> tuple[float, float]:
    """Change between two moments as a share of the first, and half its 95 % interval."""
    ratio = after.value / before.value
    half = abs(ratio) * math.hypot(after.half_width / after.value, before.half_width / before.value)
    return ratio - 1.0, half


def track(result: FlightEstimate, memory_s: float | None = None, parameter: str = "") -> Track:
    """Follow a parameter over a flight that was identified; by default the gain of the input."""
    checks.kind("result", result, FlightEstimate, "a FlightEstimate", "Identify the flight first.")
    if memory_s is not None:
        checks.number("memory_s", memory_s)
    if len(result.prepared) != 1:
        raise UsageError("one flight to follow", f"{len(result.prepared)}", "Track the logs one by one.")
    if result.fit is None:
        return Track(result, "", "", MEMORY_S if memory_s is None else memory_s, {}, (), ())
    tracking = result.motion.abilities.tracking
    if tracking is None:
        expected = "a motion with a parameter to follow"
        raise UsageError(expected, f"{result.motion.name}", "The vertical motion and machines have some.")
    tracked_parameter = tracking(result.fit.problem, result.quantities, result.options, parameter)
    (columns,) = tracked_parameter.runs.columns
    length_s = columns.fixed.shape[0] * columns.step_s
    memory_s = min(MEMORY_S, length_s) if memory_s is None else memory_s
    memory = memory_s / columns.step_s
    if not MEMORIES[0] <= memory <= columns.fixed.shape[0] * (1.0 + 1e-12):
        least = f"a memory of {MEMORIES[0] * columns.step_s:g}"
        expected = f"{least} to {length_s:.3g} s, the length of the flight"
        raise UsageError(expected, f"{memory_s:g} s", "Leave it out, or give another.")
    estimate, name = result.fit.estimate, tracked_parameter.name
    parameters = {parameter.name: parameter for parameter in tracked_parameter.runs.parameters}
    level = 0.0 if tracked_parameter.intercept is None else tracked_parameter.intercept.mean
    start = np.array([*(estimate.parameters[each] for each in parameters), level])
    priors = (*(tracked_parameter.known.get(each) for each in parameters), tracked_parameter.intercept)
    rows, forgetting = rows_of(columns, estimate.nuisances), Forgetting(memory)
    follower = Follower(list(parameters).index(name), priors, start, result.prepared[0].grid.time_s)
    follower = with_slow_air(follower, rows, forgetting)
    points = follower.points(rows, forgetting, DETECTOR)
    moments = tuple(point for point in points if math.isfinite(point.value))
    unit, known = parameters[name].unit, tracked_parameter.descriptions
    return Track(result, name, unit, memory_s, estimate.nuisances, moments, known)


def with_slow_air(follower: Follower, rows: TimedRows, forgetting: Forgetting) -> Follower:
    """With the intercept's prior as wide as slow residuals, or narrower by the movement."""
    *priors, intercept = follower.priors
    if intercept is None:
        return follower
    free = replace(follower, index=len(priors), priors=(*priors, None))
    points = [each for each in free.points(rows, forgetting, DETECTOR) if math.isfinite(each.half_width)]
    apart = points[LOOKS_APART - 1 :: LOOKS_APART]
    variance = slow_variance(rows, follower.start, round(forgetting.memory))
    if len(apart) >= FEWEST:
        values, halves = np.array([(each.value, each.half_width) for each in apart]).T
        intercepts = Grouped(one_group(values.size), values, (halves / normal_quantile(0.95)) ** 2)
        variance = min(variance, float(intercepts.q_profile(0.8)[1][0]))
    return replace(
        follower, priors=(*priors, replace(intercept, std=math.hypot(intercept.std, variance**0.5)))
    )


def slow_variance(rows: TimedRows, theta: Float[np.ndarray, " n"], memory: int) -> float:
    """Variance of residuals' means over memories about a line; a single step hardly enters."""
    _, right, _, counted = rows.parts
    residuals = np.column_stack([counted, right[:, -1:] - right[:, :-1] @ theta[:, None]])
    whole = rows.count // memory * memory
    counts, sums = residuals[:whole].reshape(-1, memory, 2).sum(axis=1).T
    (held,) = np.nonzero(counts >= HELD * memory)
    if held.size <= 2 * LAGS[-1]:
        return 0.0
    means = sums[held] / counts[held]
    away = means - np.polyval(np.polyfit(held, means, 1), held)
    return 0.5 * max(NORMAL_MEDIAN * float(np.median(np.abs(away[lag:] - away[:-lag]))) for lag in LAGS) ** 2


def rows_of(columns: AxisColumns, nuisance_values: Values) -> TimedRows:
    """Rows of every sample of a flight, with an intercept that is its own instrument."""
    count, moving = columns.fixed.shape[0], columns.moving(nuisance_values)
    used = np.zeros(count, dtype=np.bool_)
    for run in columns.runs:
        counted = columns.counted(run)
        used[run] = True if counted is None else counted
    entries = np.ones((count, 1))
    away = columns.instruments - columns.instruments[used].mean(axis=0)
    right = np.column_stack([columns.fixed, moving, entries, columns.responses[:, :1]])
    return counted_rows(np.column_stack([away, entries]), right, np.zeros((count, 0)), used)
