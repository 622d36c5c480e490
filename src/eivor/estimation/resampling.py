"""Bootstrap of time: an estimate made again from blocks of its rows, drawn with replacement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from eivor import checks
from eivor.errors import EivorError, UsageError
from eivor.estimation.linear import LinearMethod, check_linear
from eivor.estimation.moments import Moments
from eivor.estimation.replicate_moments import PieceMoments, over_sensitivity, piece_moments
from eivor.estimation.solved import Solved
from eivor.inference.resampling.blocks import BlockScheme, automatic_block_length, block_plan
from eivor.inference.resampling.replicates import Bootstrap, check_draws
from eivor.linalg.system import LinearSystem
from eivor.models.regression import LinearProblem, Regression
from eivor.models.rows import SampleRows
from eivor.shapes import Float, Int

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
    compensated methods subtract, C and c, is the declared one in every replicate; so is a weight that is
    made of residuals (`TwoStepRobust`), which changes the estimate to second order only.
    """
    check_linear(method)
    rows, kind = _sample_rows(problem), _scheme(scheme)
    check_draws(runs, seed)
    whole = method.moments(problem)
    solved = method.determined(whole, problem)
    plan = block_plan(rows.response.size, _length(block_length, rows, method, solved, kind), kind)
    renewed = method.equation_weighting.passes == 1
    again = _Again(method, piece_moments(rows, method, whole, plan), None if renewed else solved.factor)
    random = np.random.default_rng(seed)
    studentised = kind is not BlockScheme.STATIONARY
    found = [again.replicate(plan.drawn(random), errors=studentised) for _ in range(runs)]
    kept = [one for one in found if one is not None]
    made = np.array(kept).reshape(len(kept), 2, rows.regressors.shape[1])
    theta = solved.solution.theta
    errors = again.expected_errors(plan.blocks, solved) if studentised else None
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
class _Again:
    """How a replicate is estimated.

    Parameters
    ----------
    method : LinearMethod
        By what.
    pieces : PieceMoments
        From what.
    factor : ndarray, shape (p, p), optional
        Factor of a weighting that is kept as the whole sample has it.
    """

    method: LinearMethod
    pieces: PieceMoments
    factor: Float[np.ndarray, "p p"] | None

    def replicate(self, drawn: Int[np.ndarray, " k"], *, errors: bool) -> Float[np.ndarray, "2 n"] | None:
        """Parameters and, if asked for, their standard errors; None without an estimate."""
        try:
            solved = self.solved(self.pieces.moments(drawn))
            theta = solved.solution.theta
            spread = self._errors(drawn, solved, float(len(drawn))) if errors else np.ones(theta.size)
        except (EivorError, np.linalg.LinAlgError):
            return None
        both = np.stack([theta, spread])
        return both if np.isfinite(both).all() and spread.all() else None

    def solved(self, moments: Moments) -> Solved:
        """Solution of a replicate's equations."""
        if self.factor is None:
            return self.method.solve_moments(moments)
        system = self.method.assembler.system(moments)
        stacked = np.column_stack([system.matrix, system.right])
        divided = scipy.linalg.solve_triangular(self.factor, stacked, lower=True)
        weighted = LinearSystem(divided[:, :-1], divided[:, -1])
        solution = self.method.solver.solve(weighted)
        return Solved(self.method.assembler, self.method.solver, moments, None, system, self.factor, solution)

    def expected_errors(self, blocks: int, solved: Solved) -> Float[np.ndarray, " n"]:
        """Standard errors of the estimate itself, from the spread of all pieces that may be drawn."""
        return self._errors(slice(None), solved, float(blocks))

    def _errors(
        self, pieces: Int[np.ndarray, " k"] | slice, solved: Solved, blocks: float
    ) -> Float[np.ndarray, " n"]:
        """Standard errors from the pieces' scores (Gotze and Kunsch 1996): M^-1 sum s s' M^-T."""
        count = blocks * float(self.pieces.products.counts[pieces].mean())
        influence = self.pieces.influence(pieces, solved, count)
        errors: Float[np.ndarray, " n"] = math.sqrt(blocks) * influence.std(axis=0)
        return errors


def _sample_rows(problem: LinearProblem) -> Regression:
    """Rows in the time order of one record."""
    if not isinstance(problem, LinearProblem):
        raise UsageError(
            "a regression of rows in time",
            type(problem).__name__,
            "Use bootstrap_flights for flights; moments have no rows to draw again.",
        )
    rows = problem.rows()
    if not isinstance(rows.layout, SampleRows) or np.any(rows.layout.flights != rows.layout.flights[0]):
        raise UsageError(
            "rows that are the samples of one record",
            "rows of several flights, or of a spectrum",
            "Use bootstrap_flights, or one record after the other.",
        )
    return rows


def _scheme(scheme: BlockScheme | str) -> BlockScheme:
    try:
        return BlockScheme(scheme)
    except ValueError as error:
        known = ", ".join(BlockScheme)
        raise UsageError(f"a scheme out of {known}", f"'{scheme}'", "Name one of them.") from error


def _length(
    wanted: int | None, rows: Regression, method: LinearMethod, solved: Solved, scheme: BlockScheme
) -> float:
    count = rows.response.size
    if wanted is not None:
        checks.whole("block_length", wanted)
    if wanted is None:
        return automatic_block_length(_influence(rows, method, solved), scheme)
    if not 1 <= wanted <= count // 2:
        raise UsageError(
            f"a block length from 1 to {count // 2} rows, half of what there is",
            f"{wanted}",
            "Choose another.",
        )
    return float(wanted)


def _influence(rows: Regression, method: LinearMethod, solved: Solved) -> Float[np.ndarray, "rows n"]:
    """What each row moves the parameters by, up to a constant: M^-1 p_t e_t."""
    Phi, theta, system = rows.regressors, solved.solution.theta, solved.system
    residual = rows.response - Phi @ theta
    A = system.matrix
    if method.assembler.moment_equations:
        WA = A if solved.factor is None else scipy.linalg.cho_solve((solved.factor, True), A)
        weighted = A
        if solved.factor is not None:
            weighted = scipy.linalg.solve_triangular(solved.factor, A, lower=True)
        psi = method.assembler.test_functions(rows) @ WA
        return over_sensitivity(psi * residual[:, None], weighted)
    correction = method.solver.score_correction(residual, theta, system.error_covariance)
    psi = Phi + correction.rows
    return over_sensitivity(psi * residual[:, None], A, correction.sensitivity)
