"""What may be said of a solution: its estimating equation, strength of instruments, over-identification.

A direct method's test functions are its regressors G, corrected by its solver. An instrumental one's are
psi' W A with A the equations' mean sensitivity to the joint vector and W = (L L')^-1.

In orthonormal coordinates they are, with G = Q R, the rows G R^-1; and with L^-1 A = Q R and
psi' L^-T Q = P S the rows P, whose sensitivity is N S^-T R. Neither G'G nor A' W A is formed. S is a change
of coordinates and no more: of long records it is the root of as many rows as make it well-conditioned. What
is known beforehand of a nuisance is one row more, of G or of L^-1 A: a pseudo-observation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain

import numpy as np
import scipy.linalg

from eivor.estimation.products.folded_lags import filtered_instruments, lags_without_gaps
from eivor.estimation.solved import Solved
from eivor.inference.covariances.covariance import unit_scale
from eivor.inference.diagnostics.instrument_tests import (
    conditional_first_stage,
    orthonormal_basis,
    over_identification,
)
from eivor.inference.estimating_equation import EquationRows, EstimatingEquation, singular_sensitivity
from eivor.inference.quantiles import chi_square_tail
from eivor.linalg.least_squares import row_lengths
from eivor.linalg.row_blocks import COPIED_ROWS, made_ahead, row_blocks
from eivor.linalg.triangular import merged_roots, triangular_root
from eivor.models.regression import Regression, RowBlock
from eivor.models.rows import SampleRows
from eivor.shapes import Float

Blocks = Callable[[], Iterable[RowBlock]]
#: Rows that make coordinates for all, when their root, columns of one length, has a smaller condition.
ENOUGH_ROWS = 65_536
WELL_CONDITIONED = 1e4


@dataclass(frozen=True)
class Inference:
    """What a second pass over the rows tells; every part is made when it is first asked for.

    Parameters
    ----------
    solved : Solved
        The solution.
    """

    solved: Solved

    def __getstate__(self) -> dict[str, Solved]:
        """Without what was made, which is made again when it is asked for."""
        return {"solved": self.solved}

    @cached_property
    def equation(self) -> EstimatingEquation:
        """The estimating equation that the solution meets."""
        return equation_of(self.solved)

    @property
    def criterion(self) -> float:
        """What candidates are compared by, in units of a chi-square on one degree of freedom.

        J with instruments; without, rows times the logarithm of the objective, twice the negative log
        likelihood of white residuals of unknown variance. (Divided by its own variance the objective
        would be alike for every candidate: the likelihood is not.) What is known beforehand counts as data.
        """
        if self.solved.assembler.needs_instruments:
            return self.over_identification[0]
        least = np.finfo(np.float64).tiny
        likelihood = self.solved.count * float(np.log(max(self.solved.solution.objective, least)))
        return likelihood + sum(self.solved.misfits)

    @cached_property
    def over_identification(self) -> tuple[float, float]:
        """J and its p-value; (0, 1) without instruments, NaN for compensated equations.

        J compares psi'e with nothing but chance; compensated equations have C theta - c in it as well. What
        is known of a nuisance beforehand is one more equation.
        """
        if not self.solved.assembler.needs_instruments:
            return 0.0, 1.0
        if self.solved.constant.any():
            return float("nan"), float("nan")
        unknowns, misfits = self.solved.unknowns, self.solved.misfits
        J, p_value = over_identification(self._basis, self.residual, self.residual_variance, unknowns)
        if misfits:
            J += sum(misfits)
            p_value = chi_square_tail(J, self.degrees) if self.degrees > 0 else 1.0
        return J, p_value

    @cached_property
    def first_stage(self) -> Float[np.ndarray, " n"]:
        """Conditional first-stage F of each joint parameter; NaN without instruments.

        A pseudo-observation of what is known beforehand is one row more, and an instrument of its own: what
        it tells of a nuisance the instruments need not tell.
        """
        if not self.solved.assembler.needs_instruments:
            return np.full(self.solved.unknowns, np.nan)
        known = np.sqrt(self.residual_variance) * self.solved.prior_rows()
        basis = scipy.linalg.block_diag(self._basis, np.eye(len(known))) if known.size else self._basis
        return conditional_first_stage(basis, np.vstack([self.solved.jacobian, known]))

    @property
    def residual_variance(self) -> float:
        """s^2 of the weighted rows."""
        return self.equation.variance

    @property
    def degrees(self) -> int:
        """Equations that are left over: instruments, and nuisances known beforehand, less unknowns."""
        return self.rank + len(self.solved.misfits) - self.solved.unknowns

    @property
    def rank(self) -> int:
        """Number of independent instruments; 0 without."""
        return self._basis.shape[1] if self.solved.assembler.needs_instruments else 0

    @property
    def residual(self) -> Float[np.ndarray, " rows"]:
        """Residual of the weighted rows."""
        return self.equation.residual

    @cached_property
    def _basis(self) -> Float[np.ndarray, "rows q"]:
        return orthonormal_basis(self.solved.rows.instruments)


def equation_of(solved: Solved) -> EstimatingEquation:
    """Estimating equation of a solution whose rows are at hand.

    Raises
    ------
    EstimationError
        When they are not.
    """
    problem = solved.rows if solved.problem is None else solved.problem
    if not isinstance(problem, Regression) or isinstance(problem.layout, SampleRows):
        return estimating_equation(solved, problem.blocks)
    # Rows in frequency, and of several axes, go back to time all at once.
    equation = estimating_equation(solved, lambda: problem.blocks(round(solved.count)))
    whole = equation.rows
    scores = problem.layout.scores(whole.test_functions, whole.residual)
    timed = EquationRows(whole.test_functions, whole.residual, scores, whole.flight_of_row, whole.constant)
    return replace(equation, sample_count=scores.shape[0], blocks=lambda: [timed])


def estimating_equation(solved: Solved, blocks: Blocks) -> EstimatingEquation:
    """Estimating equation of a solution.

    Parameters
    ----------
    solved : Solved
        Which.
    blocks : callable
        Gives the rows of its problem, block by block; each call starts anew.
    """
    if solved.assembler.moment_equations:
        equation = _moment_equation(solved, blocks)
    else:
        equation = _direct_equation(solved, blocks)
    done = solved.solution.shrinkage
    if done is None:
        return equation
    return replace(equation, move=np.pad(done.shift, (0, solved.nuisance_columns.shape[1])))


def _moment_equation(solved: Solved, blocks: Blocks) -> EstimatingEquation:
    """Equation of mean cross-products; its coordinates take a pass of their own, over some of the rows."""
    theta, factor, constant = solved.solution.theta, solved.factor, solved.constant
    A, known = solved.system.matrix, solved.prior_rows()
    searched = solved.nuisance_columns.shape[1]
    own = searched if solved.assembler.takes_out_own_noise else 0

    if solved.nuisance_columns.size:
        moved, below = np.zeros((A.shape[0] + own, searched)), np.zeros((own, A.shape[1]))
        for block, nuisance in _with_nuisance(solved, blocks):
            moved += _test_functions(solved, block, nuisance).T @ nuisance
            below += nuisance[:, :own].T @ block.regressors
        A = np.column_stack([np.vstack([A, below / solved.count]), moved / solved.count])
        constant = np.pad(constant, (0, own))
    if factor is not None:
        A = scipy.linalg.solve_triangular(factor, A, lower=True)
    equations, power = A.shape[0], solved.row_power() if known.size else 0.0
    unit = power * solved.residual_variance() if known.size else 0.0
    stacked = np.vstack([A, np.sqrt(unit / solved.count) * known])
    lengths = row_lengths(stacked)[:, None]  # as many equations as unknowns: coordinates without their units
    combinations, R = np.linalg.qr(stacked / lengths)
    own_root = (combinations * lengths).T @ stacked  # of A' psi
    combinations = combinations / lengths
    pseudo = np.sqrt(solved.count) * combinations[equations:]
    combinations = combinations[:equations]
    if factor is not None:
        combinations = scipy.linalg.solve_triangular(factor, combinations, lower=True, trans="T")

    tests = (made().instruments for made in _in_combinations(solved, blocks, combinations))
    S = _coordinates_of(tests, np.sqrt(power) * pseudo)
    combinations = over_root(combinations, S)
    combined = constant @ combinations

    def in_coordinates(made: Callable[[], RowBlock]) -> EquationRows:
        block = made()
        residual = block.response - block.regressors @ theta
        scores = block.instruments * residual[:, None]
        scores += combined
        return EquationRows(block.instruments, residual, scores, block.flights, combined)

    def rows() -> Iterator[EquationRows]:
        return made_ahead(in_coordinates, _in_combinations(solved, blocks, combinations))

    prior = np.sqrt(unit) * over_root(pseudo, S) if known.size else None
    return EstimatingEquation(
        S @ own_root, solved.count * over_root(R.T, S).T, round(solved.count), rows, prior
    )


def _test_functions(
    solved: Solved, block: RowBlock, nuisance: Float[np.ndarray, "_ q"]
) -> Float[np.ndarray, "rows p"]:
    """The assembler's; columns that are their own instruments are so for nuisances as well, without noise."""
    psi = solved.assembler.test_functions(block)
    own = nuisance.size and solved.assembler.takes_out_own_noise
    return np.column_stack([psi, nuisance]) if own else psi


def _in_combinations(
    solved: Solved, blocks: Blocks, combinations: Float[np.ndarray, "p n"]
) -> Iterator[Callable[[], RowBlock]]:
    """For each block, a function that makes it with combinations of test functions as its instruments."""
    problem = solved.problem
    plain = not solved.nuisance_columns.size and solved.assembler.needs_instruments
    if plain and lags_without_gaps(problem):
        for ends in row_blocks(problem.first, problem.signals.sample_count, COPIED_ROWS):
            yield partial(filtered_instruments, problem, combinations, *ends)
        return
    for block, nuisance in _with_nuisance(solved, blocks):
        # Columns stay contiguous, as those of a block are.
        psi = (combinations.T @ _test_functions(solved, block, nuisance).T).T
        yield partial(replace, block, instruments=psi)


def _direct_equation(solved: Solved, blocks: Blocks) -> EstimatingEquation:
    """Equation of a direct method.

    The root is that of the system; where nuisances were searched for, whose columns are not in it, it takes
    a pass of its own.
    """
    system, theta, solver = solved.system, solved.solution.theta, solved.solver
    covariance, searched = system.error_covariance, solved.nuisance_columns.shape[1]
    known, root = solved.prior_rows(), triangular_root(system.matrix)
    unit = solved.residual_variance() if known.size else 0.0
    if searched:
        jacobians = (
            np.column_stack([block.regressors, nuisance])
            for block, nuisance in _with_nuisance(solved, blocks)
        )
        root = _root_of(jacobians, np.sqrt(unit) * known)
    residual = system.right - system.matrix @ theta
    correction = np.pad(solver.score_correction(residual, theta, covariance).sensitivity, (0, searched))
    slope = root + over_root(correction, root).T if correction.any() else root

    def rows() -> Iterator[EquationRows]:
        for block, nuisance in _with_nuisance(solved, blocks):
            residual = block.response - block.regressors @ theta
            pulled = solver.score_correction(residual, theta, covariance).rows
            jacobian = np.column_stack([block.regressors, nuisance]) if searched else block.regressors
            psi = over_root(jacobian + np.pad(pulled, ((0, 0), (0, searched))), root)
            yield EquationRows(psi, residual, psi * residual[:, None], block.flights)

    prior = unit * over_root(known, root) if known.size else None
    return EstimatingEquation(root, slope, round(solved.count), rows, prior)


def _filled(blocks: Blocks) -> Iterator[RowBlock]:
    """Blocks that have rows."""
    return (block for block in blocks() if block.response.size)


def _with_nuisance(solved: Solved, blocks: Blocks) -> Iterator[tuple[RowBlock, Float[np.ndarray, "rows q"]]]:
    """Blocks that have rows, each with its rows of the nuisances' columns."""
    start = 0
    for block in _filled(blocks):
        stop = start + block.response.size
        yield block, solved.nuisance_columns[start:stop]
        start = stop


def _root_of(
    blocks: Iterable[Float[np.ndarray, "_ n"]], beside: Float[np.ndarray, "k n"]
) -> Float[np.ndarray, "n n"]:
    """Triangular root of rows in blocks, and of some beside them."""
    root: Float[np.ndarray, "k n"] | None = None
    for block in chain(blocks, [beside] if beside.size else []):
        root = triangular_root(block) if root is None else merged_roots(root, block)
    if root is None or root.shape[0] < root.shape[1]:
        raise singular_sensitivity()
    return root


def _coordinates_of(
    blocks: Iterable[Float[np.ndarray, "_ n"]], beside: Float[np.ndarray, "k n"]
) -> Float[np.ndarray, "n n"]:
    """Triangular root in whose coordinates rows are nearly orthonormal: that of enough of them, or of all."""
    root: Float[np.ndarray, "k n"] | None = triangular_root(beside) if beside.size else None
    seen = 0
    for block in blocks:
        root = triangular_root(block) if root is None else merged_roots(root, block)
        seen += block.shape[0]
        if seen >= ENOUGH_ROWS and _condition(root) < WELL_CONDITIONED:
            break
    if root is None or root.shape[0] < root.shape[1]:
        raise singular_sensitivity()
    return root


def _condition(root: Float[np.ndarray, "k n"]) -> float:
    """Condition number, columns scaled to one length."""
    return float(np.linalg.cond(root * unit_scale(np.sum(root**2, axis=0))))


def over_root(rows: Float[np.ndarray, "k n"], root: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "k n"]:
    """Rows in the coordinates of a triangular root: rows R^-1.

    Raises
    ------
    CollinearError
        When R is singular.
    """
    if not np.diag(root).all():
        raise singular_sensitivity()
    found: Float[np.ndarray, "k n"] = scipy.linalg.solve_triangular(root, rows.T, trans="T").T
    return found
