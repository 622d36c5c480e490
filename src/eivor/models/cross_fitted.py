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
#: Directions of the exogenous columns that are smaller than this share of the largest are left out.
INDEPENDENT = 1e-9


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
    design = _independent(exogenous, used)
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
        told = np.linalg.lstsq(normal, right, rcond=INDEPENDENT)[0]
        predicted[start:stop] = design[start:stop] @ told
    return predicted


def _independent(
    exogenous: Float[np.ndarray, "n p"], used: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n q"]:
    """A constant, and independent combinations of the columns, of mean square one over the samples used."""
    constant = np.ones((exogenous.shape[0], 1))
    if not exogenous.shape[1] or not used.any():
        return constant
    centred = exogenous - exogenous[used].mean(axis=0)
    size = np.sqrt(np.mean(centred[used] ** 2, axis=0))
    scaled = centred / np.where(size > 0.0, size, 1.0)
    _, sizes, directions = np.linalg.svd(np.linalg.qr(scaled[used], mode="r"))
    kept = sizes > np.sqrt(INDEPENDENT) * sizes[0]
    turned = scaled @ directions[kept].T
    return np.column_stack([constant, turned * (np.sqrt(used.sum()) / sizes[kept])])
