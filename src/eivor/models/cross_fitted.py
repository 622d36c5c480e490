"""What exogenous signals alone say of others: predictions by least squares, each block's by the other blocks.

A prediction that is fitted to the samples where it is used follows their disturbances too, the more columns
it is made of; as an instrument it would bring back the bias of least squares. Fitted to the rest of a record
and used where nothing was fitted, it has nothing of a disturbance there but what outlasts a block.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from eivor.shapes import Bool, Float

#: Blocks of a record.
BLOCKS = 5
#: Columns of unit variance are shrunk as if so much of their variance were noise: directions in which they
#: hardly differ would else be fitted to what one block happens to hold, and lead far astray in another.
SHRINKAGE = 1e-6


def cross_fitted(
    exogenous: Float[np.ndarray, "n p"],
    values: Float[np.ndarray, "n k"],
    used: Bool[np.ndarray, " n"],
    blocks: int = BLOCKS,
) -> Float[np.ndarray, "n k"]:
    """Predictions of each column, by least squares with a constant over the samples used of other blocks.

    Parameters
    ----------
    exogenous : ndarray, shape (n, p)
        What predicts; none for the means alone.
    values : ndarray, shape (n, k)
        What is predicted.
    used : ndarray of bool, shape (n,)
        Samples that are fitted to. All are predicted.
    blocks : int
        Stretches with equally many of them.

    Returns
    -------
    ndarray, shape (n, k)
        Without instruments, or with too few samples to leave a block out, the means.

    Notes
    -----
    Performs no checks. Sums of products of each block are made once; those of a fit are all but its own.
    """
    design = _scaled(exogenous, used)
    samples = np.flatnonzero(used)
    if samples.size < 2 * blocks * design.shape[1]:
        return np.broadcast_to(values[used].mean(axis=0) if samples.size else 0.0 * values[0], values.shape)
    parts = np.array_split(samples, blocks)
    columns = np.column_stack([design, values])
    products = [design[part].T @ columns[part] for part in parts]
    whole = np.sum(products, axis=0)
    # each block reaches from the middle between its samples and those before to that of those after
    edges = [0, *((before[-1] + after[0] + 1) // 2 for before, after in pairwise(parts))]
    predicted = np.empty_like(values)
    for start, stop, product in zip(edges, [*edges[1:], values.shape[0]], products, strict=True):
        normal, right = np.split(whole - product, [design.shape[1]], axis=1)
        shrunk = SHRINKAGE * normal[0, 0] * np.diag(np.arange(normal.shape[0]) > 0)
        told = np.linalg.lstsq(normal + shrunk, right, rcond=None)[0]
        predicted[start:stop] = design[start:stop] @ told
    return predicted


def _scaled(exogenous: Float[np.ndarray, "n p"], used: Bool[np.ndarray, " n"]) -> Float[np.ndarray, "n q"]:
    """A constant, and the columns with mean zero and variance one over the samples used."""
    constant = np.ones((exogenous.shape[0], 1))
    if not exogenous.shape[1] or not used.any():
        return constant
    centred = exogenous - exogenous[used].mean(axis=0)
    size = np.sqrt(np.mean(centred[used] ** 2, axis=0))
    return np.column_stack([constant, centred / np.where(size > 0.0, size, 1.0)])
