"""Parameters and residuals that vary periodically: what varies, with which period, by how much; and size."""

from __future__ import annotations

import instrument_data as data
import numpy as np
import pytest
from scipy import stats

from eivor.inference.diagnostics.excitation import Periodicity, block_sums, blocks_of, strongest_swings
from eivor.inference.diagnostics.record import Subject
from eivor.inference.diagnostics.residuals import influences
from eivor.inference.verdict import Status

STEP = 0.05
BLOCKS = 128
SUBJECT = Subject(("slope", "other"), np.ones(2), str, 2560)


def found_of(seed, *, slope=0.0, pushed=0.0, period=5.0, memory=0.5, count=2560, gap=False):
    """Least squares of y on two columns and a constant; the first one's parameter, or a push, swings."""
    rng = np.random.default_rng(seed)
    X = np.column_stack([data.autoregression(rng, (count, 2), 0.95), np.ones(count)])
    times = STEP * (np.arange(count) + (np.arange(count) > count // 3) * 333 * gap)
    swing = np.cos(2.0 * np.pi * times / period + 1.0)
    y = (1.0 + slope * swing) * X[:, 0] - 0.5 * X[:, 1] + pushed * swing
    y += data.autoregression(rng, (count,), memory)
    residual = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    sums = (X[:, :2] * residual[:, None]).reshape(BLOCKS, -1, 2).sum(axis=1)
    made = influences(sums, X[:, :2].T @ X[:, :2])
    counts = np.full(BLOCKS, count / BLOCKS)
    of_parameters = block_sums(made, counts, times, STEP)
    return Periodicity(
        strongest_swings(of_parameters, (("slope", "N/m"), ("other", ""))),
        strongest_swings(blocks_of(residual, times, STEP, BLOCKS), (("push", "N"),), 1.0 / count),
        "s",
        1.0 / of_parameters.span,
    )


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize(("what", "of"), [("slope", "slope"), ("pushed", "push")])
def test_what_swings_is_named_with_period_and_amplitude(what, of, gap):
    for seed in range(5):
        result = found_of(seed, gap=gap, **{what: 0.8})
        assert result.speaks
        assert result.strongest.of == of
        assert result.strongest.period == pytest.approx(5.0, rel=0.03)
        assert result.strongest.amplitude == pytest.approx(0.8, rel=0.35)


def test_a_parameter_that_pushes_too_is_the_one_that_varies():
    result = found_of(1, slope=0.8, pushed=1.0)
    assert min(result.tested, key=lambda item: item.p_value).of == "push"
    assert result.strongest.of == "slope"


def test_sentences_have_number_unit_and_period():
    parameter, push = found_of(1, slope=0.8), found_of(1, pushed=0.8)
    (weak,), (reported,) = list(parameter.reasons(SUBJECT)), list(push.reasons(SUBJECT))
    assert weak.status is Status.WEAK
    assert weak.sentence.startswith(f"slope varies by {parameter.strongest.extent} with a period of ")
    assert parameter.strongest.extent.endswith(" N/m")
    assert reported.status is Status.IDENTIFIED
    assert f"swings by {push.strongest.extent} with a period of" in reported.sentence
    assert not list(found_of(1).reasons(SUBJECT))
    assert [row.of for row in push.rows(SUBJECT)] == ["", *2 * ["slope"], *2 * ["other"], *2 * ["push"]]
    assert "most likely push by" in next(iter(push.lines(SUBJECT)))


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_size(memory):
    """Bonferroni's bound holds: rejections at .05 are at most that, within their binomial error."""
    runs = 60
    results = [found_of(seed, memory=memory) for seed in range(runs)]
    assert sum(result.p_value < 0.05 for result in results) <= stats.binom.ppf(1.0 - 1e-3, runs, 0.05)
    assert sum(result.speaks for result in results) <= stats.binom.ppf(1.0 - 1e-3, runs, 0.01)


def test_few_blocks_and_no_power_say_nothing():
    few = blocks_of(np.ones(31), STEP * np.arange(31), STEP, 31)
    assert strongest_swings(few, (("a", ""),)) == ()
    still = blocks_of(np.ones(640), STEP * np.arange(640), STEP, 64)
    assert strongest_swings(still, (("a", ""),))[0].p_value == 1.0


def test_rows_one_step_apart_need_no_times():
    counts = np.array([3.0, 4.0, 3.0])
    sums = block_sums(np.zeros((3, 1)), counts, 0.1 * np.arange(10), 0.1)
    even = block_sums(np.zeros((3, 1)), counts, None, 0.1)
    np.testing.assert_allclose(even.times, sums.times, rtol=1e-14)
    assert (even.block, even.span) == pytest.approx((sums.block, sums.span), rel=1e-14)
