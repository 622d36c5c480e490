"""Triangular roots: what an orthogonal reduction keeps of many rows, and how roots merge."""

from __future__ import annotations

import numpy as np

from eivor.linalg.row_blocks import COPIED_ROWS, row_blocks
from eivor.shapes import Float


def triangular_root(rows: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "k n"]:
    """R of the QR factorisation of `rows`, k = min(m, n): R'R = rows' rows, and no condition is squared.

    Performs no checks; O(m n^2), in blocks, so that the copy that QR makes stays small.
    """
    if rows.shape[0] <= 2 * COPIED_ROWS:
        return _reduced(rows)
    root = _reduced(rows[:COPIED_ROWS])
    for first, stop in row_blocks(COPIED_ROWS, rows.shape[0], COPIED_ROWS):
        root = merged_roots(root, rows[first:stop])
    return root


def merged_roots(one: Float[np.ndarray, "k n"], other: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "q n"]:
    """Root of two stacked blocks of rows, either of which may be a root itself."""
    return _reduced(np.concatenate([one, other]))


def _reduced(rows: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "k n"]:
    root: Float[np.ndarray, "k n"] = np.asarray(np.linalg.qr(rows, mode="r"))
    return root
