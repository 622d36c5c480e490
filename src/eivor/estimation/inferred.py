"""What may be said of a solution: joint covariance, strength of instruments, over-identification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eivor.estimation.method import Method
from eivor.inference.covariance import JointCovariance, joint_covariance
from eivor.inference.instrument_tests import (
    conditional_first_stage,
    orthonormal_basis,
    over_identification,
)
from eivor.linalg.system import LinearSystem, Solution
from eivor.models.regression import LinearProblem


@dataclass(frozen=True)
class Inference:
    """What a second pass over the rows tells.

    Parameters
    ----------
    covariance : JointCovariance
        Of the joint vector.
    criterion : float
        What delays are compared by, in units of a chi-square on one degree of freedom: J with
        instruments; without, rows times the logarithm of the objective, twice the negative log likelihood
        of white residuals of unknown variance.
    over_identification : tuple of float
        J and its p-value; (0, 1) without instruments, NaN for compensated equations.
    first_stage : ndarray, shape (n,)
        Conditional first-stage F of each joint parameter; NaN without instruments.
    residual_variance : float
        s^2 of the weighted rows.
    rank : int
        Number of independent instruments; 0 without.
    """

    covariance: JointCovariance
    criterion: float
    over_identification: tuple[float, float]
    first_stage: Float[np.ndarray, " n"]
    residual_variance: float
    rank: int


@dataclass(frozen=True)
class Solved:
    """A solution with all that inference needs to know of how it was made.

    Parameters
    ----------
    problem : LinearProblem
        Weighted rows.
    method : Method
        How they were solved.
    system : LinearSystem
        Equations before their weighting.
    factor : ndarray, shape (p, p), optional
        Factor L of the equations' weighting.
    solution : Solution
        What the solver found.
    nuisance_columns : ndarray, shape (rows, q)
        Derivatives of Phi theta by the nuisance parameters that were searched for; may have no columns.
    """

    problem: LinearProblem
    method: Method
    system: LinearSystem
    factor: Float[np.ndarray, "p p"] | None
    solution: Solution
    nuisance_columns: Float[np.ndarray, "rows q"]


def infer(solved: Solved) -> Inference:
    """Covariance of the joint vector and tests of the instruments. Linear in the rows."""
    rows = solved.problem.rows()
    theta = solved.solution.theta
    jacobian = rows.regressors
    if solved.nuisance_columns.size:
        jacobian = np.column_stack([jacobian, solved.nuisance_columns])
    residual = rows.response - rows.regressors @ theta
    count, unknowns = jacobian.shape
    variance = float(residual @ residual) / max(count - unknowns, 1)
    test, sensitivity, constant = _estimating_equation(solved, jacobian, residual)
    covariance = joint_covariance(
        sensitivity=sensitivity,
        test=test,
        residual=residual,
        variance=variance,
        scores=rows.layout.scores(test, residual) + constant,
        flight_of_row=rows.layout.flight_of_row,
    )
    if not solved.method.assembler.needs_instruments:
        # Divided by its own variance the objective would be alike at every delay: the likelihood is not.
        criterion = count * float(np.log(max(solved.solution.objective, np.finfo(np.float64).tiny)))
        return Inference(covariance, criterion, (0.0, 1.0), np.full(unknowns, np.nan), variance, 0)
    basis = orthonormal_basis(rows.instruments)
    strength = conditional_first_stage(basis, jacobian)
    if constant.any():
        # J compares psi'e with nothing but chance; compensated equations have C theta - c in it as well.
        tested = (float("nan"), float("nan"))
    else:
        tested = over_identification(basis, residual, variance, unknowns)
    return Inference(covariance, tested[0], tested, strength, variance, basis.shape[1])


def _estimating_equation(
    solved: Solved, jacobian: Float[np.ndarray, "rows n"], residual: Float[np.ndarray, " rows"]
) -> tuple[Float[np.ndarray, "rows n"], Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
    """Test functions P, sensitivity M and the constant in each row's score.

    A direct method's test functions are its regressors, corrected by its solver. An instrumental one's
    are psi' W A with A the equations' mean sensitivity to the joint vector and W = (L L')^-1.
    """
    rows = solved.problem.rows()
    assembler, theta = solved.method.assembler, solved.solution.theta
    linear, unknowns = theta.size, jacobian.shape[1]
    if not assembler.moment_equations:
        correction = solved.method.solver.score_correction(residual, theta, solved.system.error_covariance)
        sensitivity = jacobian.T @ jacobian
        sensitivity[:linear, :linear] += correction.sensitivity
        test = jacobian + np.pad(correction.rows, ((0, 0), (0, unknowns - linear)))
        return test, sensitivity, np.zeros(unknowns)
    psi = assembler.test_functions(rows)
    A = solved.system.matrix
    if solved.nuisance_columns.size:
        A = np.column_stack([A, psi.T @ solved.nuisance_columns / residual.size])
    WA = A if solved.factor is None else scipy.linalg.cho_solve((solved.factor, True), A)
    constant = assembler.score_constants(solved.problem, theta) @ WA
    return psi @ WA, residual.size * (A.T @ WA), constant
