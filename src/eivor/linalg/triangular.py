"""Triangular roots: what an orthogonal reduction keeps of many rows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def triangular_root(rows: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "k n"]:
    """R of the QR factorisation of `rows`, k = min(m, n): R'R = rows' rows, and no condition is squared.

    Performs no checks; O(m n^2).
    """
    root: Float[np.ndarray, "k n"] = np.asarray(np.linalg.qr(rows, mode="r"))
    return root
