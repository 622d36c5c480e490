"""Columns and the rows that an equation cuts from signals, against matrices built by hand."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eivor.errors import MissingChannelError, MissingNoiseError, TooFewSamplesError, UsageError
from eivor.models.regression import Column, Equation, Parameter, lags
from eivor.models.signal_regression import SignalRegression
from eivor.motions.vertical.model import GRAVITY, VerticalMotion
from eivor.signals.noise import FractionalNoise, WhiteNoise
from eivor.signals.signals import Signals

NAMES = ("velocity_z", "specific_force_z", "input", "cos_tilt")


def make_signals(count, seed=0, valid=None, **more):
    rng = np.random.default_rng(seed)
    channels = {name: rng.standard_normal(count) for name in NAMES}
    if valid is not None:
        valid = np.asarray(valid, dtype=bool)
        for values in channels.values():
            values[~valid] = np.nan
    return Signals(5.0, channels, valid=valid, **more)


@pytest.mark.parametrize(("first", "last"), [(2, 1), (-1, 3), (0, 99_999_999_999), (0, 10_000)])
def test_impossible_lags_are_refused(first, last):
    with pytest.raises(UsageError, match="Expected"):
        lags("input", first, last)


@given(
    mask=st.lists(st.booleans(), min_size=12, max_size=40),
    lag=st.integers(0, 6),
    gain=st.floats(-3.0, 3.0),
    seed=st.integers(0, 99),
)
def test_rows_are_those_of_a_loop_over_valid_histories(mask, lag, gain, seed):
    signals = make_signals(len(mask), seed, valid=mask)
    term = Column("input", lag, gain, "cos_tilt")
    equation = Equation(
        Column("specific_force_z"),
        (
            (Parameter("a"), Column("velocity_z", gain=-1.0)),
            (Parameter("b"), term),
            (Parameter("c"), Column("")),
        ),
    )
    instruments = (Column("input", 2), Column(""))
    longest = max(lag, 2)
    u, v, s, r = (signals.channels[name] for name in ("input", "velocity_z", "specific_force_z", "cos_tilt"))
    rows = [
        (s[k], -v[k], gain * r[k] * u[k - lag], 1.0, u[k - 2], 1.0)
        for k in range(longest, len(mask))
        if all(mask[k - longest : k + 1])
    ]
    problem = SignalRegression(signals, equation, instruments)
    if len(rows) < 3:
        with pytest.raises(TooFewSamplesError, match="Expected"):
            problem.rows()
        return
    result, wanted = problem.rows(), np.array(rows)
    np.testing.assert_array_equal(result.response, wanted[:, 0])
    np.testing.assert_allclose(result.regressors, wanted[:, 1:4], rtol=1e-15)
    np.testing.assert_array_equal(result.instruments, wanted[:, 4:])
    assert result.names == ("a", "b", "c")
    assert problem.rows() is result


def test_vertical_motion_has_the_signs_of_its_equation():
    signals = make_signals(20)
    rows = VerticalMotion().regression(signals, lags("input", 1, 3)).rows()
    assert rows.names == ("viscous_friction", "input_gain", "intercept")
    assert rows.units == ("1/s", "m/s^2", "m/s^2")
    v, u = (signals.channel(name)[3:] for name in ("velocity_z", "input"))
    np.testing.assert_array_equal(rows.regressors, np.column_stack([-v, u, np.ones(17)]))
    # The intercept instruments itself, and only where there are instruments and an intercept.
    np.testing.assert_array_equal(rows.instruments[:, -1], 1.0)
    assert VerticalMotion(intercept=False).regression(
        signals, lags("input", 1, 3)
    ).rows().instruments.shape == (17, 3)
    assert VerticalMotion().regression(signals).rows().instruments.shape == (20, 0)


@pytest.mark.parametrize("count", [0, 1, 3, 5])
@pytest.mark.parametrize("valid", [None, "first", "none"])
def test_records_shorter_than_the_lags_are_too_short_whatever_is_asked_first(count, valid):
    mask = {None: None, "first": np.arange(count) != 0, "none": np.zeros(count, dtype=bool)}[valid]
    noise = {name: WhiteNoise(0.1) for name in NAMES}
    signals = make_signals(count, valid=mask, noise=noise)
    motion = VerticalMotion(intercept=False)
    for ask in (
        "rows",
        "instrument_noise_covariance",
        "regressor_noise_covariance",
        "instruments_share_noise",
    ):
        problem = motion.regression(signals, lags("input", 0, 5))
        with pytest.raises(TooFewSamplesError, match=r"Expected .*; received"):
            getattr(problem, ask)()


def test_a_channel_that_is_not_there_is_named():
    signals = Signals(5.0, {"velocity_z": np.zeros(4), "input": np.zeros(4)})
    with pytest.raises(MissingChannelError, match="'specific_force_z'"):
        VerticalMotion().regression(signals).rows()


def test_the_response_is_the_specific_force_and_else_the_acceleration():
    """One meaning each: z'' + g and z''. What differs is the weight: in the input, or in the intercept."""
    rng = np.random.default_rng(5)
    velocity, deviation = rng.standard_normal((2, 50))
    acceleration = 0.02 * deviation - 0.3 * velocity
    about_hover = {"velocity_z": velocity, "input": deviation, "acceleration_z": acceleration}
    whole = {"velocity_z": velocity, "input": deviation + GRAVITY / 0.02}
    with_force = whole | {"specific_force_z": acceleration + GRAVITY, "acceleration_z": np.zeros(50)}

    def parameters(channels, *, intercept):
        rows = VerticalMotion(intercept=intercept).regression(Signals(5.0, channels)).rows()
        return np.linalg.lstsq(rows.regressors, rows.response, rcond=None)[0]

    for channels in (about_hover, with_force):
        assert parameters(channels, intercept=False) == pytest.approx([0.3, 0.02])
    logged = parameters(whole | {"acceleration_z": acceleration}, intercept=True)
    assert logged == pytest.approx([0.3, 0.02, -GRAVITY])


def naive_shared(left, right, signals, first, rows):
    """C by its definition: a mean over the rows of gains times an autocovariance at the record's age."""
    result = np.zeros((len(left), len(right)))
    used = [k for k in range(first, signals.sample_count) if rows is None or rows[k - first]]
    longest = signals.offset + signals.sample_count

    @functools.cache
    def growth(name, lag):
        return signals.noise[name].autocovariance(lag, 0, longest)

    for i, item in enumerate(left):
        for j, other in enumerate(right):
            if not item.channel or item.channel != other.channel:
                continue
            total = 0.0
            for k in used:
                gains = item.gain * other.gain
                for column in (item, other):
                    if column.gain_channel:
                        gains *= signals.channel(column.gain_channel)[k]
                age = signals.offset + k - max(item.lag, other.lag)
                lag = abs(item.lag - other.lag)
                total += gains * growth(item.channel, lag)[age]
            result[i, j] = total / len(used)
    return result


@settings(max_examples=30)
@given(
    order=st.sampled_from([-0.5, -0.4, 0.0, 0.3]),
    offset=st.integers(0, 50),
    mask=st.lists(st.booleans(), min_size=9, max_size=20),
    seed=st.integers(0, 99),
)
def test_shared_noise_is_the_mean_over_the_rows_that_are_used(order, offset, mask, seed):
    noise = {
        "input": FractionalNoise(0.3, order),
        "velocity_z": WhiteNoise(0.2),
        "specific_force_z": WhiteNoise(0.0),
    }
    mask[-5:] = [True] * 5
    signals = make_signals(len(mask), seed, valid=mask, noise=noise, offset=offset)
    equation = Equation(
        Column("specific_force_z"),
        (
            (Parameter("a"), Column("velocity_z", gain=-1.0, gain_channel="cos_tilt")),
            (Parameter("b"), Column("input", 1, 2.0)),
            (Parameter("c"), Column("input", gain_channel="cos_tilt")),
            (Parameter("d"), Column("")),
        ),
    )
    instruments = (*lags("input", 0, 3), Column("velocity_z", gain_channel="cos_tilt"), Column(""))
    problem = SignalRegression(signals, equation, instruments)
    columns = (*problem.regressor_columns, equation.response)
    rows = problem.used
    wanted = naive_shared(instruments, columns, signals, 3, rows)
    np.testing.assert_allclose(problem.instrument_noise_covariance(), wanted, rtol=1e-9, atol=1e-14)
    regressor_noise_covariance = problem.regressor_noise_covariance()
    np.testing.assert_allclose(
        regressor_noise_covariance, naive_shared(columns, columns, signals, 3, rows), rtol=1e-9, atol=1e-14
    )
    np.testing.assert_allclose(regressor_noise_covariance, regressor_noise_covariance.T, rtol=1e-12)


def test_noise_is_never_assumed_to_be_zero():
    signals = make_signals(20, noise={"velocity_z": WhiteNoise(0.1)})
    problem = VerticalMotion().regression(signals, lags("input", 0, 2))
    with pytest.raises(
        MissingNoiseError, match=r"declared noise of channel 'input'.*received noise of velocity_z"
    ):
        problem.instrument_noise_covariance()
    assert problem.declared_noise() is None
    assert not problem.instruments_share_noise()
    # Strictly delayed instruments share nothing with u(k) when the noise is white, and with memory they do.
    for noise, shares in (
        (WhiteNoise(0.1), False),
        (FractionalNoise(0.1, -0.3), True),
        (WhiteNoise(0.0), False),
    ):
        declared = make_signals(20, noise={"input": noise})
        assert VerticalMotion().regression(declared, lags("input", 1, 2)).instruments_share_noise() is shares
    declared = make_signals(20, noise={"input": WhiteNoise(0.1)})
    assert VerticalMotion().regression(declared, lags("input", 0, 2)).instruments_share_noise()
