"""Functions of parameters by the delta method, and confidence sets of single parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import by_name
from eivor.estimation.moments import Instrumental
from eivor.estimation.variable_projection import Nodes, NuisanceScan, Points, nodes_of
from eivor.estimation.weighting import RowWeighting
from eivor.inference.anderson_rubin import allowed, least_ratio
from eivor.inference.confidence_set import ConfidenceSet, gradient_of, principal_axes, profile_interval
from eivor.inference.covariance import CovariancePart, JointEstimate
from eivor.inference.distributions import check_level, chi_square_quantile, t_quantile
from eivor.inference.regions import fieller_set
from eivor.models.regression import Regression
from eivor.models.separable import SeparableProblem
from eivor.models.spectral import BinRows
from eivor.tools import Bool, Float, Int

# -- Confidence sets of single parameters --

#: Degrees of freedom of the cosine averages, whose quantile the profile set takes over.
DEGREES = 8


#: Instruments that move the rows by less than this share are none of them.
INDEPENDENT = 1e-6


@dataclass(frozen=True)
class ParameterEquations:
    """Rows, regressors and instruments that go with one parameter."""

    rows: Bool[np.ndarray, " rows"]
    regressors: Int[np.ndarray, " own"]
    instruments: Float[np.ndarray, "own_rows q"]

    def columns(
        self, columns: Float[np.ndarray, "points rows n_plus_1"], theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "points own_rows own_plus_1"]:
        """Residual at some parameters, and the regressors, of [phi y] of the same rows at several points."""
        column = columns[:, self.rows]
        residual = column[:, :, -1] - column[:, :, :-1] @ theta
        return np.concatenate([residual[:, :, None], column[:, :, self.regressors]], axis=2)


def parameter_equations(rows: Regression, position: int) -> ParameterEquations:
    """Equations of the parameter of some number."""
    involved = rows.regressors[:, position] != 0.0
    moving = np.flatnonzero(rows.regressors[involved].any(axis=0))
    others = moving[moving != position]
    instruments = rows.instruments
    if not involved.all():
        basis, sizes, _ = np.linalg.svd(instruments[involved], full_matrices=False)
        instruments = basis[:, sizes > INDEPENDENT]
    return ParameterEquations(involved, np.array([position, *others]), instruments)


@dataclass(frozen=True)
class ParameterSets:
    """Three 95 % sets of one parameter, or of another level."""

    wald: ConfidenceSet  # The estimate plus and minus, a union over the candidates that fit
    profile: ConfidenceSet
    anderson_rubin: ConfidenceSet
    strange: tuple[str, ...] = ()

    @property
    def robust(self) -> ConfidenceSet:
        """The Anderson-Rubin set, but never less than the profile set."""
        return ConfidenceSet.union((*self.anderson_rubin.intervals, *self.profile.intervals))


@dataclass(frozen=True)
class CandidateCriterion:
    """The criterion at one combination of discrete nuisances."""

    nodes: Nodes
    equations: Float[np.ndarray, "T q m"]
    power: Float[np.ndarray, "T m m"]  # Their products with each other, over rows less unknowns
    misfit: Callable[[Points], Points]
    centre: float
    scale: float

    def _forms(self, positions: Points) -> tuple[Float[np.ndarray, "k m m"], Float[np.ndarray, "k m m"]]:
        box = self.nodes.box(positions)
        equations = self.nodes.over(self.equations, box)
        return equations.transpose(0, 2, 1) @ equations, self.nodes.over(self.power, box)

    def least(self, positions: Points) -> Points:
        """Least J at each place."""
        return least_ratio(*self._forms(positions)) + self.misfit(positions)

    @cached_property
    def scan(self) -> NuisanceScan:
        """The least J over the continuous nuisance."""
        return NuisanceScan(self.nodes, self.least)

    def below(self, bound: float) -> list[tuple[float, float]]:
        """Values of the parameter at which J is at most a bound, as pieces that may overlap."""
        results: list[tuple[float, float]] = []
        for within, cut_short in self.scan.stretches(bound):
            fitting = allowed(*self._forms(within), bound - self.misfit(within))
            pieces = fitting.continued() if cut_short else fitting.pieces()
            results += [(self.centre + a * self.scale, self.centre + b * self.scale) for a, b in pieces]
        return results


def parameter_sets(
    problem: SeparableProblem, estimate: Estimate, name: str, level: float = 0.95
) -> ParameterSets | None:
    """Confidence sets of one linear parameter."""
    check_level(level)
    parameters = [parameter.name for parameter in estimate.rows.parameters]
    if name not in parameters:
        raise UsageError(f"a parameter out of {', '.join(parameters)}", f"'{name}'", "Name one of them.")
    method, nodes = by_name(estimate.method).of_flights, nodes_of(problem.nuisances)
    if not (
        isinstance(method, LinearMethod)
        and isinstance(method.assembler, Instrumental)
        and isinstance(estimate.rows.layout, BinRows)
        and len(nodes.axes) < 2
    ):
        return None
    index = parameters.index(name)
    criteria = [_criterion(problem, nodes, item, index, method.row_weighting) for item in estimate.candidates]
    try:
        least = estimate.least_comparable_criteria([criterion.scan.minimum[1] for criterion in criteria])
    except np.linalg.LinAlgError:
        return None
    best = estimate
    equations = parameter_equations(best.rows, index)
    held = set(equations.regressors.tolist())
    strange = tuple(other for number, other in enumerate(parameters) if number not in held)
    degrees = equations.instruments.shape[1] + len(best.misfits) - (best.unknowns - len(strange) - 1)

    uncertainty, highest = t_quantile(level, DEGREES) ** 2, chi_square_quantile(level, max(degrees, 1))
    compared = list(zip(least, criteria, strict=True))
    return ParameterSets(
        ConfidenceSet((estimate.interval(name, level),)),
        ConfidenceSet.union(piece for lowest, item in compared for piece in item.below(lowest + uncertainty)),
        ConfidenceSet.union(piece for criterion in criteria for piece in criterion.below(highest)),
        strange,
    )


def nuisance_sets(
    problem: SeparableProblem, estimate: Estimate, names: Sequence[str], level: float = 0.95
) -> ParameterSets | None:
    """Confidence sets of a continuous nuisance, or of its sum with the discrete ones that are named."""
    method, nodes = by_name(estimate.method).of_flights, nodes_of(problem.nuisances)
    if not (
        isinstance(method, LinearMethod)
        and isinstance(method.assembler, Instrumental)
        and isinstance(estimate.rows.layout, BinRows)
        and len(nodes.axes) == 1
        and nodes.axes[0].nuisance.name == names[0]
    ):
        return None
    (axis,) = nodes.axes
    candidates = [
        (item, _criterion(problem, nodes, item, 0, method.row_weighting)) for item in estimate.candidates
    ]
    try:
        least = estimate.least_comparable_criteria([scan.scan.minimum[1] for _, scan in candidates])
    except np.linalg.LinAlgError:
        return None
    equations = parameter_equations(estimate.rows, 0)
    degrees = equations.instruments.shape[1] + len(estimate.misfits) - (estimate.unknowns - 1)
    uncertainty, highest = t_quantile(level, DEGREES) ** 2, chi_square_quantile(level, max(degrees, 1))

    def below(bounds: Sequence[float]) -> ConfidenceSet:
        pieces = []
        for (candidate, criterion), bound in zip(candidates, bounds, strict=True):
            others = sum(candidate.nuisances[name] for name in names[1:])
            for within, cut_short in criterion.scan.stretches(bound):
                low, high = axis.values_at(within[[0, -1]]).tolist()
                low = 0.0 if axis.nuisance.positive and within[0] == axis.nodes[0] else low
                pieces.append((others + low, math.inf if cut_short else others + high))
        return ConfidenceSet.union(pieces)

    return ParameterSets(
        ConfidenceSet((estimate.interval(names[0], level),)),
        below([lowest + uncertainty for lowest in least]),
        below([highest] * len(candidates)),
    )


def _criterion(
    problem: SeparableProblem, nodes: Nodes, candidate: Estimate, position: int, weighting: RowWeighting
) -> CandidateCriterion:
    theta = candidate.theta
    weights = weighting.last_pass(problem, theta, candidate.nuisances)
    of_parameter = parameter_equations(weights.rows(candidate.nuisances), position)
    unknowns = candidate.unknowns - (theta.size - of_parameter.regressors.size)
    points = [{**candidate.nuisances, **point} for point in nodes.points]
    columns = of_parameter.columns(weights.columns(points), theta)
    equations = of_parameter.instruments.T @ columns
    power = columns.transpose(0, 2, 1) @ columns / (columns.shape[1] - unknowns)
    lengths = np.sqrt(np.diagonal(np.mean(power, axis=0)))
    sizes = np.where(lengths > 0.0, lengths, 1.0)

    searched = [nuisance for nuisance in problem.nuisances if nuisance.searched]
    known = [(nuisance, nuisance.prior) for nuisance in searched if nuisance.prior is not None]

    def misfit(positions: Points) -> Points:
        index = {name: np.full(positions.size, value) for name, value in candidate.nuisances.items()}
        index |= {axis.nuisance.name: axis.values_at(positions) for axis in nodes.axes}
        return sum((prior.misfit(item.with_others(index)) for item, prior in known), np.zeros(positions.size))

    centre, scale = float(theta[position]), float(sizes[0] / sizes[1])
    return CandidateCriterion(nodes, equations / sizes, power / np.outer(sizes, sizes), misfit, centre, scale)


# -- Derived --

#: Share of the half-width by which a function may bend before it is profiled.
LARGEST_BEND = 0.05

Function = Callable[[Mapping[str, float]], float]
OfVector = Callable[[Float[np.ndarray, " n"]], float]


@dataclass(frozen=True, slots=True)
class DerivedQuantity:
    """A function of the parameters."""

    value: float  # At the estimate
    std_error: float
    interval: tuple[float, float]  # Lowest and highest value
    bend: float
    profiled: bool


def derived(estimate: Estimate, function: Function, level: float = 0.95) -> DerivedQuantity:
    """A smooth function of the parameters, with its interval.

    Parameters
    ----------
    estimate : Estimate
        With its covariance at hand.
    function : callable
        From the mapping of names to values, such as ``lambda p: p["gain"] / p["friction"]``.
        For a ratio whose denominator may be near zero use `ratio`.
    level : float
        Confidence level.

    Raises
    ------
    UsageError
        When the level is not between 0 and 1, or the function is not finite within the interval.
    """
    check_level(level)
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    if not callable(function):
        raise UsageError(
            "a function of the parameters",
            checks.described(function),
            'Give lambda p: p["theta_1"] ** 2, for example.',
        )

    def of_vector(values: Float[np.ndarray, " n"]) -> float:
        result = function(dict(zip(estimate.names, (float(value) for value in values), strict=True)))
        checks.number("what the function gives", result)
        return float(result)

    results = derived_from(of_vector, joint_estimates(estimate, level), level)
    numbers = (results.value, results.std_error, *results.interval)
    if math.isnan(results.bend) or not np.isfinite(numbers).all():
        expected = "a function that is finite within the interval"
        remedy = "For a ratio whose denominator may be zero use eivor.ratio."
        raise UsageError(expected, f"{results.value} with the interval {results.interval}", remedy)
    return results


def joint_estimates(estimate: Estimate, level: float) -> tuple[JointEstimate, ...]:
    """Vectors of the candidates that fit, the best first."""
    others = [item for item in estimate.tenable(level) if item is not estimate]
    return tuple(JointEstimate(item.values, item.joint_covariance) for item in (estimate, *others))


def derived_from(
    function: OfVector, candidates: Sequence[JointEstimate], level: float, largest_bend: float = LARGEST_BEND
) -> DerivedQuantity:
    """A smooth function of a vector of estimates, with an interval that is a union over candidates."""
    parts = [(candidate, part) for candidate in candidates for part in candidate.covariance.parts]
    pieces = [_of_part(function, candidate, part, level, largest_bend) for candidate, part in parts]
    best = candidates[0]
    scale = np.sqrt(np.diag(best.covariance.matrix))
    return DerivedQuantity(
        value=function(best.values),
        std_error=best.covariance.std_error(gradient_of(function, best.values, scale)),
        interval=(min(piece.interval[0] for piece in pieces), max(piece.interval[1] for piece in pieces)),
        bend=max(piece.bend for piece in pieces),
        profiled=any(piece.profiled for piece in pieces),
    )


def ratio(
    estimate: Estimate, numerator: str | float | int, denominator: str | float | int, level: float = 0.95
) -> ConfidenceSet:
    """Confidence set of a ratio of parameters, or of a number and a parameter, by Fieller's method.

    Parameters
    ----------
    estimate : Estimate
        With its covariance at hand.
    numerator, denominator : str or float
        Name of a parameter, or an exact number: ``ratio(fit, 1.0, "friction")`` is the time
        constant 1/K [s].
    level : float
        Confidence level.

    Returns
    -------
    ConfidenceSet
        Without a bound when the denominator cannot be distinguished from zero. A union over the
        candidates that fit, and over the assumptions of the covariance.

    Raises
    ------
    UsageError
        When a name is unknown, or the level is not between 0 and 1.
    """
    check_level(level)
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    for name, item in (("numerator", numerator), ("denominator", denominator)):
        if not isinstance(item, str):
            checks.number(name, item)
    pair, nothing = (numerator, denominator), np.zeros(len(estimate.names))
    exact = np.array([0.0 if isinstance(entry, str) else float(entry) for entry in pair])
    rows = np.stack([estimate.direction(entry) if isinstance(entry, str) else nothing for entry in pair])
    intervals: list[tuple[float, float]] = []
    for candidate in estimate.tenable(level):
        for part in candidate.joint_covariance.parts:
            values, V = exact + rows @ candidate.values, rows @ part.matrix @ rows.T
            intervals.extend(fieller_set(values, V, _half_widths(part, level)).intervals)
    return ConfidenceSet.union(intervals)


def _half_widths(part: CovariancePart, level: float) -> float:
    return t_quantile(level, part.degrees) / math.sqrt(part.share)


def _of_part(
    function: OfVector, candidate: JointEstimate, part: CovariancePart, level: float, largest_bend: float
) -> DerivedQuantity:
    values, t = candidate.values, _half_widths(part, level)
    gradient = gradient_of(function, values, np.sqrt(np.diag(part.matrix)))
    error = math.sqrt(part.variance(gradient))
    centre, half = function(values), t * error
    axes = list(principal_axes(part.matrix, t).T)
    if half > 0.0:
        axes.append(t * part.matrix @ gradient / error)
    away = max(
        abs(function(values + sign * axis) - centre - sign * float(gradient @ axis))
        for axis in axes
        for sign in (-1.0, 1.0)
    )
    bend = away / half if half > 0.0 else (0.0 if away == 0.0 else math.inf)
    if bend <= largest_bend:
        return DerivedQuantity(centre, error, (centre - half, centre + half), bend, profiled=False)
    interval = profile_interval(function, values, part.matrix, t)
    return DerivedQuantity(centre, error, interval, bend, profiled=True)
