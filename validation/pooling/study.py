"""What pooling does where the truth is known, and the command that finds out how well it does.

    python -m validation.pooling.study --kept FILE.jsonl [--size small|full] [--page docs/studies/coverage.md]

draws the grid beside this file, keeps every cell in the file, and prints its table: coverage of a vehicle's
mean, of its next flight, and of the heterogeneity, nominal 95 %.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy import special

from eivor.inference.distributions import normal_quantile
from eivor.inference.random_effects import (
    Grouped,
    Groups,
    between_distribution,
)
from validation.studies import GridStruct, Group, KeptRun, KeptStudy, Requirement, alone, table_of
from validation.suite_files import versions

SEED = 20261122


@dataclass(frozen=True, slots=True)
class Pooled:
    """Shares of the vehicles of a cell whose intervals hold the truth."""

    flights: int  # Of each vehicle
    heterogeneity: float  # Standard deviation between flights
    replications: int  # Vehicles
    std_error: float  # Mean of the flights' standard errors
    # Intervals of the mean: Eivor's, Hartung and Knapp's modified one, that of a fixed effect, DerSimonian
    # and Laird's with normal quantiles
    mean: float
    knapp: float
    fixed: float
    moments: float
    following: float  # Intervals of the next flight: Eivor's, and the plain one with t of n - 2
    plain: float
    spread: float  # Intervals of the heterogeneity
    wider: float  # Median of Eivor's interval of the next flight over the plain one


def cell(flights: int, heterogeneity: float, replications: int, std_errors: tuple[float, float]) -> Pooled:
    """Draw a cell and judge what is said of it; its numbers follow from its own seed."""
    rng = np.random.default_rng([SEED, flights, round(1e4 * heterogeneity), replications])
    groups = Groups(np.full(replications, flights))
    errors = rng.uniform(*std_errors, replications * flights)
    y = np.hypot(heterogeneity, errors) * rng.standard_normal(errors.size)
    following = heterogeneity * rng.standard_normal(replications)
    variances = errors**2
    drawn = Grouped(groups, y, variances)
    means = drawn.means(drawn.paule_mandel())
    fixed = drawn.means(np.zeros(replications))
    laird = drawn.means(drawn.moment_between())
    known = between_distribution(drawn)
    next_half_widths = known.next_half_widths(means.value)
    plain = special.stdtrit(flights - 2, 0.975) * np.sqrt(means.between + means.variance)
    low, high = drawn.q_profile()
    spread = (low <= heterogeneity**2) & (heterogeneity**2 <= high)
    z = normal_quantile(0.95)
    by_weights = [
        z / np.sqrt(groups.sums(1.0 / (variances + groups.spread(item.between)))) for item in (fixed, laird)
    ]
    return Pooled(
        flights,
        heterogeneity,
        replications,
        float(np.mean(std_errors)),
        _share(means.value, known.mean_half_widths(means)),
        _share(means.value, means.half_widths()),
        _share(fixed.value, by_weights[0]),
        _share(laird.value, by_weights[1]),
        _share(means.value - following, next_half_widths),
        _share(means.value - following, plain),
        float(np.mean(spread)),
        float(np.median(next_half_widths / plain)),
    )


def _share(off: np.ndarray, half_widths: np.ndarray) -> float:
    return float(np.mean(np.abs(off) <= half_widths))


#: Asked: coverage of the mean at least; at most where the heterogeneity exceeds the mean standard error; and
#: of the next flight at least.
MEAN, NOT_ABOVE, FOLLOWING = 0.93, 0.98, 0.90
COLUMNS = {
    "flights": "{.flights}",
    "heterogeneity": "{.heterogeneity:g}",
    "mean": "{.mean:.3f}",
    "Hartung-Knapp alone": "{.knapp:.3f}",
    "fixed effect": "{.fixed:.3f}",
    "DerSimonian-Laird": "{.moments:.3f}",
    "next flight": "{.following:.3f}",
    "plain, t of n - 2": "{.plain:.3f}",
    "its length over the plain one's": "{.wider:.2f}",
    "heterogeneity's interval": "{.spread:.3f}",
}


class Grid(GridStruct, frozen=True):
    flights: tuple[int, ...]
    heterogeneity: tuple[float, ...]
    std_errors: tuple[float, float]  # Between which they are drawn
    small: int  # Vehicles of a cell by size of the study
    full: int


def groups(grid: Grid, size: str, _kept: Path) -> list[Group[tuple[int, float, int], Pooled]]:
    count = getattr(grid, size)
    return alone(
        {
            (flights, heterogeneity, count): partial(cell, flights, heterogeneity, count, grid.std_errors)
            for flights in grid.flights
            for heterogeneity in grid.heterogeneity
        }
    )


def requirements(run: KeptRun[Grid, Pooled]) -> Iterator[Requirement]:
    clear = [item.mean for item in run.lines if item.heterogeneity > item.std_error]
    means, following = (min(getattr(item, name) for item in run.lines) for name in ("mean", "following"))
    yield Requirement.at_least("coverage of the mean in every cell", means, MEAN)
    yield Requirement.at_least("coverage of the next flight in every cell", following, FOLLOWING)
    if clear:
        what = "coverage of the mean where the heterogeneity exceeds the mean standard error"
        yield Requirement.at_most(what, max(clear), NOT_ABOVE)


def tables(run: KeptRun[Grid, Pooled]) -> Iterator[str]:
    yield f" with {versions()}: {run.lines[0].replications:,} vehicles in each cell, seed {SEED}."
    yield table_of(COLUMNS, run.lines)


STUDY = KeptStudy(
    "pooling.study",
    __doc__,
    "pooling",
    Grid,
    Pooled,
    ("flights", "heterogeneity", "replications"),
    groups,
    requirements,
    tables,
)
main = STUDY.main

if __name__ == "__main__":
    sys.exit(main())
