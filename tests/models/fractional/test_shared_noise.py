"""The noise that fractional columns share, against closed forms and sums term by term."""

import numpy as np
import pytest
from scipy.special import gamma

import eivor as ev
from eivor.errors import DataError, MissingNoiseError, UsageError
from eivor.lab.fractional_model import (
    FilteredSignals,
    FractionalDerivative,
    FractionalDifference,
    FractionalPart,
)


def of_noise(noise, count=60, operator=None, **more):
    signals = ev.Signals(2.0, {"x": np.zeros(count), "z": np.zeros(count)}, noise={"x": noise})
    return FilteredSignals(signals, operator or FractionalDifference(), **more)


@pytest.mark.parametrize(
    ("one", "other", "lag"), [(0.3, 0.6, 0), (0.3, 0.6, 2), (0.7, -0.2, 3), (-0.3, 0.1, 1)]
)
def test_differences_of_white_noise_share_what_gamma_functions_say(one, other, lag):
    record = of_noise(ev.WhiteNoise(0.5), 400_000)
    columns = ((FractionalPart("x", one, lag),), (FractionalPart("x", other),))
    closed = gamma(1.0 + one + other) * gamma(lag - other) if lag or other else 1.0
    closed /= gamma(-other) * gamma(1.0 + other) * gamma(1.0 + one + lag)
    result = record.noise_covariance(columns, lag)[0, 1]
    assert result == pytest.approx(0.25 * closed, rel=2e-3 if min(one, other) < 0.0 else 1e-5)


@pytest.mark.parametrize("operator", [FractionalDifference(), FractionalDerivative()])
@pytest.mark.parametrize("noise", [ev.WhiteNoise(0.5), ev.FractionalNoise(0.5, -0.4)])
def test_shared_noise_is_the_mean_over_the_rows(operator, noise):
    """Row by row, from the definition: the column's filter row times that of the other column."""
    count, first, filter_weights = 40, 5, np.array([1.0, -0.3])
    record = of_noise(noise, count, operator, both_sides=filter_weights)
    columns = (
        (FractionalPart("x", 0.6, 2, -1.5),),
        (FractionalPart("x", 0.0), FractionalPart("x", 0.4, 1, 2.0)),
        (FractionalPart("x", 0.6, 0, 1.0, by_order=True),),
    )

    def dense(weights, lag=0):
        matrix = np.zeros((count, count))
        for k in range(count):
            for m in range(k + 1):
                if k - lag - m >= 0:
                    matrix[k, m] = weights[k - lag - m]
        return matrix

    made = dense(noise.moving_average(count))
    sides = dense(np.concatenate([filter_weights, np.zeros(count)]))

    def column_matrix(column):
        total = 0.0
        for part in column:
            weights = (operator.slope if part.by_order else operator.weights)(part.order, count, 0.5)
            total = total + part.gain * dense(weights, part.lag)
        return total @ sides @ made

    matrices = [column_matrix(column) for column in columns]
    rows = slice(first, None)
    expected = [[np.sum(a[rows] * b[rows]) / (count - first) for b in matrices] for a in matrices]
    assert record.noise_covariance(columns, first) == pytest.approx(np.array(expected), abs=1e-12)
    plain = [ev.Column("x", 3, gain=2.0), ev.Column("z", 1), ev.Column("")]
    lagged = 2.0 * np.vstack([np.zeros((3, count)), made[:-3]])
    shared = [np.sum(lagged[rows] * b[rows]) / (count - first) for b in matrices]
    shared_noise = record.shared_noise(plain, columns, first)
    assert shared_noise[0] == pytest.approx(np.array(shared), abs=1e-12)
    assert not shared_noise[1:].any()


def test_a_noise_that_is_not_declared_is_never_taken_for_none():
    record = of_noise(ev.WhiteNoise(0.5))
    with pytest.raises(MissingNoiseError, match="a declared noise of channel 'z'"):
        record.noise_covariance(((FractionalPart("z", 0.5),),), 0)
    with pytest.raises(MissingNoiseError, match="a declared noise of channel 'z'"):
        record.shared_noise([ev.Column("z", 1)], [(FractionalPart("z", 0.5),)], 1)


def test_instruments_with_a_gain_of_another_channel_are_refused():
    with pytest.raises(UsageError, match="without a gain of another channel"):
        of_noise(ev.WhiteNoise(1.0)).shared_noise(
            [ev.Column("x", gain_channel="z")], [(FractionalPart("x", 0.5),)], 0
        )


def test_parts_of_records_are_refused():
    signals = ev.Signals(1.0, {"x": np.zeros(9)}, offset=4)
    with pytest.raises(DataError, match=r"a whole record, .*; received one that begins at sample 4"):
        FilteredSignals(signals, FractionalDifference())
    gap = ev.Signals(1.0, {"x": np.zeros(9)}, valid=np.arange(9) != 4)
    with pytest.raises(DataError, match="every sample of which is valid; received samples that are not"):
        FilteredSignals(gap, FractionalDifference())
