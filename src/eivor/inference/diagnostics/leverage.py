"""How much each stretch of a record moves the estimate.

With the test functions kept, the equations of the rest of the record are solved by a step from the estimate,

    theta_(-k) - theta = -(M - M_k)^-1 S_k,   S_k, M_k the scores and the sensitivity of stretch k,

exactly when they are linear. In standard errors of the estimate: one of S stretches that are alike moves a
parameter by about 1/sqrt(S - 1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from eivor.inference.diagnostics.block_cosines import unit_scale


@dataclass(frozen=True)
class SegmentLeverage:
    """What leaving out each stretch does.

    Parameters
    ----------
    shift : ndarray, shape (S, n)
        Change of the estimate when a stretch is left out, in the parameters' units; NaN where the rest
        does not determine them.
    in_std_errors : ndarray, shape (S, n)
        The same over the standard errors of the estimate.
    """

    shift: Float[np.ndarray, "S n"]
    in_std_errors: Float[np.ndarray, "S n"]

    @property
    def most(self) -> Int[np.ndarray, " n"]:
        """The stretch that moves each parameter most."""
        return np.argmax(np.nan_to_num(np.abs(self.in_std_errors), nan=-1.0), axis=0)

    @property
    def largest(self) -> Float[np.ndarray, " n"]:
        """By how much it does, in standard errors, with its sign."""
        return self.in_std_errors[self.most, np.arange(self.shift.shape[1])]


def segment_leverage(
    sums: Float[np.ndarray, "S n"],
    sensitivities: Float[np.ndarray, "S n n"],
    std_errors: Float[np.ndarray, " n"],
) -> SegmentLeverage:
    """Drop-one estimates from the stretches' own equations. Performs no checks.

    Parameters
    ----------
    sums : ndarray, shape (S, n)
        Sum of the scores over each stretch; zero in total.
    sensitivities : ndarray, shape (S, n, n)
        Minus their derivatives by the estimate.
    std_errors : ndarray, shape (n,)
        Of the estimate.
    """
    M = sensitivities.sum(axis=0)
    scale = unit_scale(np.abs(np.diag(M)))
    shift = np.full(sums.shape, np.nan)
    for k, (own, score) in enumerate(zip(sensitivities, sums, strict=True)):
        rest = np.outer(scale, scale) * (M - own)
        if np.linalg.cond(rest) < 1.0 / np.finfo(np.float64).eps:
            shift[k] = -scale * np.linalg.solve(rest, scale * score)
    return SegmentLeverage(shift, shift / std_errors)
