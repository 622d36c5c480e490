"""Fractional difference equations: free run, impulse and frequency response, stability, bad input."""

from __future__ import annotations

from itertools import pairwise

import mpmath
import numpy as np
import pytest
from scipy.special import gamma

import eivor as ev
from eivor.errors import (
    DataError,
    MissingChannelError,
    MissingNoiseError,
    NonFiniteError,
    ParameterError,
    ShapeError,
    UsageError,
)
from eivor.lab.fractional_model import FilteredSignals, FractionalPart, Side

ORDER = ev.UnknownOrder("order", 0.2, 1.2)
LAGGED = ev.FractionalDifferenceModel(
    (0.0, ORDER, ev.FractionalTerm(0.3, 1)), (0.0, ev.FractionalTerm(ORDER, 2))
)
LAGGED_TRUTH = {
    "output_coefficient_2": 4.0,
    "output_coefficient_3": -0.7,
    "input_coefficient_1": 1.5,
    "input_coefficient_2": 0.4,
    "order": 0.8,
}


def relaxation(operator=None):
    return ev.FractionalDifferenceModel((0.0, 0.6), (0.0,), operator or ev.FractionalDifference())


def mittag_leffler_step(t):
    """1 - E_alpha(-t^alpha) of order 0.6."""
    return 1.0 - float(
        mpmath.nsum(lambda k: (-(mpmath.mpf(t) ** 0.6)) ** k / mpmath.gamma(0.6 * k + 1), [0, mpmath.inf])
    )


@pytest.mark.parametrize(
    ("operator", "factor"), [(ev.FractionalDifference(), 2.0), (ev.FractionalDerivative(), 4.0)]
)
def test_the_step_response_is_that_of_mittag_leffler_but_for_the_step(operator, factor):
    """Grunwald-Letnikov's error halves with the step; the corrected derivative's falls by four.

    A jump at a sample enters with the mean of its two sides: with one of them alone it comes half a step
    too early or too late, which is an error of the first order by itself.
    """
    errors, true = [], [mittag_leffler_step(t) for t in (1.0, 2.0, 3.0, 4.0)]
    for rate in (20.0, 40.0, 80.0):
        gain = 1.0 if isinstance(operator, ev.FractionalDerivative) else rate**0.6
        u = np.ones(int(4 * rate) + 1)
        u[0] = 0.5
        parameters = {"output_coefficient_2": gain, "input_coefficient_1": 1.0}
        y = relaxation(operator).simulate(parameters, u, rate_hz=rate)
        errors.append(y[int(rate) :: int(rate)] - true)
    assert np.abs(errors[0]).max() < (2e-3 if factor == 2.0 else 1e-4)
    for coarse, fine in pairwise(errors):
        assert np.linalg.norm(coarse) / np.linalg.norm(fine) == pytest.approx(factor, rel=0.1)


@pytest.mark.parametrize(
    ("gain", "order", "growing"), [(-1.1, 0.7, 1), (-0.5, 0.7, 0), (5.0, 0.7, 0), (1e6, 0.9, 0)]
)
def test_growing_modes_of_a_relaxation(gain, order, growing):
    """1 + a (1 - z)^order has a root inside where -1/a is (1 - z)^order of some |z| < 1: see its modulus."""
    assert Side(((1.0, 0.0, 0), (gain, order, 0)), ev.FractionalDifference(), 1.0).growing_modes == growing


def test_an_unstable_equation_is_not_simulated():
    with pytest.raises(ParameterError, match="a stable equation; received one with 1 growing mode"):
        relaxation().simulate({"output_coefficient_2": -3.0, "input_coefficient_1": 1.0}, np.ones(9))


def test_an_equation_without_the_newest_output_is_not_simulated():
    with pytest.raises(ParameterError, match="solved for the newest output"):
        relaxation().impulse_response({"output_coefficient_2": -1.0, "input_coefficient_1": 1.0}, 9)


def bad(call, error, text):
    return pytest.param(call, error, text, id=text)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        bad(lambda: ev.FractionalTerm(3.5), ParameterError, "an order between -3 and 3"),
        bad(lambda: ev.FractionalTerm(0.5, -1), UsageError, "a lag of zero or more samples"),
        bad(lambda: ev.UnknownOrder("a", 0.9, 0.2), ParameterError, "the lower end first"),
        bad(lambda: ev.UnknownOrder("", 0.1, 0.2), UsageError, "a name for an unknown order"),
        bad(
            lambda: ev.FractionalDifferenceModel((ORDER, 0.0), (0.0,)),
            ParameterError,
            "a known order of the first",
        ),
        bad(
            lambda: ev.FractionalDifferenceModel((0.0, ORDER, ev.UnknownOrder("second", 1.1, 1.9)), (0.0,)),
            ParameterError,
            "orders 0.2 to 1.2 and 1.1 to 1.9",
        ),
        bad(
            lambda: ev.FractionalDifferenceModel((0.0, ORDER), (ev.UnknownOrder("order", 0.1, 0.3),)),
            ParameterError,
            "one range of the order 'order'",
        ),
        bad(
            lambda: ev.FractionalDifferenceModel(
                (0.0, ev.UnknownOrder("input_coefficient_1", 0.1, 0.3)), (0.0,)
            ),
            ParameterError,
            "names of their own",
        ),
        bad(
            lambda: LAGGED.simulate({"order": 0.5}, np.ones(9)),
            ParameterError,
            "none of output_coefficient_2",
        ),
        bad(lambda: LAGGED.simulate(LAGGED_TRUTH, np.ones((9, 2))), ShapeError, "an input of shape"),
        bad(lambda: LAGGED.simulate(LAGGED_TRUTH, np.array([1.0, np.nan])), NonFiniteError, "a finite input"),
        bad(lambda: LAGGED.impulse_response(LAGGED_TRUTH, 0), ParameterError, "one sample or more"),
        bad(lambda: LAGGED.impulse_response(LAGGED_TRUTH, 5, rate_hz=0.0), ParameterError, "a positive rate"),
        bad(lambda: LAGGED.frequency_response(LAGGED_TRUTH, np.array([0.7])), ParameterError, "up to 0.5 Hz"),
        bad(
            lambda: LAGGED.frequency_response(LAGGED_TRUTH, np.array(0.1)), ShapeError, "frequencies of shape"
        ),
        bad(lambda: LAGGED.problem(ev.Signals(1.0, {"output": np.ones(9)})), MissingChannelError, "'input'"),
        bad(
            lambda: LAGGED.problem(
                ev.Signals(1.0, {"output": np.ones(9), "input": np.ones(9)}, valid=np.arange(9) > 1)
            ),
            DataError,
            "every sample of which is valid",
        ),
    ],
)
@pytest.mark.usefixtures("unchecked_shapes")
def test_bad_input_is_told(call, error, text):
    with pytest.raises(error, match=text):
        call()


def of_noise(noise, count=60, operator=None, **more):
    signals = ev.Signals(2.0, {"x": np.zeros(count), "z": np.zeros(count)}, noise={"x": noise})
    return FilteredSignals(signals, operator or ev.FractionalDifference(), **more)


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


@pytest.mark.parametrize("operator", [ev.FractionalDifference(), ev.FractionalDerivative()])
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
        FilteredSignals(signals, ev.FractionalDifference())
    gap = ev.Signals(1.0, {"x": np.zeros(9)}, valid=np.arange(9) != 4)
    with pytest.raises(DataError, match="every sample of which is valid; received samples that are not"):
        FilteredSignals(gap, ev.FractionalDifference())
