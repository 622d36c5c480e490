"""What a fleet's table says of each vehicle and type: pooled quantities, and what changes."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import polars as pl

from eivor.fleets.course import (
    LEVEL,
    STEPS,
    Corrected,
    Course,
    among_many,
    course,
    differing_p_values,
)
from eivor.fleets.pool import pooled_types, pooled_vehicles
from eivor.fleets.pooled_rows import (
    VEHICLE,
    across_of,
    in_order,
    is_share,
    own_interval,
    wanted_columns,
    why_left_out,
)
from eivor.fleets.table import COPY, FAILED
from eivor.flights.across import AcrossFlights
from eivor.flights.motion import Motion
from eivor.process_pool import useful_workers
from eivor.shapes import Float

#: Tables without rows.
COVARIATES = pl.DataFrame(
    schema={
        **dict.fromkeys(("type", "quantity", "covariate"), pl.String),
        **dict.fromkeys(("slope", "std_error"), pl.Float64),
    }
)
DEVIATING = pl.DataFrame(
    schema={
        **dict.fromkeys((*VEHICLE, "name", "sha256"), pl.String),
        "start": pl.Datetime("us", "UTC"),
        "hours": pl.Float64,
        "quantity": pl.String,
        **dict.fromkeys(("value", "std_error", "low", "high", "expected", "p_value"), pl.Float64),
    }
)
#: A slope is told by the flights where its error is at most this share of what it was beforehand.
MOVED = 0.9
#: Tests of a quantity: for a drift, and for a step.
FORMS = 2


@dataclass(frozen=True)
class FleetReport:
    """What the flights of one motion say of a fleet.

    Parameters
    ----------
    motion : Motion
        Which.
    logs : mapping of str to int
        How many there are, how many are copies, and how many gave no result.
    quantities : tuple of AcrossFlights
        Those that any flight tells.
    vehicles : polars.DataFrame
        One row for each vehicle and quantity: `type`, `vehicle`, `quantity`, `pooled` (flights), `left_out`,
        what `pool.POOLED` and `pool.ONLY` name, `course` and what changed.
    types : polars.DataFrame
        The same of types, `pooled` vehicles each.
    left_out : polars.DataFrame
        `quantity`, `reason`, `flights`.
    covariates : polars.DataFrame
        `type`, `quantity`, `covariate`, `slope`, `std_error`: what the flights told and was taken out.
    deviating : polars.DataFrame
        Flights that deviate: `type`, `vehicle`, `name`, `start`, `hours`, `quantity`, `value`, `std_error`,
        `low`, `high`, `expected`, `p_value` (times the number of tests).
    flights : polars.DataFrame
        Rows in order, with the hours flown before each; see `pooled_rows.in_order`.
    expected : frozenset of (str, str)
        Quantities and covariates that the flights know, whether or not they tell the slope.
    """

    motion: Motion[Any]
    logs: dict[str, int]
    quantities: tuple[AcrossFlights, ...]
    vehicles: pl.DataFrame
    types: pl.DataFrame
    left_out: pl.DataFrame
    covariates: pl.DataFrame
    deviating: pl.DataFrame
    flights: pl.DataFrame
    expected: frozenset[tuple[str, str]] = frozenset()


def fleet_report(table: pl.DataFrame, motion: Motion[Any], further: Sequence[str] = ()) -> FleetReport:
    """Report of the flights of a motion.

    Parameters
    ----------
    table : polars.DataFrame
        Rows of a fleet, those of other motions among them.
    motion : Motion
        Which.
    further : sequence of str
        Columns of covariates beside those that the motion knows.
    """
    across = across_of(motion, further)
    absent = [name for name in wanted_columns(across) if name not in table.columns]
    table = table.with_columns(pl.lit(None, pl.Float64).alias(name) for name in absent)
    own = table.filter(pl.col("motion") == motion.name)
    rows = in_order(own)
    with ThreadPoolExecutor(useful_workers(None, len(across))) as pool:
        found = list(pool.map(partial(_Quantity.of, rows), across))
        told = [one for one in found if one.used.height]
        tests = _tests(told)
        vehicles = list(pool.map(lambda one: one.vehicles(tests), told))
        types = list(pool.map(_Quantity.types, told))
        deviating = list(pool.map(lambda one: one.deviating(tests), told))
    logs = {
        "logs": own.height,
        "copies": int((own["verdict"] == COPY).sum()),
        "failed": int((own["verdict"] == FAILED).sum()),
    }
    together = _differing(pl.concat(vehicles, how="diagonal")) if vehicles else pl.DataFrame()
    return FleetReport(
        motion,
        logs,
        tuple(one.across for one in told),
        together,
        _concat(types),
        _concat([one.left_out() for one in found]),
        _concat([COVARIATES, *(one.covariates() for one in told)]),
        _concat([DEVIATING, *deviating]).sort("p_value"),
        rows,
        frozenset(
            (one.across.name, known.name)
            for one in told
            for known in (one.corrected.used if one.corrected else ())
        ),
    )


def _concat(parts: list[pl.DataFrame]) -> pl.DataFrame:
    return pl.concat(parts, how="diagonal") if parts else pl.DataFrame()


def _tests(told: list[_Quantity]) -> pl.DataFrame:
    """How many quantities of each vehicle have enough flights for a course."""
    parts = [one.course.about.filter(pl.Series(one.course.told)) for one in told if one.course is not None]
    if not parts:
        return pl.DataFrame(schema={**dict.fromkeys(VEHICLE, pl.String), "tests": pl.Float64})
    return pl.concat(parts).group_by(VEHICLE).agg(pl.len().cast(pl.Float64).alias("tests"))


def _differing(vehicles: pl.DataFrame) -> pl.DataFrame:
    """Vehicles with p-values that count how many vehicles and quantities there are."""
    known = vehicles["differs_p"].fill_null(np.nan).to_numpy()
    tested = np.isfinite(known)
    adjusted = np.ones(known.size)
    adjusted[tested] = among_many(known[tested])
    return vehicles.with_columns(
        differs=pl.Series(adjusted <= LEVEL),
        differs_p=pl.Series(np.where(tested, adjusted, np.nan)).fill_nan(None),
    )


@dataclass(frozen=True)
class _Quantity:
    """One quantity of all flights."""

    across: AcrossFlights
    marked: pl.DataFrame
    used: pl.DataFrame
    timed: pl.DataFrame
    course: Course | None
    corrected: Corrected | None

    @classmethod
    def of(cls, rows: pl.DataFrame, across: AcrossFlights) -> _Quantity:
        marked = rows.with_columns(is_share(across)).with_columns(
            why_left_out(across, rows.columns).alias("why")
        )
        used = marked.filter(pl.col("why").is_null())
        timed = used.filter(pl.col("start").is_not_null())
        if not timed.height:
            return cls(across, marked, used, timed, None, None)
        return cls(across, marked, used, timed, *course(timed, across))

    @property
    def name(self) -> pl.Expr:
        return pl.lit(self.across.name)

    def left_out(self) -> pl.DataFrame:
        """How many flights say nothing of it, by reason."""
        out = self.marked.filter(pl.col("why").is_not_null())
        counts = (
            out.group_by("why")
            .agg(pl.len().alias("flights"))
            .sort("flights", "why", descending=[True, False])
        )
        return counts.select(self.name.alias("quantity"), pl.col("why").alias("reason"), "flights")

    def vehicles(self, tests: pl.DataFrame) -> pl.DataFrame:
        """Means of vehicles, and what changed."""
        out = self.marked.group_by(VEHICLE).agg(pl.col("why").is_not_null().sum().alias("left_out"))
        pooled = pooled_vehicles(self.used, self.across).join(
            out, on=VEHICLE, how="left", maintain_order="left"
        )
        pooled = pooled.with_columns(quantity=self.name)
        if self.course is None or self.corrected is None:
            return pooled.with_columns(course=pl.lit(""), differs_p=pl.lit(None, pl.Float64))
        return pooled.join(
            self._changes(self.course, self.corrected, tests), on=VEHICLE, how="left", maintain_order="left"
        ).with_columns(pl.col("course").fill_null(""))

    def _changes(self, found: Course, corrected: Corrected, tests: pl.DataFrame) -> pl.DataFrame:
        """Drift and step of each vehicle, and whether it differs."""
        groups, steps = found.ordered.groups, found.steps
        starts = groups.starts
        span = found.ordered.at[starts + groups.sizes - 1] - found.ordered.at[starts]
        slope = found.drifts.slope * span
        half = np.where(span > 0.0, found.drifts.half_widths(), np.inf) * np.where(span > 0.0, span, 1.0)
        form = found.form(self._counts(found, tests))
        at = np.minimum(starts + steps.place, starts + groups.sizes - 1)
        stepped = form == STEPS
        numbers = {
            "hours": span,
            "change": self._effect(slope),
            "change_low": self._effect(slope - half),
            "change_high": self._effect(slope + half),
            "change_p": found.drifts.p_values,
            "step": self._effect(steps.size),
            "step_low": self._effect(steps.size - steps.half_width),
            "step_high": self._effect(steps.size + steps.half_width),
            "step_p": steps.p_values,
            "step_hours": found.ordered.at[at],
            "step_flight": (steps.place + 1).astype(float),
            "step_flight_first": (steps.first + 1).astype(float),
            "step_flight_last": (steps.last + 1).astype(float),
        }
        only_steps = {name for name in numbers if name.startswith("step_flight") or name == "step_hours"}
        return found.about.with_columns(
            pl.Series("course", form.astype(str)),
            *(
                pl.Series(
                    name, np.where(found.told & (stepped | (name not in only_steps)), one, np.nan)
                ).fill_nan(None)
                for name, one in numbers.items()
            ),
            pl.when(pl.Series(stepped)).then(self.timed["start"].gather(at)).alias("step_start"),
            pl.Series("differs_p", differing_p_values(corrected)),
        )

    def _counts(self, found: Course, tests: pl.DataFrame) -> Float[np.ndarray, " vehicles"]:
        counts = found.about.join(tests, on=VEHICLE, how="left", maintain_order="left")["tests"]
        return FORMS * counts.fill_null(1.0).to_numpy()

    def _effect(self, values: Float[np.ndarray, " vehicles"]) -> Float[np.ndarray, " vehicles"]:
        """A difference; as a share for what is compared as its logarithm."""
        if not self.across.logarithm:
            return values
        with np.errstate(over="ignore"):
            return np.where(np.isfinite(values), np.expm1(values), np.nan)

    def types(self) -> pl.DataFrame:
        """Means of types."""
        return pooled_types(self.used, self.across).with_columns(quantity=self.name)

    def deviating(self, tests: pl.DataFrame) -> pl.DataFrame:
        """Flights that deviate from the course of their vehicle."""
        if self.course is None:
            return DEVIATING
        counts = self._counts(self.course, tests)
        form = self.course.form(counts)
        p_values, line = self.course.deviations(form)
        groups = self.course.ordered.groups
        many = p_values * groups.spread(groups.sizes * counts / FORMS)
        about = np.exp(line) if self.across.logarithm else line
        return (
            self.timed.select(*VEHICLE, "name", "sha256", "start", "hours")
            .with_columns(
                quantity=self.name,
                value=self.timed[f"{self.across.name}.value"],
                std_error=self.timed[f"{self.across.name}.std_error"],
                **self.timed.select(own_interval(self.across)).to_dict(),
                expected=pl.Series(about),
                p_value=pl.Series(np.minimum(many, 1.0)),
            )
            .filter(pl.col("p_value") <= LEVEL)
        )

    def covariates(self) -> pl.DataFrame:
        """Slopes that the flights told, type by type; those that they left as expected are none."""
        if self.corrected is None or not self.corrected.used:
            return COVARIATES
        slopes = self.corrected.slopes
        types = pl.DataFrame({"type": self.corrected.sets.str.replace("\n", ", ", literal=True)})
        return pl.concat(
            [
                types.with_columns(
                    quantity=self.name,
                    covariate=pl.lit(one.name),
                    slope=pl.Series(slopes.values[:, place]),
                    std_error=pl.Series(np.sqrt(slopes.covariance[:, place, place])),
                ).filter(pl.col("std_error").is_between(0.0, MOVED * one.uncertainty, closed="right"))
                for place, one in enumerate(self.corrected.used)
            ]
        )
