"""How vehicles change over their flight hours: drifts, steps, flights that deviate, vehicles that differ.

Covariates first: what air density, voltage and other columns explain is estimated once for each type, from
what varies within vehicles beside their drift, and taken out; how well it is known counts in every interval.
Then a vehicle is tested for a drift and for a step of each quantity. Where the smallest p-value, times the
number of these tests, is below .05 the vehicle changes, by the form that leaves less unexplained. Flights are
held against the others of their vehicle about that form, with as many tests counted as there are flights and
quantities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import polars as pl

from eivor.fleets.pooled_rows import TOGETHER, VEHICLE, compared, groups_of
from eivor.flights.across import AcrossFlights, Covariate
from eivor.inference.courses.deviation import deviation_p_values
from eivor.inference.courses.drift import Drifts, drifts
from eivor.inference.courses.isolated import Isolation
from eivor.inference.courses.ordered import Ordered
from eivor.inference.courses.shared_slopes import SharedSlopes, shared_slopes
from eivor.inference.courses.step import Steps, after_step, steps
from eivor.inference.random_effects.between import paule_mandel
from eivor.inference.random_effects.groups import Groups
from eivor.inference.random_effects.weighted import weighted, weights_of
from eivor.shapes import Float

#: Share of vehicles without change that may be said to change; share of those told to differ that may not.
LEVEL = 0.05
#: Flights with a time, at least, for a course to be told; vehicles of a type, at least, for one to differ.
FEWEST_FLIGHTS, FEWEST_VEHICLES = 6, 4
#: Share of flights that must know a covariate for it to be used.
KNOWN = 0.8
#: What a step has to explain beyond a drift, since its place was searched for.
SEARCHED = 5.0
#: A logarithm of a covariate that lies so near to the mean of its type differs from it by rounding only.
ROUNDING = 1e-9
STEADY, DRIFTS, STEPS = "steady", "drifts", "steps"


@dataclass(frozen=True)
class Corrected:
    """Estimates of a quantity without what covariates explain.

    Parameters
    ----------
    ordered : Ordered
        By vehicle, over flight hours.
    vehicles : Groups
        Of each set: the vehicles of a type, or one vehicle alone.
    sets : polars.Series
        Type of each set; of one vehicle alone that and the vehicle.
    used : tuple of Covariate
        Covariates, in the order of the slopes.
    slopes : SharedSlopes
        Of each set.
    """

    ordered: Ordered
    vehicles: Groups
    sets: pl.Series
    used: tuple[Covariate, ...]
    slopes: SharedSlopes


def corrected(rows: pl.DataFrame, across: AcrossFlights) -> Corrected:
    """Estimates without what covariates explain, at the mean conditions of their type.

    Parameters
    ----------
    rows : polars.DataFrame
        Those that say something of the quantity, in order.
    across : AcrossFlights
        The quantity.
    """
    about, groups = groups_of(rows, *VEHICLE, TOGETHER)
    sets, vehicles = groups_of(about, "type", TOGETHER)
    y, v = (rows.select(one).to_series().to_numpy() for one in compared(across))
    used = tuple(one for one in across.covariates if _is_known(rows, one.name))
    x = (
        rows.select(_about_the_type(one.name).alias(one.name) for one in used)
        .to_numpy()
        .T.reshape(len(used), rows.height)
        .astype(float)
    )
    if not across.logarithm:
        x *= _of_type(groups, vehicles, y, v)
    at = rows["hours"].to_numpy()
    given = _Given(groups, vehicles, y, v, at, x, used)
    found, slopes, between = given.without(given.errors(y), given.between(y, v), at[None, :])
    if used:  # again, beside the step that is seen now
        found, slopes, _ = given.without(found.errors, between, np.stack([at, after_step(found)]))
    return Corrected(found, vehicles, sets[TOGETHER], used, slopes)


@dataclass(frozen=True)
class _Given:
    """Estimates as they are, with covariates about their type's mean."""

    groups: Groups
    vehicles: Groups
    y: Float[np.ndarray, " rows"]
    v: Float[np.ndarray, " rows"]
    at: Float[np.ndarray, " rows"]
    x: Float[np.ndarray, "p rows"]
    used: tuple[Covariate, ...]

    def without(
        self,
        errors: Float[np.ndarray, " rows"],
        between: Float[np.ndarray, " groups"],
        courses: Float[np.ndarray, "c rows"],
    ) -> tuple[Ordered, SharedSlopes, Float[np.ndarray, " groups"]]:
        """Estimates without covariates, by the errors and the variance between that were found before."""
        slopes = shared_slopes(
            self.groups,
            self.vehicles,
            self.y,
            weights_of(self.groups, errors, between),
            courses,
            self.x,
            np.array([one.slope for one in self.used]),
            np.array([one.uncertainty for one in self.used]),
        )
        of_rows = np.repeat(np.repeat(slopes.values, self.vehicles.sizes, axis=0), self.groups.sizes, axis=0)
        level = self.y - np.einsum("pr,rp->r", self.x, of_rows)
        covariance = np.repeat(slopes.covariance, self.vehicles.sizes, axis=0)
        errors = self.errors(level) if self.used else errors
        between = self.between(level, errors, between)
        weights, own = (weights_of(self.groups, one, between) for one in (errors, self.v))
        return (
            Ordered(self.groups, level, errors, weights, own, self.at, self.x, covariance),
            slopes,
            between,
        )

    def between(
        self,
        level: Float[np.ndarray, " rows"],
        errors: Float[np.ndarray, " rows"],
        near: Float[np.ndarray, " groups"] | None = None,
    ) -> Float[np.ndarray, " groups"]:
        """Variance between flights, common to a type."""
        return paule_mandel(self.groups, level, errors, together=self.vehicles, near=near)

    def errors(self, level: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Variances of the estimates, those of isolated ones as large as they are far off."""
        return self.v + self._isolation.added(level)

    @cached_property
    def _isolation(self) -> Isolation:
        return Isolation(self.groups, self.vehicles, self.v)


def _of_type(
    groups: Groups, vehicles: Groups, y: Float[np.ndarray, " rows"], v: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """Mean of the type of each row: what turns the power of a covariate into a slope of the value itself."""
    first, total = (vehicles.sums(groups.sums(one)) for one in (y / v, 1.0 / v))
    return groups.spread(vehicles.spread(first / total))


def _is_known(rows: pl.DataFrame, name: str) -> bool:
    if name not in rows.columns or not rows.schema[name].is_numeric():
        return False
    return bool(rows.height and (rows[name] > 0.0).sum() >= KNOWN * rows.height)


def _about_the_type(name: str) -> pl.Expr:
    """Logarithm of a covariate about that of the type; zero where it is not known or does not vary."""
    log = pl.when(pl.col(name) > 0.0).then(pl.col(name)).log()
    about = log - log.mean().over(TOGETHER)
    return pl.when(about.abs() > ROUNDING).then(about).otherwise(0.0)


@dataclass(frozen=True)
class Course:
    """What changes in one quantity.

    Parameters
    ----------
    about : polars.DataFrame
        `type` and `vehicle` of each group.
    ordered : Ordered
        Behind it.
    drifts : Drifts
        Straight lines.
    steps : Steps
        Best steps.
    told : ndarray of bool, shape (vehicles,)
        Whether there are enough flights.
    """

    about: pl.DataFrame
    ordered: Ordered
    drifts: Drifts
    steps: Steps
    told: np.ndarray

    def form(self, tests: Float[np.ndarray, " vehicles"]) -> np.ndarray:
        """Form of each vehicle's course: `STEADY`, `DRIFTS` or `STEPS`.

        Parameters
        ----------
        tests : ndarray, shape (vehicles,)
            How many there are of the vehicle.
        """
        p_drift, p_step = self.drifts.p_values * tests, self.steps.p_values * tests
        scale = self.ordered.scale(self.steps.squares, 2)
        by_step = self.steps.squares + SEARCHED * scale < self.drifts.squares
        form = np.where((p_drift <= LEVEL) & ((p_step > LEVEL) | ~by_step), DRIFTS, STEADY)
        form = np.where((p_step <= LEVEL) & ((p_drift > LEVEL) | by_step), STEPS, form)
        return np.where(self.told, form, "")

    def deviations(self, form: np.ndarray) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
        """P-values of flights about the form of their vehicle, and that form."""
        ordered, groups = self.ordered, self.ordered.groups
        total = groups.sums(ordered.weights)
        mean = groups.spread(groups.sums(ordered.weights * ordered.y) / total)
        line, leverage = mean, ordered.weights / groups.spread(total)
        of_rows = np.repeat(form, groups.sizes)
        for name, other in ((DRIFTS, self.drifts), (STEPS, self.steps)):
            line = np.where(of_rows == name, other.line, line)
            leverage = np.where(of_rows == name, other.leverage, leverage)
        parameters = np.where(form == STEADY, 1.0, 2.0)
        p_values = deviation_p_values(ordered, line, leverage, parameters)
        return np.where(np.repeat(self.told, groups.sizes), p_values, 1.0), line


def course(rows: pl.DataFrame, across: AcrossFlights) -> tuple[Course, Corrected]:
    """Drifts and steps of every vehicle.

    Parameters
    ----------
    rows : polars.DataFrame
        Those that say something of the quantity and know their time, in order.
    across : AcrossFlights
        The quantity.
    """
    about, groups = groups_of(rows, *VEHICLE)
    found = corrected(rows, across)
    return (
        Course(
            about, found.ordered, drifts(found.ordered), steps(found.ordered), groups.sizes >= FEWEST_FLIGHTS
        ),
        found,
    )


def differing_p_values(found: Corrected) -> Float[np.ndarray, " vehicles"]:
    """P-values of vehicles against the others of their type; not a number where there are too few.

    A vehicle whose flights scatter more than those of its type, which share one variance between them, knows
    its mean less well: its error goes by its own scatter then.

    Parameters
    ----------
    found : Corrected
        Their estimates.
    """
    ordered, vehicles = found.ordered, found.vehicles
    groups, w = ordered.groups, ordered.weights
    total = groups.sums(w)
    means = groups.sums(w * ordered.y) / total
    scatter = groups.sums(w * (ordered.y - groups.spread(means)) ** 2) / np.maximum(groups.sizes - 1, 1)
    errors = np.maximum(scatter, 1.0) / total
    at = weighted(vehicles, means, errors, paule_mandel(vehicles, means, errors))
    none = np.zeros((0, means.size))
    about = Ordered(
        vehicles,
        means,
        errors,
        at.weights,
        at.weights,
        none.sum(axis=0),
        none,
        np.zeros((vehicles.sizes.size, 0, 0)),
    )
    line, leverage = vehicles.spread(at.mean), at.weights / vehicles.spread(at.total)
    p_values = deviation_p_values(about, line, leverage, np.ones(vehicles.sizes.size))
    return np.where(vehicles.spread(vehicles.sizes.astype(float)) >= FEWEST_VEHICLES, p_values, np.nan)


def among_many(p_values: Sequence[float] | Float[np.ndarray, " tests"]) -> Float[np.ndarray, " tests"]:
    """P-values that keep the share of false ones among those told (Benjamini and Hochberg 1995)."""
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(-p)
    ranks = np.arange(p.size, 0, -1)
    adjusted = np.empty(p.size)
    adjusted[order] = np.minimum.accumulate(np.minimum(p[order] * p.size / ranks, 1.0))
    return adjusted
