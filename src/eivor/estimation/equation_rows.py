"""From a method's solution to its estimating equation, whose rows are made block by block.

A direct method's test functions are its regressors, corrected by its solver. An instrumental one's are
psi' W A with A the equations' mean sensitivity to the joint vector and W = (L L')^-1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eivor.estimation.method import Method
from eivor.inference.estimating_equation import EquationRows, EstimatingEquation
from eivor.linalg.system import LinearSystem, Solution
from eivor.models.regression import RowBlock

Blocks = Callable[[], Iterable[RowBlock]]
#: Rows of the estimating equation in a block that begins at some row.
RowsOf = Callable[[RowBlock, int], EquationRows]


@dataclass(frozen=True, slots=True)
class MethodEquations:
    """A method's equations and their solution.

    Parameters
    ----------
    method : Method
        How they were made and solved.
    system : LinearSystem
        Equations before their weighting.
    factor : ndarray, shape (p, p), optional
        Factor L of their weighting.
    solution : Solution
        What the solver found.
    """

    method: Method
    system: LinearSystem
    factor: Float[np.ndarray, "p p"] | None
    solution: Solution


def estimating_equation(
    equations: MethodEquations,
    constant: Float[np.ndarray, " p"],
    blocks: Blocks,
    count: int,
    nuisance: Float[np.ndarray, "rows q"],
) -> EstimatingEquation:
    """Estimating equation of a solution.

    Parameters
    ----------
    equations : MethodEquations
        Which.
    constant : ndarray, shape (p,)
        C theta - c, what measurement noises add to each of the method's products on average.
    blocks : callable
        Gives the rows of the problem, block by block; each call starts anew.
    count : int
        Number of rows.
    nuisance : ndarray, shape (rows, q)
        Derivatives of Phi theta by the nuisance parameters; may have no columns.
    """
    if equations.method.assembler.moment_equations:
        sensitivity, rows_of = _moment_parts(equations, constant, blocks, count, nuisance)
    else:
        sensitivity, rows_of = _direct_parts(equations, blocks, nuisance)

    def rows() -> Iterator[EquationRows]:
        start = 0
        for block in blocks():
            if block.response.size:
                yield rows_of(block, start)
            start += block.response.size

    return EstimatingEquation(sensitivity, count, rows)


def _moment_parts(
    equations: MethodEquations,
    constant: Float[np.ndarray, " p"],
    blocks: Blocks,
    count: int,
    nuisance: Float[np.ndarray, "rows q"],
) -> tuple[Float[np.ndarray, "n n"], RowsOf]:
    """Sensitivity and rows of moment equations."""
    assembler, theta = equations.method.assembler, equations.solution.theta
    A = equations.system.matrix
    if nuisance.size:
        moved, start = np.zeros((A.shape[0], nuisance.shape[1])), 0
        for block in blocks():
            here = nuisance[start : start + block.response.size]
            moved += assembler.test_functions(block).T @ here
            start += block.response.size
        A = np.column_stack([A, moved / count])
    WA = A if equations.factor is None else scipy.linalg.cho_solve((equations.factor, True), A)
    combined = constant @ WA

    def rows_of(block: RowBlock, start: int) -> EquationRows:
        del start
        # Columns stay contiguous, as those of a block are.
        test = (WA.T @ assembler.test_functions(block).T).T
        residual = block.response - block.regressors @ theta
        scores = test * residual[:, None]
        scores += combined
        return EquationRows(test, residual, scores, block.flights, combined)

    return count * (A.T @ WA), rows_of


def _direct_parts(
    equations: MethodEquations, blocks: Blocks, nuisance: Float[np.ndarray, "rows q"]
) -> tuple[Float[np.ndarray, "n n"], RowsOf]:
    """Sensitivity and rows of a direct method; the sensitivity takes a pass of its own."""
    theta, covariance = equations.solution.theta, equations.system.error_covariance
    linear, searched = theta.size, nuisance.shape[1] if nuisance.size else 0

    def jacobian_of(block: RowBlock, start: int) -> Float[np.ndarray, "rows n"]:
        here = nuisance[start : start + block.response.size]
        return np.column_stack([block.regressors, here]) if searched else block.regressors

    sensitivity: Float[np.ndarray, "n n"] = np.zeros((linear + searched, linear + searched))
    start = 0
    for block in blocks():
        residual, jacobian = block.response - block.regressors @ theta, jacobian_of(block, start)
        correction = equations.method.solver.score_correction(residual, theta, covariance)
        sensitivity += jacobian.T @ jacobian
        sensitivity[:linear, :linear] += correction.sensitivity
        start += residual.size

    def rows_of(block: RowBlock, start: int) -> EquationRows:
        residual = block.response - block.regressors @ theta
        correction = equations.method.solver.score_correction(residual, theta, covariance)
        test = jacobian_of(block, start) + np.pad(correction.rows, ((0, 0), (0, searched)))
        return EquationRows(test, residual, test * residual[:, None], block.flights)

    return sensitivity, rows_of
