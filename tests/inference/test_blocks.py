"""Blocks: how they are drawn, how long they are, and that sums over pieces are sums over rows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from eivor.inference.bootstrap import (
    BlockPlan,
    BlockScheme,
    autocovariance,
    automatic_block_length,
    block_plan,
    piece_sums,
)


@pytest.mark.parametrize("scheme", list(BlockScheme))
@pytest.mark.parametrize(("rows", "length"), [(100, 1), (1003, 7), (50_000, 40), (10, 10), (7, 3)])
def test_replicates_have_as_many_atoms_as_the_record(scheme: BlockScheme, rows: int, length: int) -> None:
    plan = block_plan(rows, float(length), scheme)
    assert plan.bounds[0] == 0
    assert plan.bounds[-1] == rows
    sizes = np.diff(plan.bounds)
    assert sizes.min() >= 1
    assert sizes.max() - sizes.min() <= 1
    assert abs(plan.block_length - length) <= 0.5 * length
    pieces = plan.drawn(np.random.default_rng(0))
    assert pieces.min() >= 0
    assert pieces.max() < plan.pieces
    assert pieces.size * plan.span == plan.atoms
    drawn = plan.rows_of(pieces)
    assert drawn.min() >= 0
    assert drawn.max() < rows


def test_short_records_have_atoms_of_one_row() -> None:
    plan = block_plan(1000, 10.0)
    assert plan == BlockPlan(1000, 100, 10)
    pieces = np.array([3, 995])
    assert plan.rows_of(pieces).tolist() == [*range(3, 13), 995, 996, 997, 998, 999, 0, 1, 2, 3, 4]


def test_blocks_of_one_row_are_rows_drawn_independently() -> None:
    plan = block_plan(200, 1.0)
    drawn = plan.rows_of(plan.drawn(np.random.default_rng(5)))
    np.testing.assert_array_equal(drawn, np.random.default_rng(5).integers(0, 200, 200))


def test_moving_blocks_stay_inside_the_record() -> None:
    plan = block_plan(100, 10.0, BlockScheme.MOVING)
    random = np.random.default_rng(2)
    for _ in range(50):
        blocks = plan.rows_of(plan.drawn(random)).reshape(-1, 10)
        assert (np.diff(blocks, axis=1) == 1).all()


@pytest.mark.thorough
def test_on_the_circle_every_row_is_drawn_equally_often() -> None:
    plan, random, runs = block_plan(60, 6.0), np.random.default_rng(3), 4_000
    counts = np.zeros(60)
    for _ in range(runs):
        counts += np.bincount(plan.rows_of(plan.drawn(random)), minlength=60)
    assert np.abs(counts / runs - 1.0).max() < 5.0 / np.sqrt(runs)


def test_lengths_of_stationary_blocks_are_geometric() -> None:
    plan, random = block_plan(4000, 8.0, BlockScheme.STATIONARY), np.random.default_rng(4)
    follow = [np.diff(plan.drawn(random)) for _ in range(20)]
    ends = np.mean([np.mean((step != 1) & (step != 1 - plan.atoms)) for step in follow])
    assert ends == pytest.approx(1.0 / plan.steps, rel=0.05)


@pytest.mark.parametrize("scheme", list(BlockScheme))
def test_sums_over_pieces_are_sums_over_their_rows(scheme: BlockScheme) -> None:
    values = np.random.default_rng(6).normal(size=(20_001, 2))
    plan = block_plan(20_001, 100.0, scheme)
    atoms = np.add.reduceat(values, plan.bounds[:-1], axis=0)
    sums = piece_sums(atoms, plan)
    assert sums.shape == (plan.pieces, 2)
    for piece in (0, 17, plan.pieces - 1):
        wanted = values[plan.rows_of(np.array([piece]))].sum(axis=0)
        np.testing.assert_allclose(sums[piece], wanted, rtol=1e-12, atol=1e-12)


def test_autocovariance_is_its_formula() -> None:
    x = np.random.default_rng(8).normal(size=101)
    x -= x.mean()
    wanted = [float(x[k:] @ x[: x.size - k]) / x.size for k in range(20)]
    np.testing.assert_allclose(autocovariance(x, 19), wanted, atol=1e-14)


@pytest.mark.parametrize("memory", [0.3, 0.6])
@pytest.mark.parametrize(("scheme", "factor"), [(BlockScheme.CIRCULAR, 6.0), (BlockScheme.STATIONARY, 4.0)])
def test_automatic_length_finds_the_best_one_of_first_order_noise(
    memory: float, scheme: BlockScheme, factor: float
) -> None:
    """AR(1): G / g = 2 r / (1 - r^2), so the best length is (factor r^2 / (1 - r^2)^2 N)^(1/3)."""
    rows, random = 4000, np.random.default_rng(9)
    results = [
        automatic_block_length(lfilter([1.0], [1.0, -memory], random.normal(size=(rows, 1)), axis=0), scheme)
        for _ in range(60)
    ]
    best = (factor * memory**2 / (1.0 - memory**2) ** 2 * rows) ** (1.0 / 3.0)
    assert float(np.median(results)) == pytest.approx(best, rel=0.15)


def test_automatic_length_of_white_noise_is_short_and_that_of_a_trend_long() -> None:
    random = np.random.default_rng(10)
    white = [automatic_block_length(random.normal(size=(1000, 1))) for _ in range(40)]
    assert float(np.median(white)) < 4.0
    assert automatic_block_length(np.arange(1000.0)[:, None]) > 60.0
    assert automatic_block_length(np.ones((100, 1))) == 1.0


def test_the_most_persistent_series_decides() -> None:
    random = np.random.default_rng(11)
    slow = lfilter([1.0], [1.0, -0.9], random.normal(size=2000))
    both = np.column_stack([random.normal(size=2000), slow])
    alone = automatic_block_length(slow[:, None])
    assert automatic_block_length(both) == pytest.approx(alone)
