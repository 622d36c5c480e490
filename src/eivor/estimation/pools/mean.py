"""The mean of estimates that differ: a random-effects mean whose interval counts the differences.

Variance between estimates by moments (DerSimonian and Laird 1986), weights w = 1 / (v + between), and the
variance of the mean by how far the estimates lie from it, q = sum w (y - mean)^2 / (n - 1), never below
what the weights say: max(1, q) / sum w, with Student's t on n - 1 degrees of freedom (Hartung and Knapp
2001; Sidik and Jonkman 2002; modified by Rover, Knapp and Friede 2015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float


@dataclass(frozen=True)
class RandomEffectsMean:
    """Mean of estimates that differ by more than chance.

    Parameters
    ----------
    value : float
        The mean.
    variance : float
        Of the mean.
    between : float
        Variance between what is estimated.
    weights : ndarray, shape (n,)
        What each estimate counts; their sum is one.
    """

    value: float
    variance: float
    between: float
    weights: Float[np.ndarray, " n"]


def random_effects_mean(
    estimates: Float[np.ndarray, " n"], variances: Float[np.ndarray, " n"]
) -> RandomEffectsMean:
    """Mean of two estimates or more, see this module. Performs no checks.

    Parameters
    ----------
    estimates, variances : ndarray, shape (n,)
        y and v.
    """
    fixed = 1.0 / variances
    centre = float(fixed @ estimates / fixed.sum())
    spread = float(fixed @ (estimates - centre) ** 2)
    degrees = estimates.size - 1
    between = max(spread - degrees, 0.0) / float(fixed.sum() - fixed @ fixed / fixed.sum())
    weights = 1.0 / (variances + between)
    value = float(weights @ estimates / weights.sum())
    q = float(weights @ (estimates - value) ** 2) / degrees
    return RandomEffectsMean(value, max(q, 1.0) / float(weights.sum()), between, weights / weights.sum())
