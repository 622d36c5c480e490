"""Recursive identification equals the exponentially weighted batch, however its record is cut."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import eivor as ev
from eivor.errors import InstrumentError, MissingNoiseError, TooFewSamplesError, UsageError
from eivor.estimation.recursive import newest_reference
from eivor.models.signal_regression import shared_noise_of_rows

MOTION = ev.VerticalMotion(intercept=False)
INSTRUMENTS = ev.lags("input", 0, 10)
FACTOR = 0.995


def record(count, *, seed=0, masked=False, fractional=False):
    rng = np.random.default_rng(seed)
    u = np.convolve(rng.standard_normal(count + 2), [0.7, 0.49], "valid")[:count]
    v = np.zeros(count)
    steps = 0.02 * u
    for k in range(1, count):
        v[k] = 0.94 * v[k - 1] + steps[k - 1]
    noise = {"input": ev.FractionalNoise(0.1, -0.3) if fractional else ev.WhiteNoise(0.1)}
    channels = {
        "velocity_z": v + 0.01 * rng.standard_normal(count),
        "acceleration_z": 0.1 * u - 0.3 * v + 0.01 * rng.standard_normal(count),
        "input": u + noise["input"].sample(count, rng),
    }
    valid = None
    if masked:
        valid = rng.random(count) > 0.01
        channels["velocity_z"] = np.where(valid, channels["velocity_z"], np.nan)
    return ev.Signals(5.0, channels, noise=noise, valid=valid)


def part(signals, first, last):
    return replace(
        signals,
        channels={name: values[first:last] for name, values in signals.channels.items()},
        valid=None if signals.valid is None else signals.valid[first:last],
        offset=first,
    )


def after(signals, cuts=(), **options):
    recursion = ev.RecursiveIdentification(
        MOTION, options.pop("method", ev.methods.generalized_iv()), INSTRUMENTS, **options
    )
    for first, last in pairwise([0, *map(int, cuts), signals.sample_count]):
        recursion = recursion.update(part(signals, first, last))
    return recursion


def batch(signals):
    """Dense generalized IV of weighted rows, its compensation averaged with the same weights."""
    problem = MOTION.regression(signals, INSTRUMENTS)
    rows = problem.rows()
    used = np.ones(signals.sample_count - problem.first, bool) if problem.used is None else problem.used
    w = (FACTOR ** np.arange(used.size - 1, -1, -1.0))[used]
    table = (rows.instruments * w[:, None]).T @ np.column_stack([rows.regressors, rows.response])
    noise = shared_noise_of_rows(
        INSTRUMENTS, (*problem.regressor_columns, problem.equation.response), signals, problem.first
    )
    for name, series in noise.items():
        table[name] -= w @ series[used]
    return np.linalg.lstsq(table[:, :2] / w.sum(), table[:, 2] / w.sum(), rcond=None)[0]


def values(estimate):
    return np.array(list(estimate.parameters.values()))


def test_equals_the_weighted_batch_over_two_hundred_thousand_samples():
    signals = record(200_010)
    cuts = np.unique(np.random.default_rng(1).integers(1, signals.sample_count, 60))
    recursion = after(signals, cuts)
    assert recursion.samples == 200_000
    np.testing.assert_allclose(values(recursion.estimate()), batch(signals), rtol=1e-12)


@pytest.mark.parametrize("fractional", [False, True])
def test_equals_the_weighted_batch_where_samples_are_missing(fractional):
    signals = record(900, masked=True, fractional=fractional)
    np.testing.assert_allclose(values(after(signals).estimate()), batch(signals), rtol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "cuts", [range(1, 420), (5, 9, 11, 400), np.arange(7, 420, 7)], ids=["single samples", "few", "sevens"]
)
def test_chunks_of_any_size_give_the_same_estimate_and_intervals(cuts):
    signals = record(420, masked=True, fractional=True)
    whole, cut = after(signals).estimate(), after(signals, cuts).estimate()
    for name in whole.names:
        np.testing.assert_allclose(
            [cut.parameters[name], *cut.interval(name)],
            [whole.parameters[name], *whole.interval(name)],
            rtol=1e-10,
        )


@pytest.mark.parametrize("memory", [200.0, 10.0])
def test_changes_do_not_depend_on_chunks(memory):
    signals = dropped(record(1500), 900)
    given = {"detector": ev.ChangeDetector(), "memory": memory}
    selected, recursion = [], after(part(signals, 0, 1), **given)
    for first, last in pairwise(range(1, 1501, 13)):
        recursion = recursion.update(part(signals, first, last))
        selected += recursion.changes
    assert tuple(selected) == after(part(signals, 0, last), **given).changes
    assert selected


def dropped(signals, sample):
    """The same where the input does 30 % less from a sample on."""
    channels = dict(signals.channels)
    late = np.arange(signals.sample_count) >= sample
    channels["acceleration_z"] = channels["acceleration_z"] - late * 0.03 * signals.channels["input"]
    return replace(signals, channels=channels)


def test_a_drop_is_told_and_what_lay_before_it_forgotten():
    signals = dropped(record(1400), 1000)
    recursion = after(part(signals, 0, 1000), detector=ev.ChangeDetector())
    assert recursion.changes == ()
    recursion = recursion.update(part(signals, 1000, 1150))
    (change,) = recursion.changes
    assert (change.parameter, change.upwards) == ("input_gain", False)
    assert 1000 < change.sample + 10 <= 1150
    without = after(part(signals, 0, 1150)).estimate().parameters["input_gain"]
    assert abs(recursion.estimate().parameters["input_gain"] - 0.07) < 0.5 * abs(without - 0.07)


def test_a_reference_solves_the_equations_of_all_full_blocks():
    weighted = after(record(700, masked=True))._products
    equations, reference = weighted.compensated(weighted.full)[0], newest_reference(weighted)
    solution = np.linalg.lstsq(equations[:, :-1], equations[:, -1], rcond=None)[0]
    np.testing.assert_allclose(reference.theta[0], solution, rtol=1e-9)
    means = equations / weighted.full.products.count
    np.testing.assert_allclose(reference.mapped[0] @ means[:, :-1], np.eye(2), atol=1e-9)


@pytest.mark.thorough
def test_memory_does_not_grow_with_the_stream():
    signals = record(9000)

    def held(recursion):
        weighted, tail = recursion._products, recursion._tail
        return (
            weighted.closed.products.sums.nbytes,
            weighted.full.products.sums.nbytes,
            weighted.waiting.columns.shape[1],
            tail.sample_count,
        )

    early = after(part(signals, 0, 3000), (1000, 2000), detector=ev.ChangeDetector())
    late = after(signals, range(1000, 9000, 1000), detector=ev.ChangeDetector())
    assert held(early) == held(late)
    assert late._products.waiting.count < 10
    assert late._watch.before.shape[0] <= 80
    assert late._watch.references.theta.shape[0] <= 16


def test_effective_rows_are_twice_the_memory():
    assert after(record(4000)).effective_rows == pytest.approx((1 + FACTOR) / (1 - FACTOR), rel=1e-6)


def test_both_covariances_are_alike_for_white_errors_and_know_their_degrees():
    parts = [after(record(6000, seed=seed)).estimate().joint_covariance.parts for seed in range(30)]
    cosines, blocks = (
        np.mean([np.diag(part.matrix) for part in each], axis=0) for each in zip(*parts, strict=True)
    )
    np.testing.assert_allclose(cosines / blocks, 1.0, atol=0.35)
    # squares of weights that fall by a factor: (1 + q) / (1 - q) blocks count, less one for each parameter
    forgetting = after(record(400))._products.forgetting
    q = FACTOR ** (2 * forgetting.block)
    assert parts[0][1].degrees == pytest.approx((1.0 + q) / (1.0 - q) - 2.0, rel=0.05)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_estimates_follow_the_stream():
    signals = record(600)
    chunks = [part(signals, k, k + 50) for k in range(0, 600, 50)]
    recursive_identification = ev.RecursiveIdentification(MOTION, ev.methods.generalized_iv(), INSTRUMENTS)
    identify_recursively = list(ev.identify_recursively(chunks, recursive_identification))
    assert [recursion.samples for recursion, _ in identify_recursively] == [*range(40, 600, 50)]
    low, high = identify_recursively[-1][1].interval("input_gain")
    assert low < 0.1 < high


def test_bias_compensated_least_squares_needs_no_instruments():
    signals = record(2000)
    signals = replace(
        signals,
        noise={**signals.noise, "velocity_z": ev.WhiteNoise(0.01), "acceleration_z": ev.WhiteNoise(0.01)},
    )
    recursion = ev.RecursiveIdentification(MOTION, ev.methods.bias_compensated_least_squares())
    assert recursion.update(signals).estimate().parameters["input_gain"] == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(
    ("method", "instruments", "error", "text"),
    [
        (ev.methods.least_squares(), (), UsageError, "mean cross-products"),
        (ev.methods.reference_iv(), INSTRUMENTS, UsageError, "forgotten row by row"),
        (ev.methods.extended_iv(), INSTRUMENTS, InstrumentError, "no regressor and no response shares"),
        (ev.methods.generalized_iv(), ev.lags("velocity_z", 0, 2), MissingNoiseError, "velocity_z"),
    ],
)
def test_what_cannot_be_recursive_is_refused_with_the_reason(method, instruments, error, text):
    with pytest.raises(error, match=text):
        ev.RecursiveIdentification(MOTION, method, instruments).update(record(50))


def test_nothing_is_estimated_before_there_are_rows():
    recursion = ev.RecursiveIdentification(MOTION, ev.methods.generalized_iv(), INSTRUMENTS)
    with pytest.raises(TooFewSamplesError, match="none so far"):
        recursion.estimate()
    with pytest.raises(TooFewSamplesError, match="not forgotten"):
        recursion.update(part(record(50), 0, 5)).estimate()


def test_wrong_numbers_are_refused():
    with pytest.raises(UsageError, match="memory of 10"):
        after(record(50), memory=1.0)
    with pytest.raises(UsageError, match="limit above the drift"):
        ev.ChangeDetector(limit=0.5)
    with pytest.raises(UsageError, match="above zero"):
        ev.ChangeDetector(threshold=0.0)
