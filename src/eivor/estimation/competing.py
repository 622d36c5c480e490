"""Which candidates compete: all, or those that agree in what is known between bounds.

Every value of a sum that is bounded counts, however well it fits: a candidate is held against those of the
same value only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from eivor.models.separable import Nuisance, Values

#: Sums that agree to so many decimals are one value [in the nuisances' unit].
DECIMALS = 9


def bounded_sums(nuisances: Iterable[Nuisance]) -> tuple[tuple[str, ...], ...]:
    """Names of the nuisances whose sum is known between bounds, for each such sum."""
    return tuple((one.name, *one.known_with) for one in nuisances if one.bounds is not None)


def least_of_competitors(
    bounded: Sequence[Sequence[str]], points: Sequence[Values], criteria: Sequence[float]
) -> list[float]:
    """Return for each candidate the least criterion of those it competes with, itself among them.

    Parameters
    ----------
    bounded : sequence of sequence of str
        See `bounded_sums`.
    points : sequence of mapping of str to float
        Values of each candidate's nuisances.
    criteria : sequence of float
        Of each candidate.
    """
    classes = [tuple(round(sum(at[name] for name in names), DECIMALS) for names in bounded) for at in points]
    least: dict[tuple[float, ...], float] = {}
    for kind, criterion in zip(classes, criteria, strict=True):
        least[kind] = min(criterion, least.get(kind, math.inf))
    return [least[kind] for kind in classes]
