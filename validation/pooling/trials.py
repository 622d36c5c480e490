"""One cell of the study: many vehicles alike, each with so many flights, and what is said of them."""

from __future__ import annotations

from dataclasses import dataclass

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
