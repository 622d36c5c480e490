"""Where a criterion is small over a continuous nuisance: its minima, and the stretches below a bound."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.estimation.products.nodes import Nodes
from eivor.shapes import Float

#: Places between two nodes at which minima are looked for.
BETWEEN = 4
#: Points and rounds of a closer look: each round is finer by half the points.
POINTS, ROUNDS = 17, 6
#: Places over each stretch of a nuisance, closer towards its ends.
PLACES = 65

Places = Float[np.ndarray, " k"]


@dataclass(frozen=True)
class NuisanceScan:
    """A criterion over one continuous nuisance, or over none.

    Parameters
    ----------
    nodes : Nodes
        Of the nuisance; one node for none.
    least : callable
        From places on the scale of the nodes to the criterion, least over everything else.
    """

    nodes: Nodes
    least: Callable[[Places], Places]

    @cached_property
    def scanned(self) -> tuple[Places, Places]:
        """Places between the nodes and all minima among them, in order, and the criterion there."""
        if not self.nodes.axes:
            places = np.zeros(1)
            return places, self.least(places)
        (own,) = self.nodes.places
        steps = np.arange((own.size - 1) * BETWEEN + 1) / BETWEEN
        places = np.interp(steps, np.arange(own.size), own)
        J = self.least(places)
        padded = np.concatenate([[np.inf], J, [np.inf]])
        lowest = np.flatnonzero((padded[:-2] >= J) & (padded[2:] >= J))
        found = [self._minimum(places[max(at - 1, 0)], places[min(at + 1, places.size - 1)]) for at in lowest]
        places = np.unique(np.concatenate([places, found]))
        return places, self.least(places)

    @property
    def minimum(self) -> tuple[float, float]:
        """Place of the least, and the criterion there."""
        places, J = self.scanned
        at = int(np.argmin(J))
        return float(places[at]), float(J[at])

    def stretches(self, bound: float) -> Iterator[tuple[Places, bool]]:
        """Stretches in which the criterion is at most a bound: places over each, and whether it is cut short.

        A grid ends somewhere, a positive nuisance does not: a stretch that reaches the top of its grid is
        cut short there.
        """
        places, J = self.scanned
        fits = np.concatenate([[False], bound >= J, [False]])
        starts, stops = np.flatnonzero(~fits[:-1] & fits[1:]), np.flatnonzero(fits[:-1] & ~fits[1:])
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
            low, high = float(places[start]), float(places[stop - 1])
            if start > 0:
                low = self._end(low, float(places[start - 1]), bound)
            if stop < places.size:
                high = self._end(high, float(places[stop]), bound)
            turned = 0.5 - 0.5 * np.cos(np.pi * np.arange(PLACES) / (PLACES - 1))
            within = np.unique(np.concatenate([low + (high - low) * turned, places[start:stop]]))
            yield within, stop == places.size and any(axis.nuisance.positive for axis in self.nodes.axes)

    def _minimum(self, low: float, high: float) -> float:
        for _ in range(ROUNDS):
            places = np.linspace(low, high, POINTS)
            at = int(np.argmin(self.least(places)))
            low, high = float(places[max(at - 1, 0)]), float(places[min(at + 1, POINTS - 1)])
        return 0.5 * (low + high)

    def _end(self, inside: float, outside: float, bound: float) -> float:
        """Last place with the criterion below a bound on the way from one that has it to one that has not."""
        for _ in range(ROUNDS):
            places = np.linspace(inside, outside, POINTS)
            first_out = int(np.argmax(self.least(places[1:]) > bound)) + 1
            inside, outside = float(places[first_out - 1]), float(places[first_out])
        return inside
