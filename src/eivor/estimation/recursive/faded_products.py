"""Products of a stream of rows, faded by exponential forgetting, in memory that does not grow.

Sums of successive blocks of samples are made once, each with the weights that its rows have at its end, and
added to one sum that fades. Those of the last memories are kept apart as well, so that what an estimate
leaves of each block is known, which robust intervals and the detector of changes need. Samples of a block
that is not full yet wait as rows. Blocks begin at multiples of their length after the first row: however a
stream is cut into chunks, the sums are of the same rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.estimation.moments import CrossMoments
from eivor.estimation.recursive.forgetting import Forgetting
from eivor.estimation.recursive.timed_rows import TimedRows
from eivor.inference.products import ProductLayout, Products
from eivor.shapes import Float


@dataclass(frozen=True)
class BlockSums:
    """Weighted sums of blocks of rows. Performs no checks.

    Parameters
    ----------
    products : Products
        Of psi, regressors and response; counts are sums of weights.
    noise : ndarray, shape (K, s)
        Weighted sums of what noises add to some of the products.
    squares : ndarray, shape (K,)
        Sums of squared weights.
    """

    products: Products
    noise: Float[np.ndarray, "K s"]
    squares: Float[np.ndarray, " K"]

    @property
    def blocks(self) -> int:
        """How many."""
        return self.squares.size

    def __add__(self, other: BlockSums) -> BlockSums:
        """Blocks of both, one after the other."""
        return BlockSums(
            self.products + other.products,
            np.concatenate([self.noise, other.noise]),
            np.concatenate([self.squares, other.squares]),
        )

    def between(self, start: int, stop: int) -> BlockSums:
        """Some of the blocks."""
        here = slice(start, stop)
        products = replace(self.products, counts=self.products.counts[here], sums=self.products.sums[here])
        return BlockSums(products, self.noise[here], self.squares[here])

    def faded(self, factors: Float[np.ndarray, " K"]) -> BlockSums:
        """One sum of all, each block with a factor."""
        return BlockSums(
            self.products.weighted(factors),
            (factors @ self.noise)[None, :],
            np.array([factors**2 @ self.squares]),
        )


def sums_of_rows(rows: TimedRows, forgetting: Forgetting, length: int, *, whole: bool) -> BlockSums:
    """Sums of blocks of `length` rows each, weighted to the end of each block.

    Parameters
    ----------
    rows : TimedRows
        A multiple of `length`.
    forgetting : Forgetting
        Weights.
    length : int
        Rows of a block.
    whole : bool
        Whether all columns are multiplied with each other, see `ProductLayout`.
    """
    weights = forgetting.weights(length)
    blocks = rows.count // max(length, 1)
    left, right, noise = (
        part.reshape(blocks, length, part.shape[1]) for part in (rows.psi, rows.right, rows.noise)
    )
    if whole:
        left = right = np.concatenate([left, right], axis=2)
    sums = np.matmul((left * weights[:, None]).swapaxes(1, 2), right)
    counted = rows.counted.reshape(blocks, length)
    layout = ProductLayout(rows.psi.shape[1], rows.right.shape[1] - 1, whole)
    return BlockSums(
        Products(counted @ weights, sums, layout),
        np.tensordot(noise, weights, (1, 0)),
        counted @ weights**2,
    )


@dataclass(frozen=True)
class FadedProducts:
    """Products of all rows so far, faded.

    Parameters
    ----------
    forgetting : Forgetting
        How fast.
    whole : bool
        Whether all columns are multiplied with each other.
    full : BlockSums
        One sum of all full blocks, faded to the end of the last.
    closed : BlockSums
        The last full blocks, each faded to its own end.
    waiting : TimedRows
        Rows of the block that is not full yet.
    samples : int
        Samples so far, those among them that did not count.
    """

    forgetting: Forgetting
    whole: bool
    full: BlockSums
    closed: BlockSums
    waiting: TimedRows
    samples: int = 0

    def then(self, rows: TimedRows) -> FadedProducts:
        """With the rows that follow."""
        length = self.forgetting.block
        joined = self.waiting.then(rows)
        full = joined.count // length * length
        seen = replace(self, waiting=joined.between(full, joined.count), samples=self.samples + rows.count)
        if not full:
            return seen
        found = sums_of_rows(joined.between(0, full), self.forgetting, length, whole=self.whole)
        faded = np.append(self.forgetting.factor**full, self._block_factors(found.blocks))
        closed = self.closed + found
        first = max(closed.blocks - self.forgetting.kept_blocks, 0)
        return replace(
            seen, full=(self.full + found).faded(faded), closed=closed.between(first, closed.blocks)
        )

    def last(self, blocks: int) -> FadedProducts:
        """The same with the last full blocks only, and the rows that wait: all else is forgotten."""
        kept = self.closed.between(max(self.closed.blocks - blocks, 0), self.closed.blocks)
        return replace(self, full=kept.faded(self._block_factors(kept.blocks)), closed=kept)

    def _block_factors(self, blocks: int) -> Float[np.ndarray, " blocks"]:
        """Weights of successive full blocks at the end of the last."""
        ages = np.arange(blocks - 1, -1, -1.0)
        factors: Float[np.ndarray, " blocks"] = self.forgetting.factor ** (self.forgetting.block * ages)
        return factors

    @cached_property
    def _waiting_sums(self) -> BlockSums:
        return sums_of_rows(self.waiting, self.forgetting, self.waiting.count, whole=self.whole)

    @property
    def _since(self) -> float:
        """Weight of the last full block's end now."""
        return self.forgetting.factor**self.waiting.count

    @cached_property
    def recent(self) -> tuple[BlockSums, Float[np.ndarray, " K"]]:
        """Blocks that are kept apart, rows that wait as one of them, each faded to its end; and weights."""
        factors = self._since * self._block_factors(self.closed.blocks)
        if not self.waiting.count:
            return self.closed, factors
        return self.closed + self._waiting_sums, np.append(factors, 1.0)

    @cached_property
    def total(self) -> BlockSums:
        """One sum of all rows, with the weights that they have now."""
        if not self.waiting.count:
            return self.full
        return (self.full + self._waiting_sums).faded(np.array([self._since, 1.0]))

    @property
    def effective_rows(self) -> float:
        """Rows of equal weight whose mean scatters as much as that of all rows so far."""
        count, squares = self.total.products.count, float(self.total.squares[0])
        return count**2 / squares if squares > 0.0 else 0.0

    @property
    def moments(self) -> CrossMoments:
        """Weighted means; performs no check that there are rows."""
        total = self.total
        return CrossMoments(total.products, self.noise_table(total)[0] / total.products.count)

    def noise_table(self, sums: BlockSums) -> Float[np.ndarray, "K p n_plus_1"]:
        """What noises add to the products psi [phi' y] of blocks."""
        layout = sums.products.layout
        table = np.zeros((sums.blocks, layout.instruments, layout.regressors + 1))
        for number, place in enumerate(self.waiting.places):
            table[:, *place] = sums.noise[:, number]
        return table

    def compensated(self, sums: BlockSums) -> Float[np.ndarray, "K p n_plus_1"]:
        """Sums of psi [phi' y] of blocks, without what noises add to them."""
        return sums.products.equations - self.noise_table(sums)

    def scores(self, sums: BlockSums, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, "K p"]:
        """What an estimate leaves of each block: compensated sums of psi times the residual."""
        left = self.compensated(sums)
        return left[:, :, -1] - left[:, :, :-1] @ theta


def nothing_yet(rows: TimedRows, forgetting: Forgetting, *, whole: bool) -> FadedProducts:
    """Products of no rows, with the columns of some."""
    none = rows.between(0, 0)
    empty = sums_of_rows(none, forgetting, forgetting.block, whole=whole)
    return FadedProducts(forgetting, whole, _zero(empty), empty, none)


def _zero(sums: BlockSums) -> BlockSums:
    """One block of nothing."""
    layout = sums.products.layout
    products = Products(np.zeros(1), np.zeros((1, *layout.shape)), layout)
    return BlockSums(products, np.zeros((1, sums.noise.shape[1])), np.zeros(1))
