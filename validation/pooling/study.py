"""What pooling does where the truth is known, and the command that finds out how well it does.

    python -m validation.pooling.study --kept FILE.jsonl [--size small|full] [--page docs/studies/coverage.md]

draws the grid beside this file, keeps every cell in the file, and prints its table: coverage of a vehicle's
mean, of its next flight, and of the heterogeneity, nominal 95 %. The exit code is 0 when every requirement is
met, 3 when one is not, 2 for an input of no use.
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
    Groups,
    between_distribution,
    moment_between,
    paule_mandel,
    q_profile,
    random_effects_means,
)
from eivor.lab.experiments import markdown
from validation.studies import (
    Answer,
    GridStruct,
    Requirement,
    completed,
    kept_command,
    read_as,
    requirement_table,
    versions,
)

SEED = 20261122


@dataclass(frozen=True, slots=True)
class Told:
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


def cell(flights: int, heterogeneity: float, replications: int, std_errors: tuple[float, float]) -> Told:
    """Draw a cell and judge what is said of it; its numbers follow from its own seed."""
    rng = np.random.default_rng([SEED, flights, round(1e4 * heterogeneity), replications])
    groups = Groups(np.full(replications, flights))
    errors = rng.uniform(*std_errors, replications * flights)
    y = np.hypot(heterogeneity, errors) * rng.standard_normal(errors.size)
    following = heterogeneity * rng.standard_normal(replications)
    variances = errors**2
    means = random_effects_means(groups, y, variances, paule_mandel(groups, y, variances))
    fixed = random_effects_means(groups, y, variances, np.zeros(replications))
    laird = random_effects_means(groups, y, variances, moment_between(groups, y, variances))
    known = between_distribution(groups, y, variances)
    next_half_widths = known.next_half_widths(means.value)
    plain = special.stdtrit(flights - 2, 0.975) * np.sqrt(means.between + means.variance)
    low, high = q_profile(groups, y, variances)
    spread = (low <= heterogeneity**2) & (heterogeneity**2 <= high)
    z = normal_quantile(0.95)
    by_weights = [
        z / np.sqrt(groups.sums(1.0 / (variances + groups.spread(item.between)))) for item in (fixed, laird)
    ]
    return Told(
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


PART = "pooling"
GRID = Path(__file__).with_name("grid.toml")
#: Asked: coverage of the mean at least; at most where the heterogeneity exceeds the mean standard error; and
#: of the next flight at least.
MEAN, NOT_ABOVE, FOLLOWING = 0.93, 0.98, 0.90
HEADER = (
    "flights",
    "heterogeneity",
    "mean",
    "Hartung-Knapp alone",
    "fixed effect",
    "DerSimonian-Laird",
    "next flight",
    "plain, t of n - 2",
    "its length over the plain one's",
    "heterogeneity's interval",
)


class Grid(GridStruct, frozen=True):
    flights: tuple[int, ...]
    heterogeneity: tuple[float, ...]
    std_errors: tuple[float, float]  # Between which they are drawn
    small: int  # Vehicles of a cell by size of the study
    full: int


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Draw what the file does not have yet, and judge all of it."""
    table = read_as(Grid, grid)
    count = getattr(table, size)
    trials = {
        (flights, heterogeneity, count): partial(cell, flights, heterogeneity, count, table.std_errors)
        for flights in table.flights
        for heterogeneity in table.heterogeneity
    }
    results = completed(
        kept, Told, trials, lambda line: (line.flights, line.heterogeneity, line.replications)
    )
    requirements = tuple(_requirements(results))
    return _tables(results, requirements), requirements


def _requirements(tolds: list[Told]) -> Iterator[Requirement]:
    clear = [item.mean for item in tolds if item.heterogeneity > item.std_error]
    means, following = min(item.mean for item in tolds), min(item.following for item in tolds)
    yield Requirement.at_least("coverage of the mean in every cell", means, MEAN)
    yield Requirement.at_least("coverage of the next flight in every cell", following, FOLLOWING)
    if clear:
        yield Requirement.at_most(
            "coverage of the mean where the heterogeneity exceeds the mean standard error",
            max(clear),
            NOT_ABOVE,
        )


def _tables(tolds: list[Told], requirements: tuple[Requirement, ...]) -> str:
    return "\n\n".join(
        (
            f"Made by `python -m validation.pooling.study` with {versions()}: {tolds[0].replications:,} "
            f"vehicles in each cell, seed {SEED}.",
            requirement_table(requirements),
            markdown(HEADER, map(_line, tolds)),
        )
    )


def _line(first: Told) -> tuple[str, ...]:
    shares = (first.mean, first.knapp, first.fixed, first.moments, first.following, first.plain)
    return (
        f"{first.flights}",
        f"{first.heterogeneity:g}",
        *(f"{share:.3f}" for share in shares),
        f"{first.wider:.2f}",
        f"{first.spread:.3f}",
    )


main = kept_command("validation.pooling.study", __doc__, GRID, PART, answer).main

if __name__ == "__main__":
    sys.exit(main())
