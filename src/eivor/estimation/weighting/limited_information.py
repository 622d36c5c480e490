"""Limited information: two-stage equations that know the errors of their columns.

What the instruments do not reach of [phi y] is the noise in the columns of the equations: given psi, a row of
the two-stage equations L^-1 mean(psi [phi' y]) has errors of covariance S/N,

    S = mean([phi y]' [phi y]) - [A b]' mean(psi psi')^-1 [A b].

Total least squares with that covariance minimises e' P e / e' (I - P) e, with P the projection on the
instruments: it is limited information maximum likelihood (Anderson and Rubin 1949), the k-class whose k is
one more than that minimum. A regressor that is an instrument as well has no error, and is eliminated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from eivor.errors import NoUniqueSolutionError, TooFewSamplesError, UsageError
from eivor.estimation.moments import CrossMoments
from eivor.estimation.weighting.equations import (
    EquationWeighting,
    TwoStage,
    UnweightedEquations,
    WeightedEquations,
)
from eivor.inference.covariances.covariance import unit_scale
from eivor.shapes import Float

#: Columns of which the instruments leave less than this share have no error but rounding.
EXACT = 1e-12


@dataclass(frozen=True, slots=True)
class LimitedInformation(EquationWeighting):
    """Two-stage weights, and the columns' errors for a solver that takes them into account."""

    @property
    def passes(self) -> int:
        """One: neither depends on the residuals."""
        return 1

    @property
    def needs_instrument_products(self) -> bool:
        """Yes."""
        return True

    def equations(self, at: UnweightedEquations) -> WeightedEquations:
        """Two-stage equations with S and its degrees of freedom, rows less instruments.

        Raises
        ------
        UsageError
            When the moments are without products of all columns.
        InstrumentError
            When instruments are combinations of one another.
        NoUniqueSolutionError
            When parameters fit the record exactly.
        """
        two_stage, moments = TwoStage().equations(at), at.moments
        columns = moments.columns if isinstance(moments, CrossMoments) else None
        if columns is None or two_stage.factor is None or not isinstance(moments, CrossMoments):
            raise UsageError(
                "moments with the products of all columns",
                type(moments).__name__,
                "Make the moments with the method that is to use them.",
            )
        instruments = two_stage.factor.shape[0]
        if moments.rows <= instruments:
            raise TooFewSamplesError(
                f"more rows than the {instruments} instruments, for what they leave of the columns",
                f"{moments.rows:g}",
                "Give a longer record, or fewer instruments.",
            )
        reached = scipy.linalg.solve_triangular(two_stage.factor, moments.equations, lower=True)
        errors = _left_over(columns, reached)
        system = replace(two_stage.system, error_covariance=errors, error_degrees=moments.rows - instruments)
        return WeightedEquations(system, two_stage.factor)


def _left_over(
    columns: Float[np.ndarray, "n_plus_1 n_plus_1"], reached: Float[np.ndarray, "p n_plus_1"]
) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
    """S: what the instruments leave of the columns' products, without the rounding of columns they span."""
    S = columns - reached.T @ reached
    exact = np.diag(S) <= EXACT * np.diag(columns)
    S[exact] = 0.0
    S[:, exact] = 0.0
    noisy = np.ix_(~exact, ~exact)
    scale = unit_scale(np.diag(S)[~exact])
    if not exact.all() and np.linalg.eigvalsh(np.outer(scale, scale) * S[noisy])[0] <= EXACT:
        raise NoUniqueSolutionError(
            "equations with an error, of which a least one can be found",
            "a response that is a combination of regressors and instruments but for rounding",
            "Use extended_iv or generalized_iv: of exact data they give the exact answer.",
        )
    return S
