"""Block bootstrap of an estimate, of moments and of pooled flights, and intervals from replicates."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import scipy

from eivor import checks
from eivor.errors import EivorError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod, check_method
from eivor.estimation.methods import by_name
from eivor.estimation.moments import CrossMoments, Instrumental, Moments, TriangularMoments
from eivor.estimation.variable_projection import Nodes, argmin, nodes_of
from eivor.estimation.weighting import SpectralWhitening, divided, whitened_by_residuals
from eivor.inference.distributions import normal_quantile, t_quantile
from eivor.inference.estimating_equation import Products, products_of_rows
from eivor.linalg.system import LinearSystem, Solver
from eivor.models.regression import LinearProblem, Parameter, Regression, SampleRows
from eivor.models.separable import Prior, SeparableProblem, Values, values_of
from eivor.tools import Float, Int

#: Fewest starts of a block within its length, where rows allow it.
STEPS_PER_BLOCK = 8
#: Most atoms of which each is one row.
FINEST_ATOMS = 4096
#: Autocorrelations below so many standard errors are taken for zero (Politis and White 2004).
NEGLIGIBLE = 2.0


class BlockPlan(msgspec.Struct, frozen=True):
    """Rows in atoms, and atoms in blocks of one length, the record joined end to start."""

    rows: int
    blocks: int
    steps: int  # Atoms of a block

    @property
    def atoms(self) -> int:
        """Atoms of the record, and of every replicate."""
        return self.blocks * self.steps

    @property
    def block_length(self) -> float:
        """Rows of a block."""
        return self.rows / self.blocks

    @property
    def bounds(self) -> Int[np.ndarray, " atoms_plus_1"]:
        """First row of each atom, and the number of rows."""
        return np.arange(self.atoms + 1) * self.rows // self.atoms

    def drawn(self, random: np.random.Generator) -> Int[np.ndarray, " k"]:
        """Blocks of one replicate, in its order, each by the atom that it begins with."""
        return random.integers(0, self.atoms, self.blocks)


def block_plan(rows: int, length: float) -> BlockPlan:
    """Plan with blocks of about `length` rows, so many that they fill the record."""
    blocks = min(max(round(rows / length), 1), rows)
    steps = min(rows // blocks, max(STEPS_PER_BLOCK, FINEST_ATOMS // blocks))
    return BlockPlan(rows, blocks, steps)


def automatic_block_length(series: Float[np.ndarray, "rows n"]) -> float:
    """Block length that makes the variance of a mean most accurate, for the most persistent series."""
    rows = series.shape[0]
    longest = min(3.0 * math.sqrt(rows), rows / 3.0)
    centred = series - series.mean(axis=0)
    lengths = [_optimal_length(column) for column in centred.T]
    return float(np.clip(max(lengths, default=1.0), 1.0, max(longest, 1.0)))


def _optimal_length(series: Float[np.ndarray, " rows"]) -> float:
    rows = series.size
    quiet = max(5, math.ceil(math.sqrt(math.log10(rows)))) if rows > 1 else 5
    longest = min(math.ceil(math.sqrt(rows)) + quiet, rows - 1)
    R = autocovariance(series, longest)
    if not R[0] > 0.0 or longest < 1:
        return 1.0
    small = np.abs(R[1:] / R[0]) < NEGLIGIBLE * math.sqrt(math.log10(rows) / rows)
    # first lag that is followed by `quiet` negligible ones; else the last one that is not negligible
    in_a_row = np.convolve(small, np.ones(quiet), mode="valid") if small.size >= quiet else np.empty(0)
    indices = np.flatnonzero(in_a_row == quiet)
    cutoff = int(indices[0]) if indices.size else int(np.flatnonzero(~small)[-1] + 1 if (~small).any() else 0)
    lags = np.arange(min(2 * max(cutoff, 1), longest) + 1)
    window = np.minimum(1.0, 2.0 * (1.0 - lags / (2 * max(cutoff, 1))))
    weighted = window * R[: lags.size]
    g = float(2.0 * weighted.sum() - weighted[0])
    G = float(2.0 * (lags * weighted).sum())
    D = 4.0 / 3.0 * g * g
    return (2.0 * G * G / D * rows) ** (1.0 / 3.0) if D > 0.0 else 1.0


def autocovariance(series: Float[np.ndarray, " rows"], lags: int) -> Float[np.ndarray, " lags_plus_1"]:
    """Mean products of a centred series with itself, divided by its length, at lags 0 to `lags`."""
    size = 1 << (2 * series.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(series, size)) ** 2
    products: Float[np.ndarray, " lags_plus_1"] = np.fft.irfft(spectrum, size)[: lags + 1]
    return products / series.size


def block_sums(
    atom_sums: Float[np.ndarray, "atoms *columns"], plan: BlockPlan
) -> Float[np.ndarray, "atoms *columns"]:
    """Sums over the atoms of the block that begins with each."""
    wrapped = np.concatenate([atom_sums, atom_sums[: plan.steps - 1]])
    total = atom_sums.copy()
    for step in range(1, plan.steps):
        total += wrapped[step : step + plan.atoms]
    return total


def check_draws(runs: int, seed: int | np.random.Generator) -> None:
    """Refuse fewer replicates than two, and a seed that is none."""
    checks.counted("runs", runs, 2, "two runs or more", "A thousand are usual.")
    kinds = (int, np.integer, np.random.Generator)
    checks.kind("seed", seed, kinds, "a whole number or a numpy.random.Generator", "Give 0, for example.")
    if not isinstance(seed, np.random.Generator):
        checks.seed(seed)


@dataclass(frozen=True)
class Bootstrap:
    """Replicates of an estimate.

    Raises
    ------
    UsageError
        When fewer than two replicates gave an estimate.
    """

    names: tuple[str, ...]  # Of the quantities
    units: tuple[str, ...]  # Of the quantities
    values: Float[np.ndarray, " n"]  # The estimate that the replicates are replicates of
    replicates: Float[np.ndarray, "runs n"]  # Of those runs that gave an estimate
    failed: int  # Runs that did not
    pieces: int  # Blocks, or flights, that a replicate is put together from
    block_length: float  # Rows of a block; NaN when whole flights are drawn
    seed: int | None  # What the generator was made of; None when a generator was given

    def __post_init__(self) -> None:
        if self.replicates.shape[0] < 2:
            expected = "at least two replicates with an estimate"
            remedy = "Ask for more runs; where most fail, the data do not determine the parameters."
            raise UsageError(expected, f"{self.replicates.shape[0]}, and {self.failed} without", remedy)

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the replicates, times c / (c - 1): c pieces vary about a mean of their own."""
        spread = self.replicates - self.replicates.mean(axis=0)
        expansion = self.pieces / (self.pieces - 1) if self.pieces > 1 else math.inf
        return np.asarray(spread.T @ spread / (spread.shape[0] - 1) * expansion)

    def std_error(self, name: str) -> float:
        """Root of the quantity's variance, see `covariance`."""
        position = checks.index_of("a quantity", name, self.names)
        return math.sqrt(float(self.covariance[position, position]))

    def bias(self, name: str) -> float:
        """Mean of the replicates minus the value."""
        position = checks.index_of("a quantity", name, self.names)
        return float(self.replicates[:, position].mean() - self.values[position])

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Quantiles of the replicates, their distances from the value expanded as c pieces are few.

        Of c pieces they are sqrt(c / (c - 1)) t / z times as long (Hesterberg 2015).

        Raises
        ------
        UsageError
            When the level is not between 0 and 1 or needs more replicates than there are.
        """
        position = checks.index_of("a quantity", name, self.names)
        checks.level(level)
        if self.pieces < 2:
            return -math.inf, math.inf
        value, values = float(self.values[position]), self.replicates[:, position]
        # order statistics (R + 1) p of R runs: another replicate is below the p-quantile with probability p
        needed = math.ceil(2.0 / (1.0 - level) * (1.0 - 1e-12)) - 1
        if values.size < needed:
            expected = f"{needed} replicates or more for a level of {level:g}"
            raise UsageError(expected, f"{values.size}", "Draw more runs, or ask for a lower level.")
        low, high = np.quantile(values, [0.5 - 0.5 * level, 0.5 + 0.5 * level], method="weibull").tolist()
        expansion = math.sqrt(self.pieces / (self.pieces - 1)) * t_quantile(level, self.pieces - 1)
        expansion /= normal_quantile(level)
        return value + expansion * (low - value), value + expansion * (high - value)


def products_by_flight(rows: Regression) -> Products:
    """Products of all columns of rows, a block for each flight."""
    flights = rows.layout.flight_of_row
    order = np.argsort(flights, kind="stable")
    edges = np.append(np.flatnonzero(np.diff(flights[order], prepend=-1)), order.size)
    columns = (part[order] for part in (rows.instruments, rows.regressors, rows.response))
    return products_of_rows(*columns, edges=edges)


#: Directions of a replicate's instruments with smaller shares of power are dropped.
SMALLEST_POWER = 1e-8


@dataclass(frozen=True)
class Replicate:
    """The estimate of one draw of flights."""

    nuisances: Values  # Value of every nuisance
    theta: Float[np.ndarray, " n"]
    weights: Float[np.ndarray, " T"]


@dataclass(frozen=True)
class PoolFlights:
    """A pool, ready to be estimated again from any draw of its flights."""

    flights: tuple[int, ...]  # Numbers of the flights that have rows
    nodes: Nodes
    products: Products
    misfit: Float[np.ndarray, " q"]
    variance: float  # s^2 of the pool's whitened rows
    parameters: tuple[Parameter, ...]
    solver: Solver
    known: Mapping[str, Prior]

    @property
    def full(self) -> Replicate:
        return self._estimated(np.ones(len(self.flights)), self.known)

    def replicate(self, random: np.random.Generator) -> tuple[Replicate, Float[np.ndarray, " F"]]:
        """As many flights as there are, drawn with replacement: their estimate, and how often each counts."""
        count = len(self.flights)
        times = np.bincount(random.integers(0, count, count), minlength=count).astype(np.float64)
        drawn = {name: random.normal(prior.mean, prior.std) for name, prior in self.known.items()}
        known = {name: replace(self.known[name], mean=mean) for name, mean in drawn.items()}
        return self._estimated(times, known), times

    def _estimated(self, times: Float[np.ndarray, " F"], known: Mapping[str, Prior]) -> Replicate:
        """Search the nuisances and solve for the linear parameters."""
        drawn = self.products.weighted(times)
        equations = drawn.equations.copy()
        equations[:, :, -1] -= self.misfit
        powers, directions = scipy.linalg.eigh(drawn.instruments[0])
        strong = powers > SMALLEST_POWER * powers[-1]
        equations = np.asarray((directions[:, strong] / np.sqrt(powers[strong])).T) @ equations

        def objective(box: Sequence[Float[np.ndarray, " _"]]) -> Float[np.ndarray, " points"]:
            squares = residual_squares(self.nodes.over(equations, box))
            return squares + self.variance * self.nodes.misfit(self.nodes.values_over(box), known)

        position = argmin(objective, self.nodes.places)
        values = self.nodes.values_at(position)
        weights = self.nodes.weights(values_of([values]))[0]
        system = np.tensordot(weights, equations, 1)
        theta = self.solver.solve(LinearSystem(system[:, :-1], system[:, -1])).theta
        return Replicate(values, theta, weights)


def pool_flights(problem: SeparableProblem, estimate: Estimate) -> PoolFlights:
    """Multiply the flights of a pool."""
    method = by_name(estimate.method)
    if not (
        isinstance(method, LinearMethod)
        and isinstance(method.assembler, Instrumental)
        and isinstance(method.row_weighting, SpectralWhitening)
    ):
        expected = "an estimate by whitened instruments (reference_iv)"
        raise UsageError(expected, f"one by {method.name}", "Identify the pool with the default method.")
    flights = np.unique(problem.bins(estimate.nuisances).layout.flight_of_row).tolist()
    if len(flights) < 2:
        remedy = "Give several flights to identify_flight; ten or more make good intervals."
        raise UsageError("a pool of two flights or more with usable runs", f"{len(flights)}", remedy)
    nodes = nodes_of(problem.nuisances)
    weights = whitened_by_residuals(problem, estimate.theta, estimate.nuisances)
    residual = products_by_flight(weights.rows(estimate.nuisances)).total.with_residual(estimate.theta)
    # flight after flight, a block for each node
    tables = [products_by_flight(weights.rows(point)) for point in nodes.points]
    counts = np.stack([table.counts for table in tables], axis=1)
    sums = np.stack([table.sums for table in tables], axis=1)
    return PoolFlights(
        tuple(flights),
        nodes,
        replace(tables[0], counts=counts.ravel(), sums=sums.reshape(-1, *sums.shape[2:])),
        residual.instrument_response[0],
        estimate.residual_variance(),
        estimate.rows.parameters,
        method.solver,
        {
            item.name: replace(item.prior, mean=item.with_others(estimate.nuisances))
            for item in problem.nuisances
            if item.searched and item.prior is not None
        },
    )


def residual_squares(equations: Float[np.ndarray, "k q n_plus_1"]) -> Float[np.ndarray, " k"]:
    """Residual sum of squares of many small systems [A b]."""
    columns = np.moveaxis(equations, 2, 0).copy()
    for j, column in enumerate(columns[:-1]):
        power = np.einsum("kq,kq->k", column, column)
        shares = np.einsum("mkq,kq->mk", columns[j + 1 :], column)
        shares = np.divide(shares, power, out=np.zeros(shares.shape), where=power > 0.0)
        columns[j + 1 :] -= shares[:, :, None] * column
    return np.asarray(np.einsum("kq,kq->k", columns[-1], columns[-1]))


def replicate_moments(
    rows: Regression, method: LinearMethod, full: Moments, plan: BlockPlan
) -> Callable[[Int[np.ndarray, " k"]], Moments]:
    """Make moments of a replicate from the blocks that were drawn, by products of the pieces of a plan."""
    Phi, y, psi = rows.regressors, rows.response, method.assembler.test_functions(rows)
    if isinstance(full, TriangularMoments):  # in the coordinates of the root
        diagonal = np.diag(full.root)
        safe = full.root + np.diag(np.where(diagonal == 0.0, 1.0, 0.0))
        Q = scipy.linalg.solve_triangular(safe, np.column_stack([Phi, y]).T, trans="T").T
        Phi, y, psi = Q[:, :-1], Q[:, -1], np.empty((y.size, 0))
    atoms = products_of_rows(psi, Phi, y, edges=plan.bounds)
    pieces = replace(atoms, counts=block_sums(atoms.counts, plan), sums=block_sums(atoms.sums, plan))

    def moments(drawn: Int[np.ndarray, " k"]) -> Moments:
        replicate = pieces.resampled(drawn)
        if not isinstance(full, TriangularMoments):
            return CrossMoments(replicate, full.noise)
        powers, directions = np.linalg.eigh(replicate.sums[0])
        half = np.sqrt(np.maximum(powers, 0.0))[:, None] * directions.T
        return TriangularMoments(replicate.count, half @ full.root, full.noise)

    return moments


#: Replicates that are made when their number is not named; with one more, tails are whole numbers.
RUNS = 999


def bootstrap(
    problem: LinearProblem,
    method: LinearMethod,
    *,
    runs: int = RUNS,
    block_length: int | None = None,
    seed: int | np.random.Generator = 0,
) -> Bootstrap:
    """Bootstrap an estimate by blocks of successive rows.

    Parameters
    ----------
    problem : Regression or SignalRegression
        Rows in time order. Where a mask left some out, the gaps are closed.
    method : LinearMethod
        One of `eivor.methods`.
    runs : int
        Replicates to make.
    block_length : int, optional
        Rows of a block. Default: Politis and White's automatic length for the estimate's influence of
        each row, the longest over the parameters. One makes it the bootstrap of independent rows.
    seed : int or numpy.random.Generator
        The same seed gives the same replicates.

    Returns
    -------
    Bootstrap
        Replicates of the parameters.

    Raises
    ------
    UsageError
        For flights and moments, whose rows are not samples of one record, and for numbers out of range.
    EstimationError, TooFewSamplesError
        When the problem itself has no estimate.

    Notes
    -----
    A replicate is the sum of its blocks' moments, made once in a pass over the rows. It costs as much as
    there are blocks (many short ones where scores are white, some N^(2/3) where they are not), and one
    solution of the method's equations. The noise that
    compensated methods subtract, C and c, is the declared one in every replicate. So is a weight that is
    made of residuals (`TwoStepRobust`); this changes the estimate to second order only.
    """
    check_method(method)
    rows = _sample_rows(problem)
    check_draws(runs, seed)
    full = method.moments(problem)
    solved = method.solve_moments(full, problem, check=True)
    plan = block_plan(rows.response.size, _length(block_length, solved))
    factor = None if method.equation_weighting.passes == 1 else solved.factor
    moments, random = replicate_moments(rows, method, full, plan), np.random.default_rng(seed)
    results = [_estimated_again(method, moments(plan.drawn(random)), factor) for _ in range(runs)]
    replicates = [result for result in results if result is not None]
    return Bootstrap(
        rows.names,
        rows.units,
        solved.theta,
        np.array(replicates).reshape(len(replicates), rows.regressors.shape[1]),
        runs - len(replicates),
        plan.blocks,
        plan.block_length,
        None if isinstance(seed, np.random.Generator) else seed,
    )


def _estimated_again(
    method: LinearMethod, moments: Moments, factor: Float[np.ndarray, "p p"] | None
) -> Float[np.ndarray, " n"] | None:
    """Parameters of a replicate, with the sample's weight where it is made of residuals; None on failure."""
    try:
        if factor is None:
            theta = method.solve_moments(moments).theta
        else:
            theta = method.solver.solve(divided(method.assembler.system(moments), factor)).theta
    except (EivorError, np.linalg.LinAlgError):
        return None
    return theta if np.isfinite(theta).all() else None


def _sample_rows(problem: LinearProblem) -> Regression:
    remedy = "Use bootstrap_flights for flights; moments have no rows to draw again."
    checks.kind("problem", problem, LinearProblem, "a regression of rows in time", remedy)
    rows = problem.rows()
    flights = rows.layout.flight_of_row
    if not isinstance(rows.layout, SampleRows) or np.any(flights != flights[0]):
        expected = "rows that are the samples of one record"
        remedy = "Use bootstrap_flights, or one record after the other."
        raise UsageError(expected, "rows of several flights, or of a spectrum", remedy)
    return rows


def _length(length: int | None, solved: Estimate) -> float:
    equation, count = solved.equation, round(solved.count)
    if length is None:  # by what each row moves the parameters by
        return automatic_block_length(np.linalg.solve(equation.slope, equation.rows.scores.T).T)
    checks.whole("block_length", length)
    if not 1 <= length <= count // 2:
        expected = f"a block length from 1 to {count // 2} rows, half of what there is"
        raise UsageError(expected, f"{length}", "Choose another.")
    return float(length)
