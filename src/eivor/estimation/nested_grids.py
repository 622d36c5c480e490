"""Candidates on nested grids: at every value of discrete nuisances, then between the best and its neighbours.

A grid whose steps are as fine as the data can tell apart would have many candidates that are far from
fitting. Coarse steps are tried first; beside the best of the candidates that compete they are halved, as
often as a nuisance says. Where the last value of a grid alone fits, the truth lies beyond: a grid that may be
longer goes on first. Far from the truth every value fits as badly as every other, and nothing shows the way:
where the data reject all of them, all that may be tried are, and kept if one of them is not rejected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from eivor.estimation.competing import bounded_sums, least_of_competitors
from eivor.estimation.long_grids import Found, best_of, where_more_is_explained, while_the_last_alone_fits
from eivor.models.separable import Nuisance, Values, combinations

Made = TypeVar("Made")

#: Place of a combination on the grids of nuisances that are not refined.
Place = tuple[int, ...]


def on_nested_grids(
    nuisances: tuple[Nuisance, ...],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
    rejected: Callable[[Made], bool] = lambda _: False,
) -> tuple[Made, ...]:
    """Candidates in the order of the finest grids.

    Parameters
    ----------
    nuisances : tuple of Nuisance
        All of a problem.
    made : callable
        From values of those that are not refined, and the candidate beside it that fits best, to the
        candidate there; None where none has been made yet.
    criterion : callable
        How well a candidate fits.
    rejected : callable
        Whether the data reject a candidate. Default: they never do.
    """
    nuisances, found = while_the_last_alone_fits(nuisances, made, criterion)
    finest, found = _halved(nuisances, found, made, criterion)
    if rejected(best_of(found, criterion)):
        nuisances, further = where_more_is_explained(nuisances, found, made, criterion)
        longest, together = (
            _halved(nuisances, found + further, made, criterion) if further else (finest, found)
        )
        if not rejected(best_of(together, criterion)):
            finest, found = longest, together
    return tuple(candidate for _, candidate in sorted(found, key=lambda one: _place(finest, one[0])))


def _halved(
    nuisances: tuple[Nuisance, ...],
    found: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """The finest grids, and candidates there beside the best."""
    found = list(found)
    for _ in range(max((one.halvings for one in nuisances if one.discrete), default=0)):
        finer = tuple(one.halved for one in nuisances)
        best = list(_best(nuisances, found, criterion))
        known = {_place(finer, at) for at, _ in found}
        near = [(_place(finer, at), candidate) for at, candidate in best]
        for at in combinations(finer):
            place = _place(finer, at)
            beside = [candidate for other, candidate in near if _adjacent(nuisances, finer, place, other)]
            if beside and place not in known:
                found.append((at, made(at, min(beside, key=criterion))))
        nuisances = finer
    return nuisances, found


def with_values_tried(nuisances: tuple[Nuisance, ...], tried: Iterable[Values]) -> tuple[Nuisance, ...]:
    """Nuisances whose discrete ones have the values of some candidates, and no steps to be halved.

    Parameters
    ----------
    nuisances : tuple of Nuisance
        All of a problem.
    tried : iterable of mapping of str to float
        Values of all nuisances at each candidate.
    """
    points = list(tried)
    return tuple(
        replace(one, grid=np.unique([at[one.name] for at in points]), halvings=0, furthest=None)
        if one.discrete and one.halvings
        else one
        for one in nuisances
    )


def _best(
    nuisances: tuple[Nuisance, ...],
    found: list[tuple[dict[str, float], Made]],
    criterion: Callable[[Made], float],
) -> Iterator[tuple[dict[str, float], Made]]:
    """Best of the candidates that compete with each other."""
    criteria = [criterion(candidate) for _, candidate in found]
    least = least_of_competitors(bounded_sums(nuisances), [at for at, _ in found], criteria)
    for one, own, lowest in zip(found, criteria, least, strict=True):
        if own == lowest:
            yield one


def _place(nuisances: tuple[Nuisance, ...], at: Values) -> Place:
    """Place on the grids; of a nuisance with bounds on that of the sum."""
    return tuple(
        int(np.argmin(np.abs(one.grid - (at[one.name] if one.bounds is None else one.with_others(at)))))
        for one in nuisances
        if not one.refined
    )


def _adjacent(
    nuisances: tuple[Nuisance, ...], finer: tuple[Nuisance, ...], place: Place, other: Place
) -> bool:
    """Whether two places on the finer grids differ by one step at most, and where steps were halved only."""
    steps = [
        int(fine.grid.size > coarse.grid.size)
        for coarse, fine in zip(nuisances, finer, strict=True)
        if not coarse.refined
    ]
    return all(abs(a - b) <= step for a, b, step in zip(place, other, steps, strict=True))
