"""The table of all solutions that a regularisation offers, which choices of its parameter read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.linalg.regularisation import ReducedProblem, Regularisation
from eivor.shapes import Float


@dataclass(frozen=True)
class ShrinkagePath:
    """Solutions at k parameters, the one that is regularised least first.

    Parameters
    ----------
    parameters : ndarray, shape (k,)
        Of the regularisation.
    kept : ndarray, shape (k,)
        Number of parameters that are left, of n.
    misfits : ndarray, shape (k,)
        What the solver would have made least without regularisation.
    distances : ndarray, shape (k,)
        Squared distance of theta from the vector that it is pulled towards, in the solver's coordinates.
    equations : float
        Number of equations.
    unknowns : int
        n.
    """

    parameters: Float[np.ndarray, " k"]
    kept: Float[np.ndarray, " k"]
    misfits: Float[np.ndarray, " k"]
    distances: Float[np.ndarray, " k"]
    equations: float
    unknowns: int


def shrinkage_path(
    problem: ReducedProblem, scheme: Regularisation, parameters: Float[np.ndarray, " k"]
) -> ShrinkagePath:
    """Table of solutions by one SVD, O(n^3 + k n).

    Notation: R = U diag(s) V', x = V' theta; x_i = t_i + f_i (s_i beta_i / lambda_i - t_i) with
    t = V' towards, beta = U' right and f_i the share that is kept.
    """
    U, s, Vt = np.linalg.svd(problem.R)
    powers = s**2 - problem.shift
    beta, target = U.T @ problem.right, Vt @ problem.towards
    kept = scheme.kept(powers / problem.unit, parameters)
    moved = kept * (s * beta / powers - target)
    x = target + moved
    left = problem.outside + np.sum((beta - s * x) ** 2, axis=1)
    misfits = left / (1.0 + problem.column_errors * np.sum(x**2, axis=1))
    return ShrinkagePath(
        parameters, kept.sum(axis=1), misfits, np.sum(moved**2, axis=1), problem.equations, s.size
    )
