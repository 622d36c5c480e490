"""The augmented system that carries least squares, total least squares, and both of them regularised.

    [[s I, A], [A', t I]] [y; theta] = [b; c]

With c = 0 and t = 0 it is least squares, with t = s = sigma_min([A b]) total least squares (Bjorck 1967;
Ivanov and Zhdanov 2021). A shift of t and a c that is no zero pull theta towards a vector, see
`eivor.linalg.regularised`. Its condition is governed by that of A, not by its square.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from eivor.shapes import Float


def solve_augmented(
    A: Float[np.ndarray, "m n"],
    b: Float[np.ndarray, " m"],
    upper: float,
    lower: float,
    below: Float[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, " n"]:
    """Theta of the augmented system with `upper` and `lower` on its diagonal blocks, and `below` for c.

    A symmetric indefinite solve (Bunch-Kaufman), O((m + n)^3): give it a triangular A of size n.
    Performs no checks.
    """
    rows, unknowns = A.shape
    matrix = np.zeros((rows + unknowns, rows + unknowns))
    matrix[:rows, :rows] = upper * np.eye(rows)
    matrix[:rows, rows:] = A
    matrix[rows:, :rows] = A.T
    matrix[rows:, rows:] = lower * np.eye(unknowns)
    right = np.concatenate([b, np.zeros(unknowns) if below is None else below])
    with np.errstate(all="ignore"):
        solution: Float[np.ndarray, " size"] = scipy.linalg.lapack.dsysv(matrix, right)[2].ravel()
    return solution[rows:]


def balanced(R: Float[np.ndarray, "n n"], shift: float) -> float:
    """Value of s in [[s I, R], [R', (shift/s) I]] that keeps it as well conditioned as R."""
    smallest = float(np.linalg.svd(R, compute_uv=False)[-1])
    return max(float(np.sqrt(abs(shift))), smallest / float(np.sqrt(2.0)))
