"""Functions of parameters by the delta method, and confidence sets of single parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import cast

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import by_name
from eivor.estimation.moments import Instrumental
from eivor.estimation.variable_projection import Nodes, NuisanceScan, Points, nodes_of
from eivor.inference.anderson_rubin import allowed, least_ratio
from eivor.inference.confidence_set import ConfidenceSet, gradient_of, principal_axes, profile_interval
from eivor.inference.covariance import CovariancePart, JointEstimate
from eivor.inference.distributions import check_level, chi_square_quantile, t_quantile
from eivor.inference.regions import fieller_set
from eivor.models.regression import Regression
from eivor.models.separable import Prior, SeparableProblem, Values
from eivor.models.spectral import BinRows
from eivor.tools import Bool, Float, Int

# -- Confidence sets of single parameters --

#: Degrees of freedom of the cosine averages, whose quantile the profile set takes over.
DEGREES = 8


#: Places at which a profile over further nuisances is compared with its bound.
PROFILE_POINTS = 2001
#: More parameters have no sets: of several axes that share nuisances these take too long.
FEW_PARAMETERS = 8
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

    wald: ConfidenceSet  # The estimate plus and minus
    profile: ConfidenceSet
    anderson_rubin: ConfidenceSet
    strange: tuple[str, ...] = ()

    @property
    def robust(self) -> ConfidenceSet:
        """The Anderson-Rubin set, but never less than the profile set."""
        return ConfidenceSet.union((*self.anderson_rubin.intervals, *self.profile.intervals))


@dataclass(frozen=True)
class Criterion:
    """The criterion over the first nuisance, at values of the others."""

    nodes: Nodes
    equations: Float[np.ndarray, "T q m"]
    power: Float[np.ndarray, "T m m"]  # Their products with each other, over rows less unknowns
    known: Mapping[str, Prior]
    theta: Float[np.ndarray, " n"]
    sizes: Float[np.ndarray, " m"]  # What columns were divided by
    position: int = 0  # Of the parameter that sets are of

    def first(self, position: int) -> Criterion:
        """The same criterion for sets of another parameter."""
        result = replace(self, position=position)
        result.__dict__["scan"] = self.scan
        return result

    def misfit(self, positions: Points) -> Points:
        """Squared distance from what is known beforehand, in standard errors."""
        return self.nodes.misfit(self.nodes.box(positions), self.known)

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
        order = [0, 1 + self.position, *(1 + j for j in range(self.theta.size) if j != self.position)]
        centre, scale = float(self.theta[self.position]), float(self.sizes[0] / self.sizes[1 + self.position])
        for within, cut_short in self.scan.stretches(bound):
            N, D = (form[:, order][:, :, order] for form in self._forms(within))
            fitting = allowed(N, D, bound - self.misfit(within))
            pieces = fitting.continued() if cut_short else fitting.pieces()
            results += [(centre + a * scale, centre + b * scale) for a, b in pieces]
        return results


@dataclass(frozen=True)
class ProfileSets:
    """Confidence sets of linear parameters and of nuisances, from the criterion over the nuisances."""

    problem: SeparableProblem
    estimate: Estimate

    @cached_property
    def nodes(self) -> Nodes:
        """Nodes of the nuisances."""
        return nodes_of(self.problem.nuisances)

    @property
    def available(self) -> bool:
        """Whether the estimate is by instruments of rows in frequency, and of few parameters."""
        method = by_name(self.estimate.method).of_flights
        return (
            isinstance(method, LinearMethod)
            and isinstance(method.assembler, Instrumental)
            and isinstance(self.estimate.rows.layout, BinRows)
            and len(self.estimate.rows.parameters) <= FEW_PARAMETERS
        )

    def of_parameter(self, name: str, level: float = 0.95) -> ParameterSets | None:
        """Sets of one linear parameter."""
        check_level(level)
        estimate, parameters = self.estimate, [item.name for item in self.estimate.rows.parameters]
        if name not in parameters:
            raise UsageError(f"a parameter out of {', '.join(parameters)}", f"'{name}'", "Name one of them.")
        if not self.available:
            return None
        equations = parameter_equations(estimate.rows, parameters.index(name))
        if equations.rows.all() and equations.regressors.size == len(parameters):
            criteria = [item.first(parameters.index(name)) for item in self._of_all_rows]
        else:
            criteria = self._criteria(equations)
        try:
            least = min(criterion.scan.minimum[1] for criterion in criteria)
        except np.linalg.LinAlgError:
            return None
        held = set(equations.regressors.tolist())
        strange = tuple(other for number, other in enumerate(parameters) if number not in held)
        unknowns = estimate.unknowns - len(strange) - 1
        degrees = equations.instruments.shape[1] + len(estimate.misfits) - unknowns + estimate.undetermined

        def below(bound: float) -> ConfidenceSet:
            return ConfidenceSet.union(piece for criterion in criteria for piece in criterion.below(bound))

        return ParameterSets(
            ConfidenceSet((estimate.interval(name, level),)),
            below(least + t_quantile(level, DEGREES) ** 2),
            below(chi_square_quantile(level, max(degrees, 1))),
            strange,
        )

    def of_nuisances(self, names: Sequence[str], level: float = 0.95) -> ParameterSets | None:
        """Sets of the sum of some nuisances; None where none of them is searched for."""
        searched = {axis.nuisance.name for axis in self.nodes.axes}
        if not self.available or not searched & set(names):
            return None
        scans, estimate = [criterion.scan for criterion in self._of_all_rows], self.estimate
        try:
            least = min(scan.minimum[1] for scan in scans)
        except np.linalg.LinAlgError:
            return None
        degrees = estimate.rank + len(estimate.misfits) - estimate.theta.size
        bounds = least + t_quantile(level, DEGREES) ** 2, chi_square_quantile(level, max(degrees, 1))
        direction = sum(estimate.direction(name) for name in names if name in searched)
        here = sum(estimate.nuisances[name] for name in names)
        half = estimate.joint_covariance.half_width(np.asarray(direction), level)
        profile, robust = (sum_set(scans, names, estimate.nuisances, bound) for bound in bounds)
        return ParameterSets(ConfidenceSet(((here - half, here + half),)), profile, robust)

    @cached_property
    def _of_all_rows(self) -> list[Criterion]:
        rows, regressors = self.estimate.rows.regressors.shape
        every = np.ones(rows, dtype=np.bool_), np.arange(regressors), self.estimate.rows.instruments
        return self._criteria(ParameterEquations(*every))

    @cached_property
    def _columns(self) -> Float[np.ndarray, "points rows n_plus_1"]:
        """[phi y] at every node."""
        method, theta = by_name(self.estimate.method).of_flights, self.estimate.theta
        weighting = cast("LinearMethod", method).row_weighting
        weights = weighting.last_pass(self.problem, theta, self.estimate.nuisances)
        return weights.columns(self.nodes.points)

    def _criteria(self, of_parameter: ParameterEquations) -> list[Criterion]:
        theta = self.estimate.theta
        unknowns = self.estimate.unknowns - (theta.size - of_parameter.regressors.size)
        columns = of_parameter.columns(self._columns, theta)
        equations = of_parameter.instruments.T @ columns
        power = columns.transpose(0, 2, 1) @ columns / (columns.shape[1] - unknowns)
        lengths = np.sqrt(np.diagonal(np.mean(power, axis=0)))
        sizes = np.where(lengths > 0.0, lengths, 1.0)
        equations, power = equations / sizes, power / np.outer(sizes, sizes)
        nodes, box = self.nodes.closer(self.estimate.nuisances)
        equations, power = self.nodes.over(equations, box), self.nodes.over(power, box)
        priors = {axis.nuisance.name: axis.nuisance.prior for axis in self.nodes.axes}
        known = {name: prior for name, prior in priors.items() if prior is not None}
        theta = theta[of_parameter.regressors]
        return [
            Criterion(part, equations[index], power[index], known, theta, sizes)
            for part, index in nodes.slices()
        ]


def sum_set(scans: Sequence[NuisanceScan], names: Sequence[str], at: Values, bound: float) -> ConfidenceSet:
    """Values of the sum of some nuisances with a criterion of at most a bound, the estimate's among them."""
    here = sum(at[name] for name in names)
    first = scans[0].nodes.axes[0].nuisance
    if first.name not in names:
        return _profile_set(scans, names, here, bound)
    pieces = [(here, here)]
    for scan in scans:
        (axis,) = scan.nodes.axes
        others = sum(scan.nodes.fixed[name] for name in names if name != first.name)
        for within, cut_short in scan.stretches(bound):
            low, high = axis.values_at(within[[0, -1]]).tolist()
            if first.positive and within[0] == axis.nodes[0]:
                low = 0.0
            pieces.append((others + low, inf if cut_short else others + high))
    return ConfidenceSet.union(pieces)


def _profile_set(
    scans: Sequence[NuisanceScan], names: Sequence[str], here: float, bound: float
) -> ConfidenceSet:
    """The same of nuisances with a scan for each value: between them the root of the excess is straight."""
    values = np.array([sum(scan.nodes.fixed[name] for name in names) for scan in scans])
    minima = np.array([scan.minimum[1] for scan in scans])
    excesses = np.append(np.maximum(minima - minima.min(), 0.0), 0.0)
    order = np.argsort(np.append(values, here), kind="stable")
    values, roots = np.append(values, here)[order], np.sqrt(excesses[order])
    fine = np.unique(np.append(np.linspace(values[0], values[-1], PROFILE_POINTS), here))
    fits = np.interp(fine, values, roots) <= np.sqrt(max(bound - minima.min(), 0.0))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], fits, [False]])))
    return ConfidenceSet.union((float(fine[a]), float(fine[b - 1])) for a, b in edges.reshape(-1, 2).tolist())


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

    results = derived_from(of_vector, (JointEstimate(estimate.values, estimate.joint_covariance),), level)
    numbers = (results.value, results.std_error, *results.interval)
    if math.isnan(results.bend) or not np.isfinite(numbers).all():
        expected = "a function that is finite within the interval"
        remedy = "For a ratio whose denominator may be zero use eivor.ratio."
        raise UsageError(expected, f"{results.value} with the interval {results.interval}", remedy)
    return results


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
        assumptions of the covariance.

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
    for part in estimate.joint_covariance.parts:
        values, V = exact + rows @ estimate.values, rows @ part.matrix @ rows.T
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
