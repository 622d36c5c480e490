"""Order and strength of a noise from a record at rest, over many seeds."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest
from cost import in_transforms

from eivor.errors import NonFiniteError, ParameterError, TooFewSamplesError
from eivor.signals.noise import FractionalNoise, estimate_long_memory, fractional_difference

RUNS = 500


@pytest.mark.calibration
@pytest.mark.parametrize("bandwidth", [None, 1999])
@pytest.mark.parametrize("order", [-0.5, -0.4, 0.0, 0.3, 0.5])
def test_estimates_are_centred_and_their_errors_cover(order, bandwidth):
    rng = np.random.default_rng([31, int(10 * order + 10), bandwidth or 0])
    records = 1.7 * fractional_difference(rng.standard_normal((4000, RUNS)), order) + 9.81
    results = [estimate_long_memory(record.copy(), bandwidth=bandwidth) for record in records.T]
    order_scores = np.array([(result.order - order) / result.order_error for result in results])
    std_scores = np.array([(result.std - 1.7) / result.std_error for result in results])
    # The periodogram's own bias is of the order of log(m)/sqrt(m): a fifth of a standard error at most.
    for scores in (order_scores, std_scores):
        assert abs(scores.mean()) < 0.2 + 4.0 / np.sqrt(RUNS)
        assert scores.std() == pytest.approx(1.0, abs=0.03 + 4.0 / np.sqrt(2.0 * RUNS))
    covered = np.mean([low <= order <= high for low, high in (result.order_interval() for result in results)])
    assert abs(covered - 0.95) < 0.01 + 3.5 * np.sqrt(0.95 * 0.05 / RUNS)


def test_errors_are_those_of_the_theory():
    values = np.random.default_rng(4).standard_normal(100_001)
    local, whole = (estimate_long_memory(values, bandwidth=m) for m in (500, 50_000))
    assert local.order_error == pytest.approx(0.5 / np.sqrt(500), rel=0.04)  # ln(m)^2 / (2m) more
    assert whole.order_error == pytest.approx(np.sqrt(6.0 / np.pi**2 / values.size), rel=0.01)
    assert whole.std_error == pytest.approx(whole.std / np.sqrt(2.0 * values.size), rel=0.01)
    assert local.bandwidth == 500
    assert estimate_long_memory(values).bandwidth == int(100_001**0.65)
    low, high = whole.order_interval(0.9)
    assert high - low == pytest.approx(2.0 * NormalDist().inv_cdf(0.95) * whole.order_error)


def test_unit_and_mean_do_not_matter():
    values = FractionalNoise(0.02, -0.4).sample(3000, np.random.default_rng(6))
    memory, other = estimate_long_memory(values), estimate_long_memory(1e3 * values + 5.0)
    assert other.order == pytest.approx(memory.order, abs=1e-9)
    assert other.std == pytest.approx(1e3 * memory.std, rel=1e-9)
    assert memory.memory == -memory.order


def test_short_memory_at_high_frequencies_is_left_out():
    """A moving average on top of order -0.4 shifts the estimate from all frequencies, not the local one."""
    rng = np.random.default_rng(9)
    values = fractional_difference(rng.standard_normal(60_001), -0.4)
    blurred = values[1:] + 0.9 * values[:-1]
    local, whole = estimate_long_memory(blurred), estimate_long_memory(blurred, bandwidth=29_999)
    assert abs(local.order + 0.4) < 4.0 * local.order_error
    assert abs(whole.order + 0.4) > 20.0 * whole.order_error
    # Delta^-0.4 of white noise with 1.9 times the std is what it is like at low frequencies.
    assert local.std == pytest.approx(1.9, abs=4.0 * local.std_error)


def test_noise_to_declare():
    record = fractional_difference(np.random.default_rng(3).standard_normal(2000), -0.7)
    memory = estimate_long_memory(record)
    assert memory.order < -0.5
    assert memory.noise() == FractionalNoise(memory.std, memory.order)


@pytest.mark.thorough
def test_a_million_samples_take_as_long_as_a_few_transforms():
    """About six, of 0.04 s each."""
    rng = np.random.default_rng(0)
    values = FractionalNoise(1.0, -0.5).sample(999_983, rng)  # a prime: the FFT's worst case
    memory = estimate_long_memory(values)
    assert in_transforms(lambda: estimate_long_memory(values), values.size) < 20.0
    assert abs(memory.order + 0.5) < 5.0 * memory.order_error


@pytest.mark.parametrize(
    ("values", "options", "error", "said"),
    [
        (np.arange(10.0), {}, TooFewSamplesError, "Expected 17 samples or more; received 10"),
        (np.full(100, 3.3), {}, ParameterError, "a record that varies; received a constant one"),
        (np.zeros(100), {}, ParameterError, "a record that varies; received a constant one"),
        (np.full(100, np.nan), {}, NonFiniteError, "finite values; received NaN"),
        (
            np.arange(100.0),
            {"bandwidth": 50},
            ParameterError,
            "from 8 to 49 frequencies; received bandwidth=50",
        ),
        (
            np.arange(100.0),
            {"bandwidth": 3},
            ParameterError,
            "from 8 to 49 frequencies; received bandwidth=3",
        ),
    ],
)
def test_records_that_tell_nothing(values, options, error, said):
    with pytest.raises(error, match=said):
        estimate_long_memory(values, **options)


def test_level_is_a_probability():
    with pytest.raises(ParameterError, match=r"a level between 0 and 1; received level=95"):
        estimate_long_memory(np.arange(100.0) % 7).order_interval(95.0)
