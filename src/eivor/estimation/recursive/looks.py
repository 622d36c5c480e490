"""Looks of a stream: sums of a few successive blocks, and the estimate at the end of each.

Those of a whole chunk are made at once, by one product of blocks with their weights at the ends of looks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eivor.estimation.recursive.faded_products import FadedProducts
from eivor.estimation.recursive.forgetting import BLOCKS_PER_LOOK, Forgetting
from eivor.inference.covariances.covariance import unit_scale
from eivor.shapes import Float

#: Part of a scaled regressor that the others must leave of it.
LOST = 1e-10


@dataclass(frozen=True, slots=True)
class Look:
    """Means over the rows of a look.

    Parameters
    ----------
    sample : int
        Samples of the stream up to its end.
    means : ndarray, shape (p, n + 1)
        Of psi [phi' y], compensated; zeros where no row counted.
    count : float
        Rows that counted.
    """

    sample: int
    means: Float[np.ndarray, "p n_plus_1"]
    count: float


@dataclass(frozen=True, slots=True)
class References:
    """Successive estimates that later looks are held against.

    Parameters
    ----------
    theta : ndarray, shape (W, n)
        The estimates, the newest last.
    mapped : ndarray, shape (W, m, p)
        What a change of the mean scores changes the parameters by that are watched.
    watched : slice
        Which they are.
    """

    theta: Float[np.ndarray, "W n"]
    mapped: Float[np.ndarray, "W m p"]
    watched: slice

    def then(self, later: References, most: int) -> References:
        """The newest of both, `most` at most."""
        theta = np.concatenate([self.theta, later.theta])[-most:]
        return References(theta, np.concatenate([self.mapped, later.mapped])[-most:], self.watched)

    def shown(self, look: Look) -> tuple[Float[np.ndarray, "W m"], Float[np.ndarray, "W m"]]:
        """Changes of the parameters that a look shows, and how well, over what looks do on average."""
        seen = np.matmul(self.mapped, look.means)
        change = seen[:, :, -1] - np.matmul(seen[:, :, :-1], self.theta[:, :, None])[:, :, 0]
        return change, np.diagonal(seen[:, :, self.watched], axis1=1, axis2=2)


def looks_at_once(forgetting: Forgetting) -> int:
    """Most looks that rows may complete: their blocks are still kept apart then."""
    return (forgetting.kept_blocks - BLOCKS_PER_LOOK) // BLOCKS_PER_LOOK


def looks_between(before: FadedProducts, after: FadedProducts) -> Iterator[tuple[Look, References | None]]:
    """Looks that rows complete, `looks_at_once` at most.

    Parameters
    ----------
    before, after : FadedProducts
        Before and after the rows.

    Returns
    -------
    iterator of (Look, References or None)
        Each with the least squares solution of the equations of all rows up to its end; None where they
        have no unique one.
    """
    forgetting = after.forgetting
    first, last = (faded.samples // forgetting.look for faded in (before, after))
    if last == first:
        return
    begun, full = (faded.samples // forgetting.block for faded in (before, after))
    waiting, done = first * BLOCKS_PER_LOOK, last * BLOCKS_PER_LOOK
    end = after.closed.blocks
    blocks = after.closed.between(end - (full - waiting), end - (full - done))
    tables, counts = after.compensated(blocks), blocks.products.counts
    ends = np.arange(first + 1, last + 1) * BLOCKS_PER_LOOK - begun
    ages = ends[:, None] - 1 - np.arange(done - begun)
    fade = forgetting.factor**forgetting.block
    weights, since = np.where(ages >= 0, fade ** np.maximum(ages, 0), 0.0), fade**ends
    new = slice(begun - waiting, None)
    totals = np.tensordot(weights, tables[new], 1) + np.multiply.outer(
        since, before.compensated(before.full)[0]
    )
    rows = weights @ counts[new] + since * before.full.products.count
    sums = tables.reshape(last - first, BLOCKS_PER_LOOK, *tables.shape[1:]).sum(axis=1)
    counted = counts.reshape(last - first, BLOCKS_PER_LOOK).sum(axis=1)
    means = sums / np.where(counted > 0.0, counted, 1.0)[:, None, None]
    for number, reference in enumerate(_references(totals, rows)):
        sample = (first + 1 + number) * forgetting.look
        yield Look(sample, means[number], float(counted[number])), reference


def newest_look(faded: FadedProducts) -> Look:
    """The last full blocks of products that end with a look."""
    blocks = faded.closed.between(faded.closed.blocks - BLOCKS_PER_LOOK, faded.closed.blocks)
    count = blocks.products.count
    means = faded.compensated(blocks).sum(axis=0) / (count if count > 0.0 else 1.0)
    return Look(faded.samples, means, count)


def newest_reference(faded: FadedProducts) -> References | None:
    """Least squares solution of the equations of all full blocks; None where there is no unique one."""
    (found,) = _references(faded.compensated(faded.full), faded.full.products.counts)
    return found


def _references(
    equations: Float[np.ndarray, "L p n_plus_1"], counts: Float[np.ndarray, " L"]
) -> Iterator[References | None]:
    A, b = equations[:, :, :-1], equations[:, :, -1]
    looks, p, n = A.shape
    if p < n:
        yield from [None] * looks
        return
    scale = unit_scale(np.einsum("lpn,lpn->ln", A, A))
    Q, R = np.linalg.qr(A * scale[:, None, :])
    told = np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1) > LOST
    R[~told] = np.eye(n)
    inverse = scale[:, :, None] * np.linalg.solve(R, Q.swapaxes(1, 2))
    theta = np.matmul(inverse, b[:, :, None])[:, :, 0]
    mapped = counts[:, None, None] * inverse
    for number in range(looks):
        here = slice(number, number + 1)
        yield References(theta[here], mapped[here], slice(0, n)) if told[number] else None
