"""Confidence sets of one linear parameter, nuisances and the other parameters being wherever they fit best.

An interval "estimate plus and minus" supposes that instruments move every column well. Here the criterion
J = |Q'e|^2 / s^2, s^2 at the same values and what is known of nuisances beforehand added, is least over
everything else, J(k). Two sets follow:

* profile: J(k) <= least J + t^2, t the quantile of Student's t on eight degrees of freedom, as in the
  interval by autocorrelation-robust errors;
* Anderson-Rubin: J(k) <= the quantile of chi-square with a degree of freedom for each equation but those
  that the other parameters use up. It holds however weak the instruments are (Guggenberger, Kleibergen,
  Mavroeidis and Chen 2012), may be unbounded or in several pieces, and is empty where no value fits.

For each value of the nuisances both are solutions of a quadratic inequality (`inference/sets/concentrated`),
and their union is taken over all: over each candidate, and over the stretches of the continuous nuisance in
which anything fits, their ends found by bisection. Between nodes products are splines, see `products/nodes`.

A grid ends somewhere, a lag does not: where a positive nuisance fits up to the top of its grid, a set has no
bound on the side that it moves to with that nuisance. Where a nuisance is known between bounds, the profile
set is the union over all its values, each with a least J of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.assembler import Instrumental
from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import by_name
from eivor.estimation.nuisance_scan import NuisanceScan, Places
from eivor.estimation.own_equations import own_equations
from eivor.estimation.products.nodes import Nodes, nodes_of
from eivor.estimation.weighting.rows import WeightedRows
from eivor.inference.quantiles import check_level, chi_square_quantile, t_quantile
from eivor.inference.sets.concentrated import allowed, least_ratio
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.models.separable import SeparableProblem
from eivor.models.spectral import BinRows
from eivor.shapes import Float

#: Degrees of freedom of the cosine averages, whose quantile the profile set takes over.
DEGREES = 8


@dataclass(frozen=True)
class ParameterSets:
    """Three 95 % sets of one parameter, or of another level.

    Parameters
    ----------
    wald : ConfidenceSet
        The estimate plus and minus, a union over the candidates that fit.
    profile, anderson_rubin : ConfidenceSet
        See `eivor.estimation.parameter_sets`.
    strange : tuple of str
        Linear parameters that are in none of its equations, those of other axes: how strong their instruments
        are says nothing of this one.
    """

    wald: ConfidenceSet
    profile: ConfidenceSet
    anderson_rubin: ConfidenceSet
    strange: tuple[str, ...] = ()

    @property
    def robust(self) -> ConfidenceSet:
        """The Anderson-Rubin set, but never less than the profile set.

        Both are where one criterion is below a bound, so that one holds the other. A criterion that is
        high at its least makes the Anderson-Rubin set small, or empty, although nothing is told better.
        """
        return ConfidenceSet.union((*self.anderson_rubin.intervals, *self.profile.intervals))


@dataclass(frozen=True)
class CandidateCriterion:
    """The criterion at one combination of discrete nuisances.

    Parameters
    ----------
    nodes : Nodes
        Of the continuous nuisance; one node for none.
    equations : ndarray, shape (T, q, m)
        Q' of residual and regressors, the parameter's own first, at each node.
    power : ndarray, shape (T, m, m)
        Their products with each other, over rows less unknowns.
    misfit : callable
        From places to the squared distance from what is known beforehand, in standard errors.
    centre, scale : float
        The parameter's value where the residual is taken, and what one unit of the forms is.
    """

    nodes: Nodes
    equations: Float[np.ndarray, "T q m"]
    power: Float[np.ndarray, "T m m"]
    misfit: Callable[[Places], Places]
    centre: float
    scale: float

    def _forms(self, places: Places) -> tuple[Float[np.ndarray, "k m m"], Float[np.ndarray, "k m m"]]:
        box = [places] if self.nodes.axes else []
        equations = self.nodes.over(self.equations, box)
        return equations.transpose(0, 2, 1) @ equations, self.nodes.over(self.power, box)

    def least(self, places: Places) -> Places:
        """Least J at each place."""
        return least_ratio(*self._forms(places)) + self.misfit(places)

    @cached_property
    def scan(self) -> NuisanceScan:
        """The least J over the continuous nuisance."""
        return NuisanceScan(self.nodes, self.least)

    def below(self, bound: float) -> list[tuple[float, float]]:
        """Values of the parameter at which J is at most a bound, as pieces that may overlap."""
        found: list[tuple[float, float]] = []
        for within, cut_short in self.scan.stretches(bound):
            fitting = allowed(*self._forms(within), bound - self.misfit(within))
            pieces = fitting.continued() if cut_short else fitting.pieces()
            found += [(self.centre + a * self.scale, self.centre + b * self.scale) for a, b in pieces]
        return found


def parameter_sets(
    problem: SeparableProblem, estimate: Estimate, name: str, level: float = 0.95
) -> ParameterSets | None:
    """Confidence sets of one linear parameter.

    Parameters
    ----------
    problem : SeparableProblem
        What was estimated.
    estimate : Estimate
        Of it.
    name : str
        A linear parameter.
    level : float
        Confidence level.

    Returns
    -------
    ParameterSets or None
        None for another method than one by whitened instruments, for a problem of several continuous
        nuisances, and where columns are collinear or leave nothing of the response.

    Raises
    ------
    UsageError
        When the level is not between 0 and 1, or there is no linear parameter of that name.
    """
    check_level(level)
    parameters = [parameter.name for parameter in estimate.best.rows.parameters]
    if name not in parameters:
        raise UsageError(f"a parameter out of {', '.join(parameters)}", f"'{name}'", "Name one of them.")
    method, nodes = by_name(estimate.method).of_flights, nodes_of(problem.nuisances)
    if not (
        isinstance(method, LinearMethod)
        and isinstance(method.assembler, Instrumental)
        and isinstance(estimate.best.rows.layout, BinRows)
        and len(nodes.axes) < 2
    ):
        return None
    place = parameters.index(name)
    criteria = [
        _criterion(problem, nodes, one, place, method.row_weighting.last_pass(problem, one.theta, one.at))
        for one in estimate.candidates
    ]
    try:
        least = estimate.least_of_competitors([one.scan.minimum[1] for one in criteria])
    except np.linalg.LinAlgError:
        return None
    best = estimate.best
    own = own_equations(best.rows, place)
    held = set(own.regressors.tolist())
    strange = tuple(other for number, other in enumerate(parameters) if number not in held)
    degrees = own.rank + len(best.solved.misfits) - (best.solved.unknowns - len(strange) - 1)

    allowance, highest = t_quantile(level, DEGREES) ** 2, chi_square_quantile(level, max(degrees, 1))
    compared = list(zip(least, criteria, strict=True))
    return ParameterSets(
        ConfidenceSet((estimate.interval(name, level),)),
        ConfidenceSet.union(piece for lowest, one in compared for piece in one.below(lowest + allowance)),
        ConfidenceSet.union(piece for one in criteria for piece in one.below(highest)),
        strange,
    )


def _criterion(
    problem: SeparableProblem, nodes: Nodes, candidate: Candidate, place: int, weights: WeightedRows
) -> CandidateCriterion:
    theta = candidate.theta
    own = own_equations(weights.rows(candidate.at), place)
    unknowns = candidate.solved.unknowns - (theta.size - own.regressors.size)
    columns = own.columns(weights.columns([{**candidate.at, **point} for point in nodes.points]), theta)
    equations = own.instruments.T @ columns
    power = columns.transpose(0, 2, 1) @ columns / (columns.shape[1] - unknowns)
    lengths = np.sqrt(np.diagonal(np.mean(power, axis=0)))
    sizes = np.where(lengths > 0.0, lengths, 1.0)

    known = [(one, one.prior) for one in problem.nuisances if one.searched and one.prior is not None]

    def misfit(places: Places) -> Places:
        at = {name: np.full(places.size, value) for name, value in candidate.at.items()}
        at |= {axis.nuisance.name: axis.at(places) for axis in nodes.axes}
        return sum((prior.misfit(one.with_others(at)) for one, prior in known), np.zeros(places.size))

    return CandidateCriterion(
        nodes,
        equations / sizes,
        power / np.outer(sizes, sizes),
        misfit,
        float(theta[place]),
        float(sizes[0] / sizes[1]),
    )
