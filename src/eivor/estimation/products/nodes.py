"""Nodes of continuous nuisances, and what is linear in them between: products, sums.

A product of columns that move with a nuisance is a smooth function of it. It is made at the nodes only;
between them it is a cubic spline, over the logarithm of a nuisance that is positive. A spline is linear in
the values at its nodes, so that its weights serve whatever is added up of such values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.interpolate import CubicSpline

from eivor.estimation.search import product_grids
from eivor.models.separable import Nuisance, Prior, Values
from eivor.shapes import Float

#: Nodes of one nuisance, at least; of several together about so many, at most.
FEWEST_NODES, MOST_NODES = 17, 1000


@dataclass(frozen=True)
class NodeAxis:
    """Nodes of one nuisance.

    Parameters
    ----------
    nuisance : Nuisance
        Which.
    values : ndarray, shape (T,)
        Its value at each node, increasing.
    """

    nuisance: Nuisance
    values: Float[np.ndarray, " T"]

    @cached_property
    def places(self) -> Float[np.ndarray, " T"]:
        """Nodes on the spline's scale."""
        return np.log(self.values) if self.nuisance.positive else self.values

    def at(self, places: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Values of the nuisance at places of the scale."""
        return np.exp(places) if self.nuisance.positive else places

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.places, np.eye(self.places.size))

    def weights(self, places: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k T"]:
        """What each node counts at places between them."""
        return np.asarray(self._spline(places))


@dataclass(frozen=True)
class Nodes:
    """Product of the nodes of several nuisances; one node for none.

    Parameters
    ----------
    axes : tuple of NodeAxis
        One for each continuous nuisance. The last one runs fastest.
    """

    axes: tuple[NodeAxis, ...]

    @property
    def points(self) -> list[dict[str, float]]:
        """The nuisances' values at every node."""
        names = [axis.nuisance.name for axis in self.axes]
        return [
            dict(zip(names, values, strict=True))
            for values in product(*(axis.values.tolist() for axis in self.axes))
        ]

    @property
    def places(self) -> list[Float[np.ndarray, " _"]]:
        """Nodes on the scale of each axis."""
        return [axis.places for axis in self.axes]

    def over(
        self, values: Float[np.ndarray, "T *shape"], box: Sequence[Float[np.ndarray, " _"]]
    ) -> Float[np.ndarray, "points *shape"]:
        """Values at the points of a box, from those at the nodes."""
        sizes = [axis.places.size for axis in self.axes]
        found = values.reshape(*sizes, *values.shape[1:])  # of which there may be none
        for number, (axis, places) in enumerate(zip(self.axes, box, strict=True)):
            moved = np.tensordot(axis.weights(places), found, (1, number))
            found = np.moveaxis(moved, 0, number)
        return found.reshape(math.prod(found.shape[: len(sizes)]), *values.shape[1:])

    def weights(self, place: Float[np.ndarray, " axes"]) -> Float[np.ndarray, " T"]:
        """What each node counts at one place."""
        found = np.ones(1)
        for axis, one in zip(self.axes, place, strict=True):
            found = np.outer(found, axis.weights(np.array([one]))[0]).ravel()
        return found

    def at(self, place: Float[np.ndarray, " axes"]) -> Values:
        """The nuisances' values at one place."""
        return {
            axis.nuisance.name: float(axis.at(np.array([one]))[0])
            for axis, one in zip(self.axes, place, strict=True)
        }

    def misfit(
        self, box: Sequence[Float[np.ndarray, " _"]], known: Mapping[str, Prior]
    ) -> Float[np.ndarray, " points"]:
        """Squared distance of the points of a box from what is known beforehand, in standard errors."""
        total = np.zeros(1)
        for axis, places in zip(self.axes, box, strict=True):
            prior = known.get(axis.nuisance.name)
            own = np.zeros(places.size) if prior is None else prior.misfit(axis.at(places))
            total = np.add.outer(total, own).ravel()
        return total


def nodes_of(nuisances: tuple[Nuisance, ...], fewest: int = FEWEST_NODES) -> Nodes:
    """Nodes of the nuisances that are searched for between the values of their grids.

    They are the grids; finer where a grid is coarse, thinned where several would have too many.

    Parameters
    ----------
    nuisances : tuple of Nuisance
        All.
    fewest : int
        Nodes of one nuisance, at least.
    """
    sought = tuple(nuisance for nuisance in nuisances if nuisance.refined)
    grids = product_grids(sought, MOST_NODES)
    fewest = min(fewest, int(MOST_NODES ** (1.0 / max(len(sought), 1))))
    return Nodes(
        tuple(
            NodeAxis(nuisance, _fine(nuisance, grid, fewest))
            for nuisance, grid in zip(sought, grids, strict=True)
        )
    )


def _fine(nuisance: Nuisance, grid: Float[np.ndarray, " _"], fewest: int) -> Float[np.ndarray, " T"]:
    """A grid with as many values between its own as make it fine enough."""
    between = -((1 - fewest) // (grid.size - 1))
    if between == 1:
        return grid
    axis = NodeAxis(nuisance, grid)
    steps = np.arange((grid.size - 1) * between + 1) / between
    return axis.at(np.interp(steps, np.arange(grid.size), axis.places))
