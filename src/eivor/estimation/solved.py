"""A solution, with all that inference needs to know of how it was made."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

from eivor.errors import EstimationError
from eivor.estimation.assembler import Assembler
from eivor.estimation.moments import CrossMoments, Moments
from eivor.inference.products import Products
from eivor.linalg.system import LinearSystem, Solution, Solver
from eivor.models.regression import LinearProblem, Regression
from eivor.shapes import Float


@dataclass(frozen=True)
class Solved:
    """A solution with all that inference needs to know of how it was made.

    Parameters
    ----------
    assembler : Assembler
        Which equations.
    solver : Solver
        How they were solved.
    moments : Moments
        What they were made of.
    problem : LinearProblem or None
        Weighted rows; None when only moments are at hand.
    system : LinearSystem
        Equations before their weighting.
    factor : ndarray, shape (p, p), optional
        Factor L of the equations' weighting; None for the identity.
    solution : Solution
        What the solver found.
    nuisance_columns : ndarray, shape (rows, q)
        Derivatives of Phi theta by the nuisances that were searched for; may have no columns.
    precision : ndarray, shape (q,)
        What is known of these beforehand, 1 / std^2; zero for nothing.
    misfits : tuple of float
        Squared distance of each nuisance from what is known of it, in standard errors.
    """

    assembler: Assembler
    solver: Solver
    moments: Moments
    problem: LinearProblem | None
    system: LinearSystem
    factor: Float[np.ndarray, "p p"] | None
    solution: Solution
    nuisance_columns: Float[np.ndarray, "rows q"] = field(default_factory=lambda: np.empty((0, 0)))
    precision: Float[np.ndarray, " q"] = field(default_factory=lambda: np.empty(0))
    misfits: tuple[float, ...] = ()

    @property
    def count(self) -> float:
        """Number of rows."""
        return self.moments.rows

    @property
    def unknowns(self) -> int:
        """Length of the joint vector."""
        return self.solution.theta.size + self.nuisance_columns.shape[1]

    @property
    def products(self) -> Products | None:
        """Products of the rows' columns, which instrumental moments are a view of."""
        return self.moments.products if isinstance(self.moments, CrossMoments) else None

    @property
    def constant(self) -> Float[np.ndarray, " p"]:
        """C theta - c, what measurement noises add to each of the method's products on average."""
        if not isinstance(self.moments, CrossMoments):
            return np.zeros(self.solution.theta.size)
        return self.moments.shared_noise(self.solution.theta)

    @property
    def rows(self) -> Regression:
        """Weighted rows.

        Raises
        ------
        EstimationError
            When only moments are at hand.
        """
        if self.problem is None:
            raise EstimationError(
                "an estimate with its rows at hand, for residuals and standard errors",
                "an estimate from moments, which do not keep the rows",
                "Pass over the chunks again with eivor.identify_chunks, or identify the whole problem.",
            )
        return self.problem.rows()

    @property
    def jacobian(self) -> Float[np.ndarray, "rows n"]:
        """Derivatives of the model by the joint vector."""
        return np.column_stack([self.rows.regressors, *self.nuisance_columns.T])

    def residual_variance(self) -> float:
        """s^2 of the weighted rows."""
        residual = self.rows.response - self.rows.regressors @ self.solution.theta
        return float(residual @ residual) / max(self.count - self.unknowns, 1)

    def row_power(self) -> float:
        """Variance of a row's score over s^2 and over the sensitivity that the row gives.

        One for direct methods, tr(W mean psi psi') / p with instruments: one again for two-stage weights.
        """
        if not self.assembler.moment_equations:
            return 1.0
        psi = self.assembler.test_functions(self.rows)
        if self.factor is not None:
            psi = scipy.linalg.solve_triangular(self.factor, psi.T, lower=True).T
        return float(np.mean(psi**2))

    def objective_unit(self) -> float:
        """What the solver's objective grows by, on average, with one equation more than unknowns."""
        if self.assembler.needs_instruments:
            return self.residual_variance() * self.row_power() / self.count
        return self.solution.objective / max(self.count - self.unknowns, 1)

    def prior_rows(self) -> Float[np.ndarray, "k n"]:
        """Rows of pseudo-observations of what is known beforehand, over the square root of their variance."""
        places = np.flatnonzero(self.precision)
        rows = np.zeros((places.size, self.unknowns))
        rows[np.arange(places.size), self.solution.theta.size + places] = np.sqrt(self.precision[places])
        return rows
