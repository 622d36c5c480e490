"""The criterion of a pool: flights that share some parameters, and have others of their own.

J = sum over flights of |Q'e|^2 over s^2, the variance of all their whitened rows at the same values, which
is what limited information maximum likelihood minimises: with instruments for each flight there are many,
and two-stage least squares would lean towards least squares with them (Bekker 1994). With x = (1; -delta)
for the differences delta of the parameters from a centre it is a ratio of two quadratic forms. Flights meet
only in what they share: the forms of all parameters have the shape of an arrow, and a flight's own
parameters can be eliminated flight by flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
import scipy.linalg

from eivor.estimation.box_search import least_place
from eivor.estimation.nuisance_scan import NuisanceScan, Places
from eivor.estimation.pools.member import PoolMember, products_at
from eivor.estimation.products.nodes import Nodes
from eivor.inference.sets.concentrated import allowed, least_ratio
from eivor.models.separable import Prior, Values
from eivor.shapes import Bool, Float

Forms = Float[np.ndarray, "F k b b"]
Box = Sequence[Float[np.ndarray, " _"]]


@dataclass(frozen=True)
class PoolCriterion:
    """J of some flights at one combination of the discrete nuisances.

    Parameters
    ----------
    members : tuple of PoolMember
        One for each flight.
    own : tuple of int
        Places of the linear parameters that belong to the flight; the others are shared.
    nodes : Nodes
        Of the continuous nuisances, which are shared.
    known : mapping of str to Prior
        What is known of these beforehand.
    """

    members: tuple[PoolMember, ...]
    own: tuple[int, ...]
    nodes: Nodes
    known: dict[str, Prior]

    @property
    def size(self) -> int:
        """Number of linear parameters of a flight."""
        return self.members[0].centre.size

    @property
    def shared(self) -> tuple[int, ...]:
        """Places of the linear parameters that are shared."""
        return tuple(place for place in range(self.size) if place not in self.own)

    @property
    def unknowns(self) -> int:
        """Parameters of all flights, and nuisances."""
        return len(self.members) * len(self.own) + len(self.shared) + len(self.nodes.axes)

    @property
    def rows(self) -> int:
        """Rows of all flights."""
        return sum(member.rows for member in self.members)

    @property
    def instruments(self) -> int:
        """Independent instruments of all flights."""
        return sum(member.instruments for member in self.members)

    # -- forms -----------------------------------------------------------------------------------------------

    @cached_property
    def _scales(self) -> Float[np.ndarray, " b"]:
        """Lengths of residual and regressors, by which columns are divided."""
        lengths = np.sqrt(np.mean([np.diagonal(np.mean(m.power, axis=0)) for m in self.members], axis=0))
        return np.where(lengths > 0.0, lengths, 1.0)

    def _blocks(self, box: Box) -> tuple[Forms, Forms]:
        """N and D of each flight, residual and regressors in their order."""
        freedom = self.rows - self.unknowns
        outer = np.outer(self._scales, self._scales)
        N, D = [], []
        for member in self.members:
            seen = self.nodes.over(member.equations, box) / self._scales
            N.append(seen.transpose(0, 2, 1) @ seen)
            D.append(self.nodes.over(member.power, box) / (outer * freedom))
        return np.stack(N), np.stack(D)

    def _joined(self, blocks: Forms) -> Float[np.ndarray, "k m m"]:
        """Form of all parameters: residual, each flight's own, and what is shared."""
        flights, own = len(self.members), len(self.own)
        width = 1 + flights * own + len(self.shared)
        joined = np.zeros((blocks.shape[1], width, width))
        for number, block in enumerate(blocks):
            places = self._places_of(number)
            joined[:, places[:, None], places] += block
        return joined

    def _places_of(self, number: int) -> np.ndarray:
        """Where residual and parameters of a flight are among those of all."""
        flights, own = len(self.members), len(self.own)
        places = np.zeros(1 + self.size, dtype=np.int64)
        places[[1 + place for place in self.own]] = 1 + number * own + np.arange(own)
        places[[1 + place for place in self.shared]] = 1 + flights * own + np.arange(len(self.shared))
        return places

    def misfit(self, box: Box) -> Float[np.ndarray, " points"]:
        """Squared distance from what is known beforehand, in standard errors."""
        return self.nodes.misfit(box, self.known) if self.known else np.zeros(1)

    def least(self, box: Box) -> Float[np.ndarray, " points"]:
        """Least J at the points of a box."""
        N, D = self._blocks(box)
        return least_ratio(self._joined(N), self._joined(D)) + self.misfit(box)

    # -- the minimum -----------------------------------------------------------------------------------------

    @cached_property
    def scan(self) -> NuisanceScan:
        """The least J over the continuous nuisance, where there is one at most."""
        return NuisanceScan(self.nodes, self._least_at)

    def _least_at(self, places: Places) -> Places:
        return self.least([places] if self.nodes.axes else [])

    @cached_property
    def minimum(self) -> tuple[Values, float]:
        """Continuous nuisances where J is least, and J there."""
        if len(self.nodes.axes) < 2:
            place, J = self.scan.minimum
            return self.nodes.at(np.array([place])[: len(self.nodes.axes)]), J
        found = least_place(self.least, self.nodes.places)
        return self.nodes.at(found), float(self.least([np.array([one]) for one in found.tolist()])[0])

    def parameters(self, nuisances: Values) -> list[Float[np.ndarray, " n"]]:
        """Linear parameters of each flight where J is least, at values of the continuous nuisances."""
        made = [products_at(member.rows_at(nuisances), member.centre) for member in self.members]
        outer = np.outer(self._scales, self._scales)
        seen = [equations / self._scales for equations, _ in made]
        N = self._joined(np.stack([(one.T @ one)[None] for one in seen]))[0]
        D = self._joined(np.stack([(power / outer)[None] for _, power in made]))[0]
        x = scipy.linalg.eigh(N, D, subset_by_index=(0, 0))[1][:, 0]
        differences = -x / x[0] * self._scales[0]
        return [
            member.centre + differences[self._places_of(number)][1:] / self._scales[1:]
            for number, member in enumerate(self.members)
        ]

    # -- sets ------------------------------------------------------------------------------------------------

    def below(self, bound: float, place: int) -> list[list[tuple[float, float]]]:
        """For each flight the values of one parameter at which J is at most a bound, as pieces."""
        found: list[list[tuple[float, float]]] = [[] for _ in self.members]
        for within, cut_short in self.scan.stretches(bound):
            box = [within] if self.nodes.axes else []
            N, D = self._blocks(box)
            left = (bound - self.misfit(box))[:, None, None] * np.ones((within.size, 1, 1))
            for number, (Q, free) in enumerate(self._others_free(N - left * D)):
                order = [0, 1 + place, *(1 + j for j in range(self.size) if j != place)]
                zeros = np.zeros(within.size)
                fitting = allowed(Q[:, order][:, :, order], np.zeros(Q.shape), zeros)
                pieces = fitting.continued() if cut_short else fitting.pieces()
                if free.any():
                    pieces = [(-inf, inf)]
                scale, centre = self._scales[0] / self._scales[1 + place], self.members[number].centre[place]
                found[number] += [(centre + a * scale, centre + b * scale) for a, b in pieces]
        return found

    def _others_free(self, Q: Forms) -> list[tuple[Float[np.ndarray, "k b b"], Bool[np.ndarray, " k"]]]:
        """For each flight the form of its parameters, those of the other flights where the form is least.

        And whether those of another flight can go to infinity at no cost.
        """
        own, kept = [1 + place for place in self.own], [0, *(1 + place for place in self.shared)]
        rest = Q[:, :, kept][:, :, :, kept]
        free = np.zeros(Q.shape[:2], dtype=np.bool_)
        if own:
            inner, cross = Q[:, :, own][:, :, :, own], Q[:, :, own][:, :, :, kept]
            free = np.linalg.eigvalsh(inner)[:, :, 0] <= 0.0
            inner = np.where(free[:, :, None, None], np.eye(len(own)), inner)
            rest = rest - np.swapaxes(cross, 2, 3) @ np.linalg.solve(inner, cross)
        total, some = rest.sum(axis=0), free.sum(axis=0)
        found = []
        for number, block in enumerate(Q):
            whole = block.copy()
            whole[:, np.array(kept)[:, None], kept] += total - rest[number]
            found.append((whole, some > free[number]))
        return found
