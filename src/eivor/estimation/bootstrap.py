"""Block bootstrap of an estimate, of moments and of pooled flights."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from eivor import checks
from eivor.errors import EivorError, UsageError
from eivor.estimation.estimate import Estimate, equation_map
from eivor.estimation.linear import LinearMethod, check_method
from eivor.estimation.methods import by_name
from eivor.estimation.moments import CrossMoments, Instrumental, Moments, TriangularMoments
from eivor.estimation.variable_projection import Nodes, argmin, nodes_of
from eivor.estimation.weighting import SpectralWhitening, divided, whitened_by_residuals
from eivor.inference.bootstrap import (
    BlockPlan,
    BlockScheme,
    Bootstrap,
    automatic_block_length,
    block_plan,
    check_draws,
    piece_sums,
)
from eivor.inference.products import Products, products_of_rows
from eivor.linalg.system import LinearSystem, Solver, triangular_root
from eivor.models.regression import LinearProblem, Parameter, Regression, SampleRows
from eivor.models.separable import Prior, SeparableProblem, Values
from eivor.tools import Float, Int


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
    def whole(self) -> Replicate:
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
        kept = powers > SMALLEST_POWER * powers[-1]
        equations = np.asarray((directions[:, kept] / np.sqrt(powers[kept])).T) @ equations

        def objective(box: Sequence[Float[np.ndarray, " _"]]) -> Float[np.ndarray, " points"]:
            left = left_over(self.nodes.over(equations, box))
            return left + self.variance * self.nodes.misfit(self.nodes.values_over(box), known)

        position = argmin(objective, self.nodes.nodes)
        weights = self.nodes.weights(position)
        both = np.tensordot(weights, equations, 1)
        theta = self.solver.solve(LinearSystem(both[:, :-1], both[:, -1])).theta
        return Replicate(self.nodes.values_at(position), theta, weights)


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


def left_over(equations: Float[np.ndarray, "k q n_plus_1"]) -> Float[np.ndarray, " k"]:
    """What least squares leaves of the last column of many small systems [A b], squared."""
    columns = np.moveaxis(equations, 2, 0).copy()
    for j, column in enumerate(columns[:-1]):
        power = np.einsum("kq,kq->k", column, column)
        shares = np.einsum("mkq,kq->mk", columns[j + 1 :], column)
        shares = np.divide(shares, power, out=np.zeros(shares.shape), where=power > 0.0)
        columns[j + 1 :] -= shares[:, :, None] * column
    return np.asarray(np.einsum("kq,kq->k", columns[-1], columns[-1]))


@dataclass(frozen=True)
class CrossPieces:
    """Cross-products of the instruments with [Phi y], of pieces of a record."""

    products: Products  # [psi phi y]
    equations: Float[np.ndarray, "K p n_plus_1"]  # Psi [phi' y] among them, side by side in memory
    noise: Float[np.ndarray, "p n_plus_1"] | None  # C and c

    def moments(self, drawn: Int[np.ndarray, " k"]) -> CrossMoments:
        return CrossMoments(self.products.resampled(drawn), self.noise)

    def influence(
        self, pieces: Int[np.ndarray, " k"] | slice, solved: Estimate, count: float
    ) -> Float[np.ndarray, "k n"]:
        """Of A'W (psi e + C theta - c)."""
        away = np.append(-solved.theta, 1.0)
        products = self.equations[pieces] @ away
        if self.noise is not None:
            products = products - self.products.counts[pieces, None] * (self.noise @ away)
        return products @ equation_map(solved).T / count


@dataclass(frozen=True)
class RootPieces:
    """Gram matrices of [Phi y] in the coordinates of its triangular root."""

    products: Products  # [Phi y]
    root: Float[np.ndarray, "n_plus_1 n_plus_1"]
    noise: Float[np.ndarray, "n_plus_1 n_plus_1"] | None  # Covariance of the measurement noises of [Phi y]
    solver: Solver

    def moments(self, drawn: Int[np.ndarray, " k"]) -> TriangularMoments:
        """Root of the replicate: that of its Gram matrix, times R."""
        replicate = self.products.resampled(drawn)
        powers, directions = np.linalg.eigh(replicate.sums[0])
        half = np.sqrt(np.maximum(powers, 0.0))[:, None] * directions.T
        return TriangularMoments(replicate.count, half @ self.root, self.noise)

    def influence(
        self,
        pieces: Int[np.ndarray, " k"] | slice,
        solved: Estimate,
        _count: float,  # a root is of the sum already
        /,
    ) -> Float[np.ndarray, "k n"]:
        """Of Phi e + c e^2, with the solver's correction."""
        theta = solved.theta
        A, b = solved.system.matrix, solved.system.right
        away = self.root @ np.append(-theta, 1.0)
        products = self.products.sums[pieces] @ away
        covariance = solved.system.error_covariance
        pull = self.solver.score_correction(np.ones(1), theta, covariance).rows[0]
        scores = products @ self.root[:, :-1] + np.outer(products @ away, pull)
        correction = self.solver.score_correction(b - A @ theta, theta, covariance)
        return over_sensitivity(scores, A, correction.sensitivity)


#: Products of pieces of a record, which the moments of any replicate are added up from.
PieceMoments = CrossPieces | RootPieces


def over_sensitivity(
    scores: Float[np.ndarray, "k n"],
    A: Float[np.ndarray, "m n"],
    correction: Float[np.ndarray, "n n"],
) -> Float[np.ndarray, "k n"]:
    """Rows of scores times (A'A + correction)^-1, without A'A."""
    R = triangular_root(A)
    inner = scipy.linalg.lapack.dtrtrs(R, scores.T, trans=1)[0]  # itself: of thousands of replicates
    if correction.any():
        half = scipy.linalg.solve_triangular(R, correction, trans="T")
        S = scipy.linalg.solve_triangular(R, half.T, trans="T")
        inner = np.linalg.solve(np.eye(R.shape[0]) + S, inner)
    return scipy.linalg.lapack.dtrtrs(R, inner)[0].T


def piece_moments(rows: Regression, method: LinearMethod, whole: Moments, plan: BlockPlan) -> PieceMoments:
    """Products of the pieces of a plan."""
    Phi, y = rows.regressors, rows.response
    if isinstance(whole, TriangularMoments):
        diagonal = np.diag(whole.root)
        safe = whole.root + np.diag(np.where(diagonal == 0.0, 1.0, 0.0))
        Q = scipy.linalg.solve_triangular(safe, np.column_stack([Phi, y]).T, trans="T").T
        of_atoms = products_of_rows(np.empty((y.size, 0)), Q[:, :-1], Q[:, -1], edges=plan.bounds)
        return RootPieces(_pieces(of_atoms, plan), whole.root, whole.noise, method.solver)
    psi = method.assembler.test_functions(rows)
    pieces = _pieces(products_of_rows(psi, Phi, y, edges=plan.bounds), plan)
    return CrossPieces(pieces, np.ascontiguousarray(pieces.equations), whole.noise)


def _pieces(atoms: Products, plan: BlockPlan) -> Products:
    return replace(atoms, counts=piece_sums(atoms.counts, plan), sums=piece_sums(atoms.sums, plan))


#: Replicates that are made when their number is not named; with one more, tails are whole numbers.
RUNS = 999


def bootstrap(
    problem: LinearProblem,
    method: LinearMethod,
    *,
    runs: int = RUNS,
    block_length: int | None = None,
    scheme: BlockScheme | str = BlockScheme.CIRCULAR,
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
    scheme : BlockScheme or str
        "circular", "moving" or "stationary".
    seed : int or numpy.random.Generator
        The same seed gives the same replicates.

    Returns
    -------
    Bootstrap
        Replicates of the parameters, with standard errors of their own for studentised intervals unless
        the scheme is stationary.

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
    try:
        kind = BlockScheme(scheme)
    except ValueError as error:
        known = ", ".join(BlockScheme)
        raise UsageError(f"a scheme out of {known}", f"'{scheme}'", "Name one of them.") from error
    check_draws(runs, seed)
    whole = method.moments(problem)
    solved = method.solve_moments(whole, problem, check=True)
    plan = block_plan(rows.response.size, _length(block_length, rows, method, solved, kind), kind)
    renewed = method.equation_weighting.passes == 1
    pieces = piece_moments(rows, method, whole, plan)
    again = _RowReplicates(method, pieces, None if renewed else solved.factor)
    random = np.random.default_rng(seed)
    studentised = kind is not BlockScheme.STATIONARY
    results = [again.replicate(plan.drawn(random), errors=studentised) for _ in range(runs)]
    kept = [result for result in results if result is not None]
    made = np.array(kept).reshape(len(kept), 2, rows.regressors.shape[1])
    theta = solved.theta
    errors = again.errors(slice(None), solved, float(plan.blocks)) if studentised else None
    return Bootstrap(
        rows.names,
        rows.units,
        theta,
        made[:, 0],
        runs - len(kept),
        plan.blocks,
        plan.block_length,
        None if isinstance(seed, np.random.Generator) else seed,
        errors,
        (made[:, 0] - theta) / made[:, 1] if studentised else None,
    )


@dataclass(frozen=True)
class _RowReplicates:
    method: LinearMethod
    pieces: PieceMoments
    factor: Float[np.ndarray, "p p"] | None

    def replicate(self, drawn: Int[np.ndarray, " k"], *, errors: bool) -> Float[np.ndarray, "2 n"] | None:
        """Parameters and, if asked for, their standard errors; None without an estimate."""
        try:
            solved = self.solved(self.pieces.moments(drawn))
            theta = solved.theta
            spread = self.errors(drawn, solved, float(len(drawn))) if errors else np.ones(theta.size)
        except (EivorError, np.linalg.LinAlgError):
            return None
        both = np.stack([theta, spread])
        return both if np.isfinite(both).all() and spread.all() else None

    def solved(self, moments: Moments) -> Estimate:
        method, factor = self.method, self.factor
        if factor is None:
            return method.solve_moments(moments)
        system = method.assembler.system(moments)
        solution = method.solver.solve(divided(system, factor))
        return Estimate(method.assembler, method.solver, moments, None, system, factor, solution)

    def errors(
        self, pieces: Int[np.ndarray, " k"] | slice, solved: Estimate, blocks: float
    ) -> Float[np.ndarray, " n"]:
        """Standard errors from the pieces' scores (Gotze and Kunsch 1996): M^-1 sum s s' M^-T."""
        count = blocks * float(self.pieces.products.counts[pieces].mean())
        influence = self.pieces.influence(pieces, solved, count)
        return math.sqrt(blocks) * influence.std(axis=0)


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


def _length(
    wanted: int | None, rows: Regression, method: LinearMethod, solved: Estimate, scheme: BlockScheme
) -> float:
    count = rows.response.size
    if wanted is None:
        return automatic_block_length(_influence(rows, method, solved), scheme)
    checks.whole("block_length", wanted)
    if not 1 <= wanted <= count // 2:
        expected = f"a block length from 1 to {count // 2} rows, half of what there is"
        raise UsageError(expected, f"{wanted}", "Choose another.")
    return float(wanted)


def _influence(rows: Regression, method: LinearMethod, solved: Estimate) -> Float[np.ndarray, "rows n"]:
    """What each row moves the parameters by, up to a constant: M^-1 p_t e_t."""
    theta, system = solved.theta, solved.system
    residual = rows.response - rows.regressors @ theta
    if method.assembler.moment_equations:
        return (method.assembler.test_functions(rows) @ equation_map(solved).T) * residual[:, None]
    correction = method.solver.score_correction(residual, theta, system.error_covariance)
    scores = (rows.regressors + correction.rows) * residual[:, None]
    return over_sensitivity(scores, system.matrix, correction.sensitivity)
