"""Replicates of a pool: its estimate made again from flights that count more or less than once.

In each replicate all nuisances are searched again: each combination of the discrete ones has products of
its own, see `products/of_flights`, and between their nodes the continuous ones are searched in boxes, see
`box_search`. The whitening is the pool's own, run by run, renewed once more at its estimate: it weights
rows, so that its error changes the estimate to second order only.

With more instruments than unknowns the pool's own equations are not solved exactly, Q'e is not zero. It is
subtracted in every replicate (Hall and Horowitz 1996): what is drawn again is the flights' deviation from
the pool, and discrete nuisances are told apart as often as they are by new flights. Left in, it counts
twice against each of their values, and replicates jump between values that the pool itself can tell apart.
What is known of a nuisance beforehand is a measurement of it, and treated alike: drawn again in each
replicate about the pool's own value.

Notation: Q pool's orthonormal instruments, e whitened residual at the pool's estimate; sums over flights f
with counts w_f. A replicate's instruments have the Gram matrix sum w_f Q_f'Q_f, near the identity; H'H is
its inverse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from eivor.errors import UsageError
from eivor.estimation.assembler import Instrumental
from eivor.estimation.box_search import least_place
from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import by_name
from eivor.estimation.products.nodes import Nodes, nodes_of
from eivor.estimation.products.of_flights import flight_products, products_by_flight
from eivor.estimation.weighting.whitening import SpectralWhitening, whitened_by_residuals
from eivor.inference.products import Products
from eivor.linalg.system import LinearSystem, Solver
from eivor.models.equation import Parameter
from eivor.models.separable import Nuisance, Prior, SeparableProblem, Values
from eivor.shapes import Float

#: Directions of a replicate's instruments with smaller shares of power are dropped.
SMALLEST_POWER = 1e-8


@dataclass(frozen=True)
class Replicate:
    """The estimate of one draw of flights.

    Parameters
    ----------
    at : mapping of str to float
        Value of every nuisance.
    theta : ndarray, shape (n,)
        Linear parameters.
    criterion : float
        J, with what is known of nuisances beforehand.
    candidate : int
        Place of its combination of discrete nuisances among the estimate's candidates.
    weights : ndarray, shape (T,)
        What each node of that candidate counts.
    """

    at: Values
    theta: Float[np.ndarray, " n"]
    criterion: float
    candidate: int
    weights: Float[np.ndarray, " T"]


@dataclass(frozen=True)
class CandidateFlights:
    """Flights at one combination of discrete nuisances.

    Parameters
    ----------
    number : int
        Its place among the estimate's candidates.
    fixed : mapping of str to float
        Values of all nuisances; those of continuous ones are the pool's.
    nodes : Nodes
        Of the continuous nuisances.
    products : Products
        Of the whitened rows, flight after flight, a block for each node.
    misfit : ndarray, shape (q,)
        Q'e of the pool at its best candidate's estimate.
    variance : float
        s^2 of the pool's whitened rows.
    """

    number: int
    fixed: Values
    nodes: Nodes
    products: Products
    misfit: Float[np.ndarray, " q"]
    variance: float

    @property
    def points(self) -> list[dict[str, float]]:
        """Values of all nuisances at every node."""
        return [{**self.fixed, **point} for point in self.nodes.points]

    def estimated(
        self, times: Float[np.ndarray, " F"], known: Mapping[str, Prior], solver: Solver
    ) -> Replicate:
        """Search the continuous nuisances and solve for the linear parameters.

        Parameters
        ----------
        times : ndarray, shape (F,)
            How often each flight counts.
        known : mapping of str to Prior
            What is known of nuisances beforehand, in this replicate.
        solver : Solver
            How the equations are solved.

        Raises
        ------
        EivorError
            When these flights do not determine the parameters.
        """
        drawn = self.products.weighted(times)
        known = self._of_one(known)
        equations = drawn.equations.copy()
        equations[:, :, -1] -= self.misfit
        equations = _half(drawn.instruments[0]) @ equations

        def objective(box: Sequence[Float[np.ndarray, " _"]]) -> Float[np.ndarray, " points"]:
            left = left_over(self.nodes.over(equations, box))
            return left + self.variance * self.nodes.misfit(box, known) if known else left

        place = least_place(objective, self.nodes.places)
        weights = self.nodes.weights(place)
        both = np.tensordot(weights, equations, 1)
        solution = solver.solve(LinearSystem(both[:, :-1], both[:, -1]))
        at = {**self.fixed, **self.nodes.at(place)}
        whole = drawn.weighted(weights).with_residual(solution.theta)
        unknowns = solution.theta.size + len(self.nodes.axes)
        variance = float(whole.power[0]) / (whole.count - unknowns)
        criterion = solution.objective / variance
        criterion += sum(prior.misfit(at[name]) for name, prior in known.items())
        return Replicate(at, solution.theta, criterion, self.number, weights)

    def _of_one(self, known: Mapping[str, Prior]) -> dict[str, Prior]:
        """What is known of each nuisance by itself, where it is of its sum with those that are fixed here."""
        others = {
            axis.nuisance.name: sum(self.fixed[other] for other in axis.nuisance.known_with)
            for axis in self.nodes.axes
        }
        return {
            name: replace(prior, mean=prior.mean - others.get(name, 0.0)) for name, prior in known.items()
        }


@dataclass(frozen=True)
class PoolFlights:
    """A pool, ready to be estimated again from any draw of its flights.

    Parameters
    ----------
    flights : tuple of int
        Numbers of the flights that have rows.
    candidates : tuple of CandidateFlights
        One for each combination of discrete nuisances.
    parameters : tuple of Parameter
        Linear parameters.
    solver : Solver
        The method's.
    known : mapping of str to Prior
        What is known beforehand of nuisances that were searched for, its mean moved to the pool's value.
    """

    flights: tuple[int, ...]
    candidates: tuple[CandidateFlights, ...]
    parameters: tuple[Parameter, ...]
    solver: Solver
    known: Mapping[str, Prior]

    @property
    def whole(self) -> Replicate:
        """Every flight once."""
        return self._estimated(np.ones(len(self.flights)), self.known)

    def replicate(self, random: np.random.Generator) -> tuple[Replicate, Float[np.ndarray, " F"]]:
        """As many flights as there are, drawn with replacement: their estimate, and how often each counts.

        Raises
        ------
        EivorError
            When these flights do not determine the parameters.
        """
        count = len(self.flights)
        times = np.bincount(random.integers(0, count, count), minlength=count).astype(np.float64)
        known = {
            name: replace(prior, mean=random.normal(prior.mean, prior.std))
            for name, prior in self.known.items()
        }
        return self._estimated(times, known), times

    def _estimated(self, times: Float[np.ndarray, " F"], known: Mapping[str, Prior]) -> Replicate:
        found = (one.estimated(times, known, self.solver) for one in self.candidates)
        return min(found, key=lambda replicate: replicate.criterion)


def pool_flights(problem: SeparableProblem, estimate: Estimate) -> PoolFlights:
    """Multiply the flights of a pool.

    Parameters
    ----------
    problem : SeparableProblem
        The pool.
    estimate : Estimate
        Of it, by whitened instruments.

    Raises
    ------
    UsageError
        For another method, and for fewer flights than two.
    """
    method = by_name(estimate.method)
    if not (
        isinstance(method, LinearMethod)
        and isinstance(method.assembler, Instrumental)
        and isinstance(method.row_weighting, SpectralWhitening)
    ):
        raise UsageError(
            "an estimate by whitened instruments (reference_iv)",
            f"one by {method.name}",
            "Identify the pool with the default method.",
        )
    flights = np.unique(problem.bins(estimate.best.at).layout.flight_of_row).tolist()
    if len(flights) < 2:
        raise UsageError(
            "a pool of two flights or more with usable runs",
            f"{len(flights)}",
            "Give several flights to identify_flight; ten or more make good intervals.",
        )
    nodes = nodes_of(problem.nuisances)
    candidates = tuple(
        _candidate_flights(problem, nodes, estimate.best, candidate, number)
        for number, candidate in enumerate(estimate.candidates)
    )
    known = _known(problem.nuisances, estimate.best)
    return PoolFlights(tuple(flights), candidates, estimate.best.rows.parameters, method.solver, known)


def _known(nuisances: tuple[Nuisance, ...], best: Candidate) -> dict[str, Prior]:
    return {
        nuisance.name: replace(nuisance.prior, mean=nuisance.with_others(best.at))
        for nuisance in nuisances
        if nuisance.searched and nuisance.prior is not None
    }


def _candidate_flights(
    problem: SeparableProblem, nodes: Nodes, best: Candidate, candidate: Candidate, number: int
) -> CandidateFlights:
    weights = whitened_by_residuals(problem, candidate.theta, candidate.at)
    products = flight_products(weights, [{**candidate.at, **point} for point in nodes.points])
    residual = products_by_flight(weights.rows(best.at)).total.with_residual(best.theta)
    misfit = residual.instrument_response[0]
    variance = candidate.solved.residual_variance()
    return CandidateFlights(number, candidate.at, nodes, products, misfit, variance)


def _half(gram: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "k q"]:
    """H with H'H the inverse of a Gram matrix on its own space: what makes instruments orthonormal."""
    powers, directions = scipy.linalg.eigh(gram)
    kept = powers > SMALLEST_POWER * powers[-1]
    return np.asarray((directions[:, kept] / np.sqrt(powers[kept])).T)


def left_over(equations: Float[np.ndarray, "k q n_plus_1"]) -> Float[np.ndarray, " k"]:
    """What least squares leaves of the last column of many small systems [A b], squared.

    Columns are taken out of those that follow one after the other (modified Gram-Schmidt, which for least
    squares is as stable as Householder's reflections, Bjorck 1967). Columns of zeros take nothing.
    """
    columns = np.moveaxis(equations, 2, 0).copy()
    for j, column in enumerate(columns[:-1]):
        power = np.einsum("kq,kq->k", column, column)
        shares = np.einsum("mkq,kq->mk", columns[j + 1 :], column)
        shares = np.divide(shares, power, out=np.zeros(shares.shape), where=power > 0.0)
        columns[j + 1 :] -= shares[:, :, None] * column
    return np.asarray(np.einsum("kq,kq->k", columns[-1], columns[-1]))
