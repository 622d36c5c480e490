"""Candidates on grids of discrete nuisances that go on where the truth lies beyond their end.

A grid that holds what nearly every vehicle has is short, and wrong for the others: a lag cannot make up for a
delay that none of the values reaches. Two things tell it. Where the last value alone fits, the next one is
tried. Far from the truth every value fits as badly as every other, and nothing shows the way: where the data
reject the best, also between its values, all values that the grid may have are tried. They serve if one of
them explains clearly more and none on the way to it clearly less: behind such a hump the next period of a
periodic motion may lie. And the data must not reject that one, too: where nothing fits, columns that are far
too late have little to do with the instruments, which hardly contradict them for that.
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


def while_the_last_alone_fits(
    nuisances: tuple[Nuisance, ...],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """Nuisances whose grids go on while that shows the way, and candidates at all of their values.

    Parameters
    ----------
    nuisances, made, criterion
        See `nested_grids.on_nested_grids`.
    """
    found = [(at, made(at, None)) for at in combinations(nuisances)]
    for one in nuisances:
        while one.longer is not one and _last_alone_fits(one, found, criterion):
            found += _added(nuisances, one := one.longer, found, made, criterion)
            nuisances = _with(nuisances, one)
    return nuisances, found


def where_more_is_explained(
    nuisances: tuple[Nuisance, ...],
    found: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """Nuisances with all values that they may have, where these explain more, and what is found there.

    Parameters
    ----------
    nuisances, made, criterion
        See `nested_grids.on_nested_grids`.
    found : list
        Candidates so far, those between the values of the grids among them.
    """
    further: Found[Made] = []
    for one in nuisances:
        if one.longest is not one:
            new = _added(nuisances, one.longest, found + further, made, criterion)
            if _explain_more(_profile(one, new, criterion), _profile(one, found + further, criterion)):
                further, nuisances = further + new, _with(nuisances, one.longest)
    return nuisances, further


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
    if not new:  # bounds of a sum may leave none
        return False
    best = min(new, key=lambda value: new[value])
    highest = max(criterion for value, criterion in new.items() if value <= best)
    allowed = max(before.values()) + chi_square_quantile(FITTING_LEVEL, 1)
    return new[best] < CLEARLY_LESS * min(before.values()) and highest <= allowed


def _last_alone_fits(one: Nuisance, found: Found[Made], criterion: Callable[[Made], float]) -> bool:
    *others, last = _profile(one, found, criterion).values()
    return min(others, default=last) - last > chi_square_quantile(FITTING_LEVEL, 1)


def _added(
    nuisances: tuple[Nuisance, ...],
    longer: Nuisance,
    found: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> Found[Made]:
    """Candidates at the values that a longer grid has more."""
    known, beside = {at[longer.name] for at, _ in found}, best_of(found, criterion)
    new = [at for at in combinations(_with(nuisances, longer)) if at[longer.name] not in known]
    return [(at, made(at, beside)) for at in new]


def _with(nuisances: tuple[Nuisance, ...], changed: Nuisance) -> tuple[Nuisance, ...]:
    return tuple(changed if one.name == changed.name else one for one in nuisances)


def best_of(found: Found[Made], criterion: Callable[[Made], float]) -> Made:
    """Candidate that fits best."""
    return min((candidate for _, candidate in found), key=criterion)
