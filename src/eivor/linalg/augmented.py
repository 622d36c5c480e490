"""The augmented system that carries both least squares and total least squares.

    [[s I, A], [A', t I]] [y; theta] = [b; 0]

With t = 0 it is least squares, with t = s = sigma_min([A b]) total least squares (Bjorck 1967; Ivanov and
Zhdanov 2021). Its condition is governed by that of A, not by its square.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from eivor.shapes import Float


def solve_augmented(
    A: Float[np.ndarray, "m n"], b: Float[np.ndarray, " m"], upper: float, lower: float
) -> Float[np.ndarray, " n"]:
    """Theta of the augmented system with `upper` and `lower` on its diagonal blocks.

    A symmetric indefinite solve (Bunch-Kaufman), O((m + n)^3): give it a triangular A of size n.
    Performs no checks.
    """
    rows, unknowns = A.shape
    matrix = np.zeros((rows + unknowns, rows + unknowns))
    matrix[:rows, :rows] = upper * np.eye(rows)
    matrix[:rows, rows:] = A
    matrix[rows:, :rows] = A.T
    matrix[rows:, rows:] = lower * np.eye(unknowns)
    right = np.concatenate([b, np.zeros(unknowns)])
    with np.errstate(all="ignore"):
        solution: Float[np.ndarray, " size"] = scipy.linalg.lapack.dsysv(matrix, right)[2].ravel()
    return solution[rows:]
