"""Analysis of a fleet: pooled quantities, changes over time and queries."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy import special, stats

from eivor.errors import UsageError, did_you_mean
from eivor.fleet import change_points
from eivor.fleet import table as fleet_table
from eivor.fleet.logs import with_covariates
from eivor.flights.motion import Motion
from eivor.flights.quantity import AcrossFlights, Covariate
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.distributions import normal_quantile
from eivor.inference.random_effects import Grouped, Groups, Rows, between_distribution
from eivor.inference.verdict import Status
from eivor.motions.table import motion_by_name
from eivor.process_pool import useful_workers
from eivor.tools import Bool, Float

#: Type of a flight whose type is not known, and what stands before the name of a log that has no vehicle.
UNKNOWN, LOG = "unknown", "log "
HOUR_S = 3600.0
#: Columns by which rows belong together.
VEHICLE = ("type", "vehicle")
#: Columns of ordered rows: with which vehicles a vehicle is pooled, which is its type where both are known
#: and the vehicle alone elsewhere; and whether the log has no vehicle.
TOGETHER, SINGLE = "together", "single"
#: Column of rows of a quantity: whether it is a share, below `AcrossFlights.largest`.
SHARE = "is_share"


def across_of(motion: Motion[Any], further: Sequence[str] = ()) -> tuple[AcrossFlights, ...]:
    """Quantities that a motion compares over flights: those that it names, or else its headline."""
    headline = (AcrossFlights(name, identified_by=(name,)) for name in motion.quantities.headline)
    result = []
    for across in motion.quantities.across or headline:
        listed = {item.name for item in across.covariates}
        added = (Covariate(name) for name in further if name not in listed)
        result.append(replace(across, covariates=(*across.covariates, *added)))
    return tuple(result)


def report_columns(across: Sequence[AcrossFlights]) -> list[str]:
    """Columns of a fleet's table that its report reads."""
    columns = ["sha256", "name", "motion", *VEHICLE, "start", "duration_s", "verdict"]
    columns += [
        f"{item.name}.{part}" for item in across for part in (*fleet_table.NUMBERS, fleet_table.VERDICT)
    ]
    columns += [
        f"{fleet_table.DIAGNOSTIC}first_stage_F_{name}" for item in across for name in item.identified_by
    ]
    columns += [covariate.name for item in across for covariate in item.covariates]
    return list(dict.fromkeys(columns))


def in_order(table: pl.DataFrame) -> pl.DataFrame:
    """Rows by type, vehicle and time, without copies."""
    duration = pl.col("duration_s").fill_null(0.0)
    kind, vehicle = (pl.col(name).cast(pl.String) for name in VEHICLE)
    earlier = pl.when(pl.col("name").is_duplicated()).then(pl.format(" {}", pl.col("sha256").str.head(12)))
    log = pl.concat_str(pl.lit(LOG), "name", earlier.fill_null(""))  # of a log that changed
    by_vehicle = pl.concat_str(pl.col("type"), pl.lit("\n"), pl.col("vehicle"))
    return (
        table.filter(pl.col("verdict") != fleet_table.COPY)
        .with_columns(
            kind.fill_null(UNKNOWN),
            vehicle.fill_null(log),
            vehicle.is_null().alias(SINGLE),
            (kind.is_null() | vehicle.is_null()).alias(TOGETHER),
        )
        .sort(SINGLE, "type", TOGETHER, "vehicle", "start", "name", nulls_last=True)
        .with_columns(pl.when(TOGETHER).then(by_vehicle).otherwise("type").alias(TOGETHER))
        .with_columns(((duration.cum_sum() - 0.5 * duration) / HOUR_S).over(VEHICLE).alias("hours"))
    )


def omission_reason(across: AcrossFlights, columns: Sequence[str]) -> pl.Expr:
    """Reason for which a row is left out for a quantity; null where it is used."""
    value, error = pl.col(f"{across.name}.value"), _error(across)
    texts = [f"{fleet_table.DIAGNOSTIC}first_stage_F_{name}" for name in across.identified_by]
    weak = [pl.col(name) < STRONG_FIRST_STAGE for name in texts if name in columns]
    no_number = value.is_null() | error.is_null() | (error <= 0.0)
    not_excited = pl.any_horizontal(pl.lit(False), *weak)
    provisional = pl.col(f"{across.name}.verdict").cast(pl.String) == Status.PROVISIONAL.value
    reasons = {
        "the log gave no result": pl.col("verdict") == fleet_table.FAILED,
        "the flight identifies no value with a standard error": no_number,
        "no reference: the value may be biased more than its interval says": provisional,
        f"too little excitation: a first-stage F below {STRONG_FIRST_STAGE:.0f}": not_excited,
        "not positive": (value <= 0.0) & across.logarithm,
        f"not below {across.largest:g}, the largest share": pl.col(SHARE) & (value >= across.largest),
    }
    return pl.coalesce(pl.when(condition).then(pl.lit(reason)) for reason, condition in reasons.items())


def is_share(across: AcrossFlights) -> pl.Expr:
    """`SHARE` of ordered rows: whether the median positive value of each pool is below the largest share."""
    value = pl.col(f"{across.name}.value")
    share = value.filter(value > 0.0).median().over(TOGETHER) < across.largest
    return (share.fill_null(value=False) & math.isfinite(across.largest)).alias(SHARE)


def compared(across: AcrossFlights) -> tuple[pl.Expr, pl.Expr]:
    """The number of which changes are compared, and its variance."""
    value, error = pl.col(f"{across.name}.value"), _error(across)
    return (value.log(), (error / value) ** 2) if across.logarithm else (value, error**2)


def pooled(across: AcrossFlights) -> tuple[pl.Expr, pl.Expr]:
    """The number that is pooled, and its variance: as `compared`, of a share its logit."""
    y, v = compared(across)
    margin = across.largest - pl.col(f"{across.name}.value")
    logit = y - margin.log(), v * (across.largest / margin) ** 2
    return pl.when(SHARE).then(logit[0]).otherwise(y), pl.when(SHARE).then(logit[1]).otherwise(v)


def flight_interval(across: AcrossFlights) -> tuple[pl.Expr, pl.Expr]:
    """`low` and `high` that a flight identifies by itself, or by its standard error; within the bounds."""
    value, half = pl.col(f"{across.name}.value"), normal_quantile(0.95) * _error(across)
    low, high = (
        pl.coalesce(pl.col(f"{across.name}.{end}").fill_nan(None), by_error).alias(end)
        for end, by_error in (("low", value - half), ("high", value + half))
    )
    if across.logarithm:
        top = pl.when(SHARE).then(across.largest).otherwise(math.inf)
        low, high = low.clip(lower_bound=0.0), pl.min_horizontal(high, top).alias("high")
    return low, high


def _error(across: AcrossFlights) -> pl.Expr:
    half = 0.5 * (pl.col(f"{across.name}.high") - pl.col(f"{across.name}.low"))
    return pl.coalesce(pl.col(f"{across.name}.std_error"), half / normal_quantile(0.95))


def _arrays(rows: pl.DataFrame, expressions: tuple[pl.Expr, pl.Expr]) -> tuple[Rows, Rows]:
    first, second = (rows.select(item).to_series().to_numpy() for item in expressions)
    return first, second


def groups_of(rows: pl.DataFrame, *by: str) -> tuple[pl.DataFrame, Groups]:
    """Groups of adjacent rows, with their keys."""
    begins = [pl.col(name).ne_missing(pl.col(name).shift()) for name in by]
    first = rows.select(pl.any_horizontal(begins) | (pl.int_range(pl.len()) == 0)).to_series().arg_true()
    ends = np.append(first.to_numpy()[1:], rows.height)
    return rows.select(by)[first], Groups((ends - first.to_numpy()).astype(np.int64))


#: Share of vehicles without change that may be said to change; share of those reported to differ that
#: may not.
LEVEL = 0.05
#: Flights with a time, at least, for a course to be reported; vehicles of a type, at least, for one to
#: differ.
FEWEST_FLIGHTS, FEWEST_VEHICLES = 6, 4
#: Share of flights that must know a covariate for it to be used.
KNOWN = 0.8
#: Squares that a step has to explain beyond a drift, since its time was searched for.
SEARCHED = 5.0
#: A logarithm of a covariate that lies so near to the mean of its type differs from it by rounding only.
ROUNDING = 1e-9
STEADY, DRIFTS, STEPS = "steady", "drifts", "steps"


def _about_the_type(name: str) -> pl.Expr:
    """Logarithm of a covariate about that of the type; zero where it is not known or does not vary."""
    log = pl.when(pl.col(name) > 0.0).then(pl.col(name)).log()
    about = log - log.mean().over(TOGETHER)
    return pl.when(about.abs() > ROUNDING).then(about).otherwise(0.0)


@dataclass(frozen=True)
class FleetTrend:
    """Drifts and steps of one quantity, without the effect of covariates."""

    about: pl.DataFrame  # `type` and `vehicle` of each group
    ordered: change_points.Ordered  # estimates at the mean conditions of their type
    vehicles: Groups  # sets of groups that are pooled
    sets: pl.Series  # key of each set
    used: tuple[Covariate, ...]  # covariates, in the order of the slopes
    slopes: Float[np.ndarray, "sets p"]
    slopes_covariance: Float[np.ndarray, "sets p p"]
    drifts: change_points.Drifts
    steps: change_points.BestSteps

    @property
    def enough_flights(self) -> np.ndarray:
        """Vehicles with enough flights for a course to be reported, shape (vehicles,)."""
        return self.ordered.groups.sizes >= FEWEST_FLIGHTS

    def form(self, tests: Float[np.ndarray, " vehicles"]) -> np.ndarray:
        """Form of each vehicle's course: `STEADY`, `DRIFTS` or `STEPS`."""
        p_drift, p_step = self.drifts.p_values * tests, self.steps.p_values * tests
        scale = self.ordered.scale(self.steps.squares, 2)
        by_step = self.steps.squares + SEARCHED * scale < self.drifts.squares
        form = np.where((p_drift <= LEVEL) & ((p_step > LEVEL) | ~by_step), DRIFTS, STEADY)
        form = np.where((p_step <= LEVEL) & ((p_drift > LEVEL) | by_step), STEPS, form)
        return np.where(self.enough_flights, form, "")

    def deviations(self, form: np.ndarray) -> tuple[Rows, Rows]:
        """P-values of flights about the form of their vehicle, and that form."""
        ordered, groups = self.ordered, self.ordered.groups
        total = groups.sums(ordered.weights)
        mean = groups.spread(groups.sums(ordered.weights * ordered.y) / total)
        line, leverage = mean, ordered.weights / groups.spread(total)
        row_forms = np.repeat(form, groups.sizes)
        for name, change in ((DRIFTS, self.drifts), (STEPS, self.steps)):
            line = np.where(row_forms == name, change.line, line)
            leverage = np.where(row_forms == name, change.leverage, leverage)
        parameters = np.where(form == STEADY, 1.0, 2.0)
        p_values = change_points.deviation_p_values(ordered, line, leverage, parameters)
        return np.where(np.repeat(self.enough_flights, groups.sizes), p_values, 1.0), line


def trend(rows: pl.DataFrame, across: AcrossFlights) -> FleetTrend:
    """Drifts and steps of every vehicle."""
    about, groups = groups_of(rows, *VEHICLE, TOGETHER)
    sets, vehicles = groups_of(about, "type", TOGETHER)
    y, v = _arrays(rows, compared(across))
    hours = rows["hours"].to_numpy()
    numeric = {name for name, kind in rows.schema.items() if kind.is_numeric()}
    used = tuple(
        item
        for item in across.covariates
        if item.name in numeric and (rows[item.name] > 0.0).sum() >= KNOWN * max(rows.height, 1)
    )
    x = rows.select(_about_the_type(item.name).alias(item.name) for item in used).to_numpy()
    x = x.T.reshape(len(used), rows.height).astype(float)
    if not across.logarithm:  # the mean of its type turns the power of a covariate into a slope of the value
        first, total = (vehicles.sums(groups.sums(item)) for item in (y / v, 1.0 / v))
        x *= groups.spread(vehicles.spread(first / total))
    expected = np.array([item.slope for item in used]), np.array([item.uncertainty for item in used])
    isolation = change_points.outlier_test(groups, vehicles, v)

    def without_covariates(
        errors: Rows, previous: Float[np.ndarray, " groups"], trends: Float[np.ndarray, "c rows"]
    ) -> tuple[change_points.Ordered, tuple[np.ndarray, np.ndarray], Float[np.ndarray, " groups"]]:
        """Estimates without covariates, by the errors and the variance between of the last step."""
        first_weights = Grouped(groups, y, errors).weights(previous)
        slopes = change_points.shared_slopes(groups, vehicles, y, first_weights, trends, x, *expected)
        group_slopes, covariance = (np.repeat(item, vehicles.sizes, axis=0) for item in slopes)
        level = y - np.einsum("pr,rp->r", x, np.repeat(group_slopes, groups.sizes, axis=0))
        if used:
            errors = v + isolation(level)
        grouped = Grouped(groups, level, errors)
        updated = grouped.paule_mandel(vehicles, previous)  # common to a type
        weights = grouped.weights(updated), replace(grouped, v=v).weights(updated)
        return change_points.Ordered(groups, level, errors, *weights, hours, x, covariance), slopes, updated

    variance = Grouped(groups, y, v).paule_mandel(vehicles)
    ordered, slopes, variance = without_covariates(v + isolation(y), variance, hours[None, :])
    if used:  # again, with the step that was detected
        both = np.stack([hours, change_points.steps(ordered).after])
        ordered, slopes, _ = without_covariates(ordered.errors, variance, both)
    changes = change_points.drifts(ordered), change_points.steps(ordered)
    return FleetTrend(about.select(VEHICLE), ordered, vehicles, sets[TOGETHER], used, *slopes, *changes)


def differing_p_values(result: FleetTrend) -> Float[np.ndarray, " vehicles"]:
    """P-values of vehicles against the others of their type; not a number where there are too few."""
    ordered, vehicles = result.ordered, result.vehicles
    groups, w = ordered.groups, ordered.weights
    total = groups.sums(w)
    means = groups.sums(w * ordered.y) / total
    scatter = groups.sums(w * (ordered.y - groups.spread(means)) ** 2) / np.maximum(groups.sizes - 1, 1)
    errors = np.maximum(scatter, 1.0) / total
    of_vehicles = Grouped(vehicles, means, errors)
    position = of_vehicles.weighted(of_vehicles.paule_mandel())
    w, none, covariance = position.weights, np.zeros((0, means.size)), np.zeros((vehicles.sizes.size, 0, 0))
    about = change_points.Ordered(vehicles, means, errors, w, w, none.sum(axis=0), none, covariance)
    line, leverage = vehicles.spread(position.mean), w / vehicles.spread(position.total)
    p_values = change_points.deviation_p_values(about, line, leverage, np.ones(vehicles.sizes.size))
    return np.where(vehicles.spread(vehicles.sizes.astype(float)) >= FEWEST_VEHICLES, p_values, np.nan)


#: Columns of a mean: the value with its interval, the standard deviation between members with its own, and
#: the interval of the next member. Of logarithms the deviation is a share of the value.
POOLED = ("mean", "low", "high", "between", "between_low", "between_high", "next_low", "next_high")
#: The interval of a vehicle's only flight, as that flight identifies it.
ONLY = ("only_low", "only_high")


def pooled_vehicles(rows: pl.DataFrame, across: AcrossFlights) -> pl.DataFrame:
    """Each vehicle's mean over its flights: `type`, `vehicle`, `pooled` (how many), `POOLED` and `ONLY`."""
    about, groups = groups_of(rows, *VEHICLE)
    grouped = Grouped(groups, *_arrays(rows, pooled(across)))
    first = rows[groups.starts].select(flight_interval(across))
    only = (
        pl.when(pl.Series(groups.sizes == 1)).then(first[end]).alias(name)
        for name, end in zip(ONLY, first.columns, strict=True)
    )
    shares = rows[SHARE].to_numpy()[groups.starts]
    return _report(about, grouped, across, shares).with_columns(*only)


def _report(
    about: pl.DataFrame, grouped: Grouped, across: AcrossFlights, shares: Bool[np.ndarray, " groups"]
) -> pl.DataFrame:
    means, distribution = grouped.means(grouped.paule_mandel()), between_distribution(grouped)
    half, next_half_widths = distribution.mean_half_widths(means), distribution.next_half_widths(means.value)
    low, high = grouped.q_profile(near=means.between)
    offsets = [sign * item for item in (half, next_half_widths) for sign in (-1.0, 1.0)]
    ends = np.stack([means.value, *(means.value + item for item in offsets)])
    largest = across.largest
    if across.logarithm:
        with np.errstate(over="ignore"):
            ends[:, ~shares] = np.exp(ends[:, ~shares])
    ends[:, shares] = np.where(np.isfinite(ends[:, shares]), largest * special.expit(ends[:, shares]), np.nan)
    mean, mean_low, mean_high, next_low, next_high = ends
    between = np.sqrt([means.between, low, high])
    between[:, shares] *= 1.0 - mean[shares] / largest  # a share of the value, not of the odds
    columns = (mean, mean_low, mean_high, *between, next_low, next_high)
    bounded = np.isfinite(half)
    numbers = (
        _known_series(name, number, np.isfinite(number) & (bounded | (name == "mean")))
        for name, number in zip(POOLED, columns, strict=True)
    )
    return about.with_columns(pl.Series("pooled", grouped.groups.sizes), *numbers)


def _known_series(name: str, numbers: Rows, is_known: np.ndarray) -> pl.Series:
    return pl.Series(name, np.where(is_known, numbers, np.nan)).fill_nan(None)


def _vehicles(table: pl.DataFrame) -> pl.DataFrame:
    own_result = pl.col("verdict").is_in((fleet_table.COPY, fleet_table.FAILED)).not_()
    return (
        table.group_by("motion", "type", "vehicle")
        .agg(
            logs=pl.len(),
            with_result=own_result.sum(),
            identified=(pl.col("verdict") == "identified").sum(),
            hours=pl.col("duration_s").sum() / HOUR_S,
            first=pl.col("start").min().dt.date(),
            last=pl.col("start").max().dt.date(),
        )
        .sort("motion", "type", "vehicle", nulls_last=True)
    )


def _reasons(verdict: str, table: pl.DataFrame) -> pl.DataFrame:
    return table.filter(pl.col("verdict") == verdict).select("motion", "name", "reason")


def _copies(table: pl.DataFrame) -> pl.DataFrame:
    is_copy = pl.col("verdict") == fleet_table.COPY
    firsts = table.filter(~is_copy).select("motion", copy_of="sha256", first="name")
    copies = table.filter(is_copy).select("motion", "name", "copy_of")
    return copies.join(firsts, on=["motion", "copy_of"], how="left").select("motion", "name", "first")


#: Queries by name.
QUERIES: Mapping[str, Callable[[pl.DataFrame], pl.DataFrame]] = {
    "verdicts": lambda table: (
        table.group_by("motion", "verdict").agg(logs=pl.len()).sort("motion", "logs", "verdict")
    ),
    "vehicles": _vehicles,
    "failed": partial(_reasons, fleet_table.FAILED),
    "refused": partial(_reasons, Status.REFUSED.value),
    "copies": _copies,
}


def query(table: pl.DataFrame, what: str) -> pl.DataFrame:
    """Answer of a query."""
    if what in QUERIES:
        return QUERIES[what](table)
    names = fleet_table.quantity_names(table)
    if what not in names:
        expected = f"a query out of {', '.join(QUERIES)}, or a quantity of the fleet ({', '.join(names)})"
        raise UsageError(expected, f"'{what}'", did_you_mean(what, [*QUERIES, *names], "Name one of them."))
    columns = (pl.col(f"{what}.{part}").alias(part) for part in (*fleet_table.NUMBERS, fleet_table.VERDICT))
    return (
        table.filter(pl.col(f"{what}.{fleet_table.VERDICT}").is_not_null())
        .sort("motion", "type", "vehicle", "start", "name", nulls_last=True)
        .select("motion", "vehicle", "start", "name", *columns)
    )


#: A slope is recognised by the flights where its error is at most this share of what it was beforehand.
MOVED = 0.9
#: Tests of a quantity: for a drift, and for a step.
FORMS = 2


@dataclass(frozen=True)
class FleetReport:
    """Results of the flights of one motion."""

    motion: Motion[Any]
    logs: dict[str, int]
    quantities: tuple[AcrossFlights, ...]
    vehicles: pl.DataFrame
    types: pl.DataFrame  # The same of types, `pooled` vehicles each
    omitted: pl.DataFrame  # `quantity`, `reason`, `flights`
    covariates: pl.DataFrame  # `type`, `quantity`, `covariate`, `slope`, `std_error`
    deviating: pl.DataFrame  # Flights that deviate
    flights: pl.DataFrame  # Rows in order, with the hours flown before each
    expected: frozenset[tuple[str, str]] = frozenset()


def fleet_report(table: pl.DataFrame, motion: Motion[Any], further: Sequence[str] = ()) -> FleetReport:
    """Report of the flights of a motion."""
    across = across_of(motion, further)
    absent = [name for name in report_columns(across) if name not in table.columns]
    table = table.with_columns(pl.lit(None, pl.Float64).alias(name) for name in absent)
    of_motion = table.filter(pl.col("motion") == motion.name)
    rows = in_order(of_motion)
    with ThreadPoolExecutor(useful_workers(None, len(across))) as pool:
        result = list(pool.map(partial(_Quantity.from_rows, rows), across))
        selected = [item for item in result if item.used.height]
        tested = (
            item.trend.about.filter(pl.Series(item.trend.enough_flights)) for item in selected if item.trend
        )
        empty = pl.DataFrame(schema=dict.fromkeys(VEHICLE, pl.String))
        tests = pl.concat([empty, *tested]).group_by(VEHICLE).agg(tests=pl.len().cast(pl.Float64))
        vehicles = list(pool.map(lambda item: item.vehicles(tests), selected))
        types = list(pool.map(_Quantity.types, selected))
        deviating = list(pool.map(lambda item: item.deviating(tests), selected))
    trends = ((item.across.name, item.trend) for item in selected if item.trend)
    logs = {
        "logs": of_motion.height,
        "copies": int((of_motion["verdict"] == fleet_table.COPY).sum()),
        "failed": int((of_motion["verdict"] == fleet_table.FAILED).sum()),
    }
    pooled = _differing(_concat(vehicles)) if vehicles else pl.DataFrame()
    return FleetReport(
        motion,
        logs,
        tuple(item.across for item in selected),
        pooled,
        _concat(types),
        _concat([item.omitted() for item in result]),
        _concat([fleet_table.COVARIATES, *(item.covariates() for item in selected)]),
        _concat([fleet_table.DEVIATING, *deviating]).sort("p_value"),
        rows,
        frozenset((name, covariate.name) for name, trend in trends for covariate in trend.used),
    )


def _joined(left: pl.DataFrame, right: pl.DataFrame) -> pl.DataFrame:
    return left.join(right, on=VEHICLE, how="left", maintain_order="left")


def _concat(parts: list[pl.DataFrame]) -> pl.DataFrame:
    return pl.concat(parts, how="diagonal") if parts else pl.DataFrame()


def _differing(vehicles: pl.DataFrame) -> pl.DataFrame:
    """Vehicles with p-values that count how many vehicles and quantities there are."""
    p_values = vehicles["differs_p"].fill_null(np.nan).to_numpy()
    tested = np.isfinite(p_values)
    adjusted = np.ones(p_values.size)
    if tested.any():  # the share of false ones among those reported is kept (Benjamini and Hochberg 1995)
        adjusted[tested] = stats.false_discovery_control(p_values[tested])
    return vehicles.with_columns(
        differs=pl.Series(adjusted <= LEVEL),
        differs_p=pl.Series(np.where(tested, adjusted, np.nan)).fill_nan(None),
    )


@dataclass(frozen=True)
class _Quantity:
    across: AcrossFlights
    marked: pl.DataFrame
    used: pl.DataFrame
    timed: pl.DataFrame
    trend: FleetTrend | None

    @classmethod
    def from_rows(cls, rows: pl.DataFrame, across: AcrossFlights) -> _Quantity:
        marked = rows.with_columns(is_share(across)).with_columns(why=omission_reason(across, rows.columns))
        used = marked.filter(pl.col("why").is_null())
        timed = used.drop_nulls("start")
        return cls(across, marked, used, timed, trend(timed, across) if timed.height else None)

    @property
    def name(self) -> pl.Expr:
        return pl.lit(self.across.name)

    def omitted(self) -> pl.DataFrame:
        """How many flights say nothing of it, by reason."""
        out = self.marked.drop_nulls("why").group_by(reason="why").agg(flights=pl.len())
        counts = out.sort("flights", "reason", descending=[True, False])
        return counts.select(self.name.alias("quantity"), "reason", "flights")

    def vehicles(self, tests: pl.DataFrame) -> pl.DataFrame:
        out = self.marked.group_by(VEHICLE).agg(pl.col("why").is_not_null().sum().alias("left_out"))
        pooled = _joined(pooled_vehicles(self.used, self.across), out).with_columns(quantity=self.name)
        if self.trend is None:
            return pooled.with_columns(course=pl.lit(""), differs_p=pl.lit(None, pl.Float64))
        return _joined(pooled, self._changes(self.trend, tests)).with_columns(pl.col("course").fill_null(""))

    def _changes(self, result: FleetTrend, tests: pl.DataFrame) -> pl.DataFrame:
        groups, steps = result.ordered.groups, result.steps
        starts = groups.starts
        span = result.ordered.times[starts + groups.sizes - 1] - result.ordered.times[starts]
        slope = result.drifts.slope * span
        half = np.where(span > 0.0, result.drifts.half_widths(), np.inf) * np.where(span > 0.0, span, 1.0)
        form = result.form(self._counts(result, tests))
        position = np.minimum(starts + steps.index, starts + groups.sizes - 1)
        stepped = form == STEPS
        numbers = {
            "hours": span,
            "change": self._effect(slope),
            "change_low": self._effect(slope - half),
            "change_high": self._effect(slope + half),
            "change_p": result.drifts.p_values,
            "step": self._effect(steps.size),
            "step_low": self._effect(steps.size - steps.half_width),
            "step_high": self._effect(steps.size + steps.half_width),
            "step_p": steps.p_values,
            "step_hours": result.ordered.times[position],
            "step_flight": (steps.index + 1).astype(float),
            "step_flight_first": (steps.first + 1).astype(float),
            "step_flight_last": (steps.last + 1).astype(float),
        }
        only_steps = {name for name in numbers if name.startswith("step_flight") or name == "step_hours"}
        return result.about.with_columns(
            pl.Series("course", form.astype(str)),
            *(
                _known_series(name, number, result.enough_flights & (stepped | (name not in only_steps)))
                for name, number in numbers.items()
            ),
            pl.when(pl.Series(stepped)).then(self.timed["start"].gather(position)).alias("step_start"),
            pl.Series("differs_p", differing_p_values(result)),
        )

    def _counts(self, result: FleetTrend, tests: pl.DataFrame) -> Float[np.ndarray, " vehicles"]:
        return FORMS * _joined(result.about, tests)["tests"].fill_null(1.0).to_numpy()

    def _effect(self, values: Float[np.ndarray, " vehicles"]) -> Float[np.ndarray, " vehicles"]:
        """A difference; as a share for what is compared as its logarithm."""
        if not self.across.logarithm:
            return values
        with np.errstate(over="ignore"):
            return np.where(np.isfinite(values), np.expm1(values), np.nan)

    def types(self) -> pl.DataFrame:
        """Each type's mean over its vehicles: `type`, `pooled` (how many vehicles), and `POOLED`."""
        rows = self.used.filter(pl.col(TOGETHER) == pl.col("type"))
        about, groups = groups_of(rows, *VEHICLE)
        types, vehicles = groups_of(about, "type")
        grouped = Grouped(groups, *_arrays(rows, pooled(self.across)))
        means = grouped.weighted(grouped.paule_mandel(vehicles))
        shares = rows[SHARE].to_numpy()[groups.starts][vehicles.starts]
        of_types = Grouped(vehicles, means.mean, 1.0 / means.total)
        return _report(types, of_types, self.across, shares).with_columns(quantity=self.name)

    def deviating(self, tests: pl.DataFrame) -> pl.DataFrame:
        if self.trend is None:
            return fleet_table.DEVIATING
        counts = self._counts(self.trend, tests)
        form = self.trend.form(counts)
        p_values, line = self.trend.deviations(form)
        groups = self.trend.ordered.groups
        adjusted = p_values * groups.spread(groups.sizes * counts / FORMS)
        about = np.exp(line) if self.across.logarithm else line
        return (
            self.timed.select(*VEHICLE, "name", "sha256", "start", "hours")
            .with_columns(
                quantity=self.name,
                value=self.timed[f"{self.across.name}.value"],
                std_error=self.timed[f"{self.across.name}.std_error"],
                **self.timed.select(flight_interval(self.across)).to_dict(),
                expected=pl.Series(about),
                p_value=pl.Series(np.minimum(adjusted, 1.0)),
            )
            .filter(pl.col("p_value") <= LEVEL)
        )

    def covariates(self) -> pl.DataFrame:
        """Slopes that the flights identify, type by type; not those that stay at their prior."""
        if self.trend is None or not self.trend.used:
            return fleet_table.COVARIATES
        types = pl.DataFrame({"type": self.trend.sets.str.replace("\n", ", ", literal=True)})
        errors = np.sqrt(np.einsum("sii->si", self.trend.slopes_covariance))
        return pl.concat(
            types.with_columns(
                quantity=self.name,
                covariate=pl.lit(item.name),
                slope=pl.Series(self.trend.slopes[:, entry]),
                std_error=pl.Series(errors[:, entry]),
            ).filter(pl.col("std_error").is_between(0.0, MOVED * item.uncertainty, closed="right"))
            for entry, item in enumerate(self.trend.used)
        )


def fleet_reports(folder: Path, covariates: pl.DataFrame | None = None) -> tuple[FleetReport, ...]:
    """Reports of a folder."""
    names = fleet_table.read_flights(folder, ["motion"])["motion"].drop_nulls().unique().sort()
    motions = [motion_by_name(name) for name in names]
    columns = [name for motion in motions for name in report_columns(across_of(motion))]
    table = fleet_table.read_flights(folder, list(dict.fromkeys(columns)))
    if covariates is None:
        return tuple(fleet_report(table, motion) for motion in motions)
    table = with_covariates(table, covariates)
    return tuple(fleet_report(table, motion, covariates.columns[1:]) for motion in motions)
