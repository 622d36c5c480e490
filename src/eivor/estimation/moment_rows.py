"""Rows of moment equations as the sets for weak instruments need them.

A regressor that is its own instrument and free of measurement noise (an intercept, for example) may be
*partialled out*: response, other regressors and other instruments are replaced by what is left of them
after least squares on it. Its parameter then has dropped out of the equations, and its instrument with it,
so that no search over it is needed and no degree of freedom is spent on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import InstrumentError, UsageError
from eivor.estimation.linear import LinearMethod, check_linear
from eivor.estimation.moments import CrossMoments
from eivor.inference.covariances.equal_weighted_cosines import cosine_averages
from eivor.inference.diagnostics.instrument_tests import SMALLEST_DIRECTION
from eivor.inference.sets.anderson_rubin import LinearScores, averages_for
from eivor.models.equation import Parameter
from eivor.models.regression import LinearProblem
from eivor.models.rows import RowLayout
from eivor.shapes import Float


@dataclass(frozen=True)
class MomentRows:
    """Test functions, columns and noises of ``mean psi_t (y_t - phi_t' theta) + C theta - c``.

    Parameters
    ----------
    parameters : tuple of Parameter
        One for each column of Phi.
    test_functions : ndarray, shape (rows, p)
        psi.
    columns : ndarray, shape (rows, n + 1)
        [y Phi].
    noise : ndarray, shape (p, n + 1)
        [c C].
    layout : RowLayout
        What the rows are.
    partialled : int
        Number of regressors that were partialled out.
    """

    parameters: tuple[Parameter, ...]
    test_functions: Float[np.ndarray, "rows p"]
    columns: Float[np.ndarray, "rows n_plus_1"]
    noise: Float[np.ndarray, "p n_plus_1"]
    layout: RowLayout
    partialled: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each parameter."""
        return tuple(parameter.name for parameter in self.parameters)

    def own_instruments(self) -> dict[int, int]:
        """Regressors that are instruments as well and share no noise: number of the column to that of psi."""
        found = {}
        for j in range(len(self.parameters)):
            column = self.columns[:, j + 1]
            for i in range(self.test_functions.shape[1]):
                exact = not (self.noise[i].any() or self.noise[:, j + 1].any())
                if exact and column.any() and np.array_equal(column, self.test_functions[:, i]):
                    found[j] = i
                    break
        return found

    def without(self, regressors: Sequence[int]) -> MomentRows:
        """The same equations with some of `own_instruments` partialled out."""
        if not regressors:
            return self
        own = self.own_instruments()
        W = self.columns[:, [j + 1 for j in regressors]]
        Q = np.linalg.qr(W / np.linalg.norm(W, axis=0))[0]
        others = [i for i in range(self.test_functions.shape[1]) if i not in {own[j] for j in regressors}]
        left = [j for j in range(len(self.parameters)) if j not in regressors]
        kept = [0, *(j + 1 for j in left)]
        psi, columns = self.test_functions[:, others], self.columns[:, kept]
        for _ in range(2):  # once more, for what rounding leaves of a large mean
            psi, columns = psi - Q @ (Q.T @ psi), columns - Q @ (Q.T @ columns)
        return MomentRows(
            tuple(self.parameters[j] for j in left),
            psi,
            columns,
            self.noise[np.ix_(others, kept)],
            self.layout,
            self.partialled + len(regressors),
        )

    def independent(self) -> MomentRows:
        """Equations recombined into orthonormal ones, without directions that are others' combinations.

        Raises
        ------
        InstrumentError
            When fewer are left than there are parameters.
        """
        lengths = np.linalg.norm(self.test_functions, axis=0)
        moving = lengths > 0.0
        unit = self.test_functions[:, moving] / lengths[moving]
        eigenvalues, vectors = np.linalg.eigh(unit.T @ unit)
        kept = eigenvalues > SMALLEST_DIRECTION**2
        unknowns = len(self.parameters)
        if int(kept.sum()) < unknowns:
            raise InstrumentError(
                f"at least {unknowns} independent instruments for {unknowns} parameters",
                f"{int(kept.sum())}",
                "Add lags or exogenous columns.",
            )
        change = vectors[:, kept] / np.sqrt(eigenvalues[kept])
        noise = change.T @ (self.noise[moving] / lengths[moving, None])
        return MomentRows(self.parameters, unit @ change, self.columns, noise, self.layout, self.partialled)

    def scores(self, averages: int | None) -> LinearScores:
        """Sums and cosine averages of the scores, in one pass; by rule when their number is not given."""
        total = self.test_functions.T @ self.columns - self.columns.shape[0] * self.noise
        cosines = []
        for column in self.columns.T:
            scores = self.layout.scores(self.test_functions, column)
            count = averages or averages_for(scores.shape[0], self.test_functions.shape[1])
            cosines.append(cosine_averages(scores, count))
        return LinearScores(total, np.stack(cosines, axis=2))


def moment_rows(problem: LinearProblem, method: LinearMethod) -> MomentRows:
    """Rows of the moment equations that a method makes of a problem.

    Raises
    ------
    UsageError
        When the method's equations are no moment equations, or an argument is of another type.
    InstrumentError, MissingNoiseError
        When the method refuses the problem.
    """
    check_linear(method)
    remedy = "Make one by ev.regression(...) or VerticalMotion().regression(signals)."
    checks.kind("problem", problem, LinearProblem, "a regression", remedy)
    if not method.assembler.moment_equations:
        raise UsageError(
            "a method with instruments",
            method.name,
            "Use extended_iv, generalized_iv or bias_compensated_least_squares.",
        )
    moments = method.assembler.moments(problem)  # refuses what it cannot use
    rows = problem.rows()
    columns = np.column_stack([rows.response, rows.regressors])
    psi = method.assembler.test_functions(rows)
    noise = np.zeros((psi.shape[1], columns.shape[1]))
    if isinstance(moments, CrossMoments) and moments.noise is not None:
        noise = np.column_stack([moments.noise[:, -1], moments.noise[:, :-1]])
    return MomentRows(rows.parameters, psi, columns, noise, rows.layout)
