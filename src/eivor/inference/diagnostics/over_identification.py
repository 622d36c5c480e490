"""Hansen's J: whether the equations agree about the parameters.

Whatever n combinations of the p equations an estimate solves, what is left over is told by the
combinations B that the parameters do not move, B'A = 0:

    J = N (B'g)' (B'S B)^-1 (B'g),   g = mean(psi e) + C theta - c

with S the long-run covariance of the equations' scores. B'g does not depend on theta, so J is the same for
every estimator; it is what two-step GMM weighted by S^-1 attains at its minimum (Hansen 1982), without
that estimate having to be made. Compensated equations enter with the noises' part in g and in the scores.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eivor.inference.covariances.covariance import unit_scale
from eivor.inference.diagnostics.block_cosines import (
    covariance_of_total,
    hotelling_p_value,
    joint_averages,
    quadratic_form,
)
from eivor.inference.diagnostics.diagnostic import SIGNIFICANT, Diagnostic, Row, Subject, told
from eivor.inference.diagnostics.equation_products import EquationProducts
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float


@dataclass(frozen=True)
class OverIdentification(Diagnostic):
    """Hansen's J.

    Parameters
    ----------
    J : float
        Statistic; 0 with as many equations as unknowns.
    degrees : int
        Equations that are left over.
    p_value : float
        From F(q, B - q + 1) for B cosine averages, from chi-square for other weights; NaN when there are
        too few averages.
    averages : int or None
        B.
    """

    J: float
    degrees: int
    p_value: float
    averages: int | None

    @property
    def outcome(self) -> str:
        """Whether the instruments agree, in words."""
        return told(self.p_value, ("agree", "may disagree", "disagree"))

    def rows(self, _of: Subject, /) -> Iterator[Row]:
        """J and its p-value."""
        yield Row("over_identification_J", "", self.J, self.p_value)

    def lines(self, _of: Subject, /) -> Iterator[str]:
        """J and its p-value."""
        yield f"over-identification  {self.J:>10.4g}  J on {self.degrees} degrees, p-value {self.p_value:.3g}"

    def reasons(self, _of: Subject, /) -> Iterator[Reason]:
        """Instruments that disagree."""
        if self.p_value < SIGNIFICANT:
            yield Reason(
                Status.WEAK,
                f"The instruments {self.outcome} about the parameters (J {self.J:.3g} on {self.degrees} "
                f"degrees, p-value {self.p_value:.1g}): one of them is not exogenous, a declared noise is "
                "wrong, or the model lacks a term.",
                "Leave out the most recent lags, check the declared noise, or add the term.",
            )


def hansen_j(
    equations: Float[np.ndarray, " p"],
    sensitivity: Float[np.ndarray, "p n"],
    covariance: Float[np.ndarray, "p p"],
    count: int | float,
    averages: int | None = None,
) -> OverIdentification:
    """J of equations with any weight. Performs no checks.

    Parameters
    ----------
    equations : ndarray, shape (p,)
        g, means over the record at an estimate.
    sensitivity : ndarray, shape (p, n)
        A, minus the derivative of g.
    covariance : ndarray, shape (p, p)
        S, long-run covariance of the scores of one sample.
    count : int
        N.
    averages : int, optional
        Cosine averages behind S; None for a weight that is taken as known.
    """
    scale = unit_scale(np.diag(covariance))
    unknowns = sensitivity.shape[1]
    free = np.linalg.qr(scale[:, None] * sensitivity, mode="complete")[0][:, unknowns:]
    degrees = free.shape[1]
    if not degrees:
        return OverIdentification(0.0, 0, 1.0, averages)
    left = free.T @ (scale * equations)
    S = free.T @ (np.outer(scale, scale) * covariance) @ free
    J = count * quadratic_form(left, S)
    return OverIdentification(J, degrees, hotelling_p_value(J, degrees, averages), averages)


def robust_over_identification(products: EquationProducts, averages: int | None = None) -> OverIdentification:
    """J with a weight that allows for autocorrelation, from the products at an estimate. Performs no checks.

    Parameters
    ----------
    products : EquationProducts
        At the estimate.
    averages : int, optional
        Cosine averages. Default: three for each equation that is left over, at least eight.
    """
    T = products.whitening
    degrees = max(T.shape[1] - products.sensitivity.shape[1], 0)
    B = joint_averages(degrees, products.counts.size) if averages is None else averages
    S = covariance_of_total(products.equation_sums @ T, B) / products.count
    return hansen_j(T.T @ products.equations, T.T @ products.sensitivity, S, products.count, B)
