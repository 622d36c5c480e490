"""What may be said of a solution: joint covariance, strength of instruments, over-identification."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eivor.estimation.block_products import BlockProducts
from eivor.estimation.equation_rows import MethodEquations, estimating_equation
from eivor.estimation.method import Method
from eivor.inference.diagnostics.instrument_tests import (
    conditional_first_stage,
    orthonormal_basis,
    over_identification,
)
from eivor.inference.estimating_equation import EquationRows, EstimatingEquation
from eivor.linalg.system import LinearSystem, Solution
from eivor.models.regression import LinearProblem, Regression, SampleRows


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
    count : int
        Number of rows.
    blocks : BlockProducts, optional
        Products of the rows' columns over blocks of time, where they were made with the moments.
    """

    problem: LinearProblem
    method: Method
    system: LinearSystem
    factor: Float[np.ndarray, "p p"] | None
    solution: Solution
    nuisance_columns: Float[np.ndarray, "rows q"]
    count: int
    blocks: BlockProducts | None = None

    @property
    def equations(self) -> MethodEquations:
        """The method's equations, solved."""
        return MethodEquations(self.method, self.system, self.factor, self.solution)

    @cached_property
    def inference(self) -> Inference:
        """What a second pass over the rows tells, each part when it is asked for."""
        return Inference(self)


@dataclass(frozen=True)
class Inference:
    """What a second pass over the rows tells; every part is made when it is first asked for.

    Parameters
    ----------
    solved : Solved
        The solution.
    """

    solved: Solved

    @cached_property
    def equation(self) -> EstimatingEquation:
        """The estimating equation that the solution meets."""
        return _equation(self.solved, self.constant)

    @property
    def criterion(self) -> float:
        """What delays are compared by, in units of a chi-square on one degree of freedom.

        J with instruments; without, rows times the logarithm of the objective, twice the negative log
        likelihood of white residuals of unknown variance. (Divided by its own variance the objective
        would be alike at every delay: the likelihood is not.)
        """
        if self.solved.method.assembler.needs_instruments:
            return self.over_identification[0]
        least = np.finfo(np.float64).tiny
        return self.solved.count * float(np.log(max(self.solved.solution.objective, least)))

    @cached_property
    def over_identification(self) -> tuple[float, float]:
        """J and its p-value; (0, 1) without instruments, NaN for compensated equations.

        J compares psi'e with nothing but chance; compensated equations have C theta - c in it as well.
        """
        if not self.solved.method.assembler.needs_instruments:
            return 0.0, 1.0
        if self.constant.any():
            return float("nan"), float("nan")
        return over_identification(
            self._basis, self.residual, self.residual_variance, self._jacobian.shape[1]
        )

    @cached_property
    def first_stage(self) -> Float[np.ndarray, " n"]:
        """Conditional first-stage F of each joint parameter; NaN without instruments."""
        if not self.solved.method.assembler.needs_instruments:
            return np.full(self._jacobian.shape[1], np.nan)
        return conditional_first_stage(self._basis, self._jacobian)

    @property
    def residual_variance(self) -> float:
        """s^2 of the weighted rows."""
        return self.equation.variance

    @property
    def rank(self) -> int:
        """Number of independent instruments; 0 without."""
        return self._basis.shape[1] if self.solved.method.assembler.needs_instruments else 0

    @property
    def residual(self) -> Float[np.ndarray, " rows"]:
        """Residual of the weighted rows."""
        return self.equation.residual

    @cached_property
    def constant(self) -> Float[np.ndarray, " p"]:
        """C theta - c, what measurement noises add to each of the method's products on average."""
        return self.solved.method.assembler.score_constants(self.solved.problem, self.solved.solution.theta)

    @cached_property
    def _jacobian(self) -> Float[np.ndarray, "rows n"]:
        rows = self.solved.problem.rows()
        return np.column_stack([rows.regressors, *self.solved.nuisance_columns.T])

    @cached_property
    def _basis(self) -> Float[np.ndarray, "rows q"]:
        return orthonormal_basis(self.solved.problem.rows().instruments)


def _equation(solved: Solved, constant: Float[np.ndarray, " p"]) -> EstimatingEquation:
    problem, nuisance = solved.problem, solved.nuisance_columns
    layout = problem.layout if isinstance(problem, Regression) else None
    if layout is None or isinstance(layout, SampleRows):
        return estimating_equation(solved.equations, constant, problem.blocks, solved.count, nuisance)
    # Rows in frequency go back to time run by run, all at once.
    equation = estimating_equation(
        solved.equations, constant, lambda: problem.blocks(solved.count), solved.count, nuisance
    )
    whole = equation.rows
    scores = layout.scores(whole.test, whole.residual)
    rows = EquationRows(whole.test, whole.residual, scores, whole.flight_of_row, whole.constant)
    return EstimatingEquation(equation.sensitivity, scores.shape[0], lambda: [rows])
