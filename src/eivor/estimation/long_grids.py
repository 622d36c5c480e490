"""Candidates on grids of discrete nuisances that go on where the truth lies beyond their end.

A grid that holds what nearly every vehicle has is short, and wrong for the others: a lag cannot make up for a
delay that none of the values reaches. Two things tell it. Where the last value alone fits, the next one is
tried. Far from the truth every value fits as badly as every other, and nothing shows the way: where the data
reject the best, all values that the grid may have are tried. They are kept if one of them explains clearly
more and none on the way to it clearly less: behind such a hump the next period of a periodic motion may lie.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

from eivor.inference.quantiles import chi_square_quantile
from eivor.models.separable import Nuisance, Values, combinations

#: Values of a discrete nuisance fit within this quantile of what the best leaves.
FITTING_LEVEL = 0.95
#: Values explain clearly more where their criterion is below this share of what it was.
CLEARLY_LESS = 0.5

Made = TypeVar("Made")
#: Candidates with the values of nuisances at which they were made.
Found = list[tuple[dict[str, float], Made]]


def long_enough(
    nuisances: tuple[Nuisance, ...],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
    rejected: Callable[[Made], bool],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """Nuisances whose grids are as long as it takes, and a candidate for every combination of their values.

    Parameters
    ----------
    nuisances, made, criterion, rejected
        See `nested_grids.on_nested_grids`.
    """
    found = [(at, made(at, None)) for at in combinations(nuisances)]
    for one in nuisances:
        while one.longer is not one and _last_alone_fits(one, found, criterion):
            found += _added(nuisances, one := one.longer, found, made, criterion)
            nuisances = _with(nuisances, one)
        best = _best(found, criterion)
        if one.longest is not one and rejected(best):
            new = _added(nuisances, one.longest, found, made, criterion)
            if _explain_more(_profile(one, new, criterion), _profile(one, found, criterion)):
                found, nuisances = found + new, _with(nuisances, one.longest)
    return nuisances, found


def reaching(nuisances: tuple[Nuisance, ...], points: Sequence[Values]) -> tuple[Nuisance, ...]:
    """Nuisances whose grids are as long as those of which some points are the best.

    Parameters
    ----------
    nuisances : tuple of Nuisance
        All of a problem.
    points : sequence of mapping of str to float
        Values of all nuisances at each point.
    """
    return tuple(_reaching(one, max(at[one.name] for at in points)) for one in nuisances)


def _reaching(one: Nuisance, value: float) -> Nuisance:
    while one.grid[-1] < value and one.longer is not one:
        one = one.longer
    return one


def _profile(one: Nuisance, found: Found[Made], criterion: Callable[[Made], float]) -> dict[float, float]:
    """Least criterion at each value of a nuisance, in their order."""
    least: dict[float, float] = {}
    for at, candidate in sorted(found, key=lambda pair: pair[0][one.name]):
        value = at[one.name]
        least[value] = min(criterion(candidate), least.get(value, math.inf))
    return least


def _explain_more(new: dict[float, float], before: dict[float, float]) -> bool:
    """Whether the best of further values explains clearly more, and none on the way to it clearly less."""
    best = min(new, key=lambda value: new[value])
    highest = max(criterion for value, criterion in new.items() if value <= best)
    allowed = max(before.values()) + chi_square_quantile(FITTING_LEVEL, 1)
    return new[best] < CLEARLY_LESS * min(before.values()) and highest <= allowed


def _last_alone_fits(one: Nuisance, found: Found[Made], criterion: Callable[[Made], float]) -> bool:
    *others, last = _profile(one, found, criterion).values()
    return min(others) - last > chi_square_quantile(FITTING_LEVEL, 1)


def _added(
    nuisances: tuple[Nuisance, ...],
    longer: Nuisance,
    found: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> Found[Made]:
    """Candidates at the values that a longer grid has more."""
    known, beside = {at[longer.name] for at, _ in found}, _best(found, criterion)
    new = [at for at in combinations(_with(nuisances, longer)) if at[longer.name] not in known]
    return [(at, made(at, beside)) for at in new]


def _with(nuisances: tuple[Nuisance, ...], changed: Nuisance) -> tuple[Nuisance, ...]:
    return tuple(changed if one.name == changed.name else one for one in nuisances)


def _best(found: Found[Made], criterion: Callable[[Made], float]) -> Made:
    return min((candidate for _, candidate in found), key=criterion)
