"""Columns and the rows that an equation cuts from signals, against matrices built by hand."""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass, replace
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import gamma

import eivor as ev
from eivor.errors import (
    CovarianceError,
    DataError,
    InstrumentError,
    MissingChannelError,
    MissingNoiseError,
    NonFiniteError,
    ParameterError,
    ShapeError,
    TooFewSamplesError,
    UsageError,
)
from eivor.estimation.profile_sets import NuisanceProducts
from eivor.estimation.variable_projection import nodes_of
from eivor.estimation.weighting import SpectralWhitening
from eivor.lab.fractional_model import FilteredSignals, FractionalPart, Side
from eivor.models.lagged_runs import (
    ACTUATOR_LAG,
    AxisColumns,
    LaggedRuns,
    actuators,
    lag_and_delay,
    with_order,
)
from eivor.models.regression import AxisRows, Column, Equation, Parameter, SampleRows, lags, regression
from eivor.models.separable import LaggedInputs, LaggedReferences, NoInstruments, Nuisance, values_of
from eivor.models.signal_regression import SignalRegression, cross_fitted
from eivor.models.spectral import BinRows, SpectralRegression, SpectralRun
from eivor.motions.vertical.model import VerticalMotion
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.regression import mapped_input
from eivor.signals.filters import actuator_state, first_order_lag, shifted_by
from eivor.signals.noise import FractionalNoise, WhiteNoise
from eivor.signals.recording import GRAVITY
from eivor.signals.signals import Signals
from flights.flight_logs import prepared_of
from refusal_rows import calls, rows, table

NAMES = ("velocity_z", "specific_force_z", "input", "cos_tilt")


def make_signals(count, seed=0, valid=None, **more):
    rng = np.random.default_rng(seed)
    channels = {name: rng.standard_normal(count) for name in NAMES}
    if valid is not None:
        valid = np.asarray(valid, dtype=bool)
        for values in channels.values():
            values[~valid] = np.nan
    return Signals(5.0, channels, valid=valid, **more)


@given(
    mask=st.lists(st.booleans(), min_size=12, max_size=40),
    lag=st.integers(0, 6),
    gain=st.floats(-3.0, 3.0),
    seed=st.integers(0, 99),
)
def test_rows_are_those_of_a_loop_over_valid_histories(mask, lag, gain, seed):
    signals = make_signals(len(mask), seed, valid=mask)
    term = Column("input", lag, gain, "cos_tilt")
    terms = zip("abc", (Column("velocity_z", gain=-1.0), term, Column("")), strict=True)
    equation = Equation(Column("specific_force_z"), tuple((Parameter(n), column) for n, column in terms))
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
    without = VerticalMotion(intercept=False).regression(signals, lags("input", 1, 3)).rows()
    assert without.instruments.shape == (17, 3)
    assert VerticalMotion().regression(signals).rows().instruments.shape == (20, 0)


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
    noise = {"velocity_z": WhiteNoise(0.2), "specific_force_z": WhiteNoise(0.0)}
    noise["input"] = FractionalNoise(0.3, order)
    mask[-5:] = [True] * 5
    signals = make_signals(len(mask), seed, valid=mask, noise=noise, offset=offset)
    terms = (Column("velocity_z", gain=-1.0, gain_channel="cos_tilt"), Column("input", 1, 2.0))
    terms += (Column("input", gain_channel="cos_tilt"), Column(""))
    named = tuple((Parameter(name), column) for name, column in zip("abcd", terms, strict=True))
    equation = Equation(Column("specific_force_z"), named)
    instruments = (*lags("input", 0, 3), Column("velocity_z", gain_channel="cos_tilt"), Column(""))
    problem = SignalRegression(signals, equation, instruments)
    columns = (*problem.regressor_columns, equation.response)
    rows = problem.used
    of_regressors = problem.regressor_noise_covariance()
    for left, result in ((instruments, problem.instrument_noise_covariance()), (columns, of_regressors)):
        wanted = naive_shared(left, columns, signals, 3, rows)
        np.testing.assert_allclose(result, wanted, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(of_regressors, of_regressors.T, rtol=1e-12)


def test_noise_is_never_assumed_to_be_zero():
    signals = make_signals(20, noise={"velocity_z": WhiteNoise(0.1)})
    problem = VerticalMotion().regression(signals, lags("input", 0, 2))
    with pytest.raises(MissingNoiseError, match=r"noise of channel 'input'.*received noise of velocity_z"):
        problem.instrument_noise_covariance()
    assert problem.declared_noise() is None
    assert not problem.instruments_share_noise()
    # Strictly delayed instruments share nothing with u(k) when the noise is white, and with memory they do.
    for noise, first, shares in (
        (WhiteNoise(0.1), 1, False),
        (FractionalNoise(0.1, -0.3), 1, True),
        (WhiteNoise(0.0), 1, False),
        (WhiteNoise(0.1), 0, True),
    ):
        problem = VerticalMotion().regression(
            make_signals(20, noise={"input": noise}), lags("input", first, 2)
        )
        assert problem.instruments_share_noise() is shares


# Regressions of plain arrays: what they accept, and the sentences they refuse with.

RNG = np.random.default_rng(0)
PHI, Y = RNG.standard_normal((10, 2)), RNG.standard_normal(10)
ENDLESS_NOISE = np.full((2, 3), np.inf)


def test_noise_that_was_not_given_is_asked_for():
    bare = regression(response=Y, regressors=PHI, instruments=PHI)
    assert not bare.instruments_share_noise()
    zero = replace(bare, instrument_noise=np.zeros((2, 3)))
    assert not zero.instruments_share_noise()


COUNT = 1000
ALL = np.ones(COUNT, dtype=np.bool_)


def test_columns_that_say_the_same_are_one():
    column = RNG.standard_normal((COUNT, 1))
    exogenous = np.column_stack([column, 1e6 * column, np.zeros(COUNT)])
    np.testing.assert_allclose(cross_fitted(exogenous, 2.0 * column, ALL), 2.0 * column, atol=1e-4)


@pytest.mark.parametrize("columns", [0, 60])
def test_without_columns_or_with_too_few_samples_it_is_the_mean(columns):
    exogenous = RNG.standard_normal((100, columns))
    values = RNG.standard_normal((100, 1))
    fitted = cross_fitted(exogenous, values, np.ones(100, dtype=np.bool_))
    assert np.ptp(fitted) < 0.3
    assert fitted.mean() == pytest.approx(values.mean(), abs=0.3)
    if columns:
        np.testing.assert_allclose(fitted, values.mean())


STEP_S = 0.01


def flight_signals(count=800, seed=0, **more):
    rng = np.random.default_rng(seed)
    walk = np.cumsum(0.05 * rng.standard_normal((count, 3)), axis=0)
    channels = {
        "velocity_z": walk[:, 0],
        "specific_force_z": GRAVITY + walk[:, 1],
        "input": 0.5 + 0.01 * walk[:, 2],
        "cos_tilt": np.full(count, 0.98),
        "reference_position_z": np.cumsum(rng.standard_normal(count)) * 0.1,
        "reference_velocity_z": rng.standard_normal(count),
    }
    return Signals(1.0 / STEP_S, channels | more)


AT = {"actuator_lag": 0.05, "delay": 0.02}


def test_references_come_with_successive_lags_each_started_at_rest():
    signals = flight_signals()
    references = LaggedReferences(("reference_position_z", "reference_velocity_z"))
    columns = references.columns(signals, np.zeros(800))
    assert columns.shape == (800, 5 + 2)
    wanted = [signals.channel("reference_position_z")]
    for _ in range(4):
        before, state = wanted[-1], [wanted[-1][0]]
        for k in range(1, 800):
            state.append(before[k - 1] + (state[-1] - before[k - 1]) * np.exp(-STEP_S / 0.4))
        wanted.append(np.array(state))
    np.testing.assert_allclose(columns[:, :5], np.column_stack(wanted), atol=1e-10)
    np.testing.assert_array_equal(columns[:, 5], signals.channel("reference_velocity_z"))
    assert LaggedReferences(()).columns(signals, np.zeros(800)).shape == (800, 0)
    assert LaggedReferences(("a", "b")).label == "a, b"


def test_lagged_inputs_are_the_past_and_rest_before_it():
    mapped = np.random.default_rng(1).standard_normal(50)
    columns = LaggedInputs(1, 4).columns(flight_signals(50), mapped)
    for j, lag in enumerate(range(1, 5)):
        np.testing.assert_allclose(columns[lag:, j], mapped[:-lag], atol=1e-12)
        np.testing.assert_allclose(columns[:lag, j], mapped[0], atol=1e-12)
    short = LaggedInputs(1, 15).columns(flight_signals(6), mapped[:6])
    np.testing.assert_allclose(short[:, 10], mapped[0], atol=1e-12)
    assert NoInstruments().columns(flight_signals(6), mapped[:6]).shape == (6, 0)


def test_rows_of_pooled_flights_are_those_of_each_without_its_means():
    signals, other = flight_signals(seed=3), flight_signals(seed=4)
    flights = (
        prepared_of(signals, slice(0, 300), slice(350, 800)),
        prepared_of(other, slice(100, 700)),
    )
    rule = LaggedReferences(("reference_position_z",))
    problem = Vertical().problem(flights, rule)
    rows = problem.rows(AT)
    assert rows.response.size == 300 + 450 + 600
    np.testing.assert_array_equal(rows.layout.flight_of_row, np.repeat([0, 1], [750, 600]))
    start = 0
    for flight, run in ((each, run) for each in flights for run in each.runs):
        here = slice(start, start + run.stop - run.start)
        start = here.stop
        s = flight.signals.channel("specific_force_z")[run]
        v = flight.signals.channel("velocity_z")[run]
        U = mapped_input(flight, lag_s=0.05, delay_s=0.02)[run]
        np.testing.assert_allclose(rows.response[here], s - s.mean(), atol=1e-12)
        np.testing.assert_allclose(rows.regressors[here, 0], v.mean() - v, atol=1e-12)
        np.testing.assert_allclose(rows.regressors[here, 1], U - U.mean(), atol=1e-12)
    # In frequency: a run's block is what its own flight alone gives.
    bins = problem.bins(AT)
    alone = Vertical().problem((flights[1],), rule).bins(AT)
    count = alone.layout.runs[0].count
    for name in ("regressors", "instruments", "responses"):
        np.testing.assert_allclose(getattr(bins, name)[-count:], getattr(alone, name), atol=1e-12)


def test_measured_actuators_have_a_delay_of_either_sign_and_no_lag():
    flight = prepared_of(flight_signals(), slice(0, 800), measured=True)
    problem = Vertical().problem((flight,), NoInstruments())
    lag, delay = problem.nuisances
    np.testing.assert_array_equal(lag.grid, [0.0])
    assert delay.searched
    assert delay.grid[0] < 0.0 < delay.grid[-1]
    rows = [problem.rows({"actuator_lag": 0.0, "delay": delay}).regressors[:, 1] for delay in (0.02, -0.03)]
    step = round(0.05 * 100)
    between = slice(50, 700)
    moved = np.roll(rows[1], step)[between] - rows[0][between]
    np.testing.assert_allclose(moved - moved.mean(), 0.0, atol=1e-9)


# Lagged runs against what is written out: a rover in twenty lines, axes, candidates for a response.

RUN_STEP_S = 0.02
RUN_AT = {"actuator_lag": 0.1}
LAG = Nuisance(ACTUATOR_LAG, np.geomspace(0.02, 0.5, 12))


@dataclass(frozen=True)
class Throttle:
    """The column of a rover's throttle behind its lag."""

    throttle: np.ndarray

    def __call__(self, nuisance_values):
        lag_s = nuisance_values["actuator_lag"]
        return first_order_lag(self.throttle, step_s=RUN_STEP_S, lag_s=lag_s)[:, None]


def lagged(values, nuisance_values):
    return actuator_state(values, step_s=RUN_STEP_S, **actuators(nuisance_values))


def columns(seed, *, candidates=1, instruments=4, **more):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((600, 2 + candidates + instruments))
    return AxisColumns(
        RUN_STEP_S,
        more.pop("runs", (slice(0, 250), slice(300, 600))),
        values[:, :candidates],
        values[:, candidates : candidates + 1],
        Throttle(np.cumsum(values[:, -1]) * 0.1),
        values[:, candidates + 1 : -1],
        **more,
    )


PAIR = (Parameter("a"), Parameter("b"))


def test_rows_of_an_axis_are_cut_from_its_grid_and_lose_the_means_of_their_run():
    item = columns(1, candidates=2)
    rows = LaggedRuns((item,), PAIR, (LAG,)).rows(RUN_AT)
    moved, start = item.moving(RUN_AT)[:, 0], 0
    for run in item.runs:
        here = slice(start, start + run.stop - run.start)
        start = here.stop
        parts = (
            (rows.response[here], item.responses[run, 0]),
            (rows.regressors[here, 0], item.fixed[run, 0]),
            (rows.regressors[here, 1], moved[run]),
            (rows.instruments[here, 2], item.instruments[run, 2]),
        )
        for entry, wanted in parts:
            np.testing.assert_allclose(entry, wanted - wanted.mean(), atol=1e-13)
    assert start == rows.response.size


@pytest.mark.parametrize("stages", [(0.0,), (0.1, 0.249), ()])
def test_columns_between_lags_and_delays_are_those_that_a_filter_makes(stages):
    """Products of interpolated columns are those of columns at each lag, delay and second stage, or shift."""
    item, low = columns(3), 0.0 if stages else -0.013
    throttle = item.moving.throttle[:, None]
    late = lambda at: shifted_by(throttle, step_s=RUN_STEP_S, delay_s=-at["delay"])  # noqa: E731
    item = replace(item, moving=functools.partial(lagged, throttle) if stages else late, linear=True)
    lag, delay = lag_and_delay(np.geomspace(0.004, 0.15, 9), (low, 0.01, 0.03, 0.05))
    nuisances = with_order((lag if stages else lag.known_at(0.0), delay), 3 if any(stages) else 2)
    problem = LaggedRuns((item, replace(item, axis=1)), PAIR, nuisances)
    direct = LaggedRuns((replace(item, linear=False), replace(item, axis=1)), PAIR, nuisances)
    assert problem.interpolation is not None
    assert direct.interpolation is None
    grid = itertools.product(
        (0.004, 0.0123, 0.15) if stages else (0.0,), (low, 0.0071, 0.05), stages or (0.0,)
    )
    points = [{"actuator_lag": lag, "delay": delay, "second_stage": stage} for lag, delay, stage in grid]
    weights = SpectralWhitening().last_pass(problem, np.array([0.3, 1.0]), points[len(points) // 2])
    plain = replace(weights, problem=direct)
    np.testing.assert_allclose(weights.products(points), plain.products(points), rtol=1e-8, atol=1e-9)
    (made,) = NuisanceProducts.of_rows(weights, nodes_of(nuisances)).values()
    # the same as every column by itself
    for point, product, E, root in zip(
        points, plain.products(points), *made.evaluate(values_of(points)), strict=True
    ):
        rows = plain.rows(point)
        both = np.column_stack([rows.regressors, rows.response])
        np.testing.assert_allclose(product, rows.instruments.T @ both / rows.response.size, atol=1e-12)
        np.testing.assert_allclose(E, rows.instruments.T @ both, rtol=1e-8, atol=1e-7)
        power = both.T @ both
        np.testing.assert_allclose(root.T @ root, power, rtol=1e-8, atol=1e-8 * np.abs(power).max())


def test_instruments_of_an_axis_are_not_those_of_another():
    """Each axis has equations of its own; the parameters may be shared."""
    item, other = columns(1), columns(2, instruments=3, axis=4)
    problem = LaggedRuns((item, other), PAIR, (LAG,))
    assert problem.axes == (0, 4)
    alone = [LaggedRuns((each,), PAIR, (LAG,)) for each in (item, other)]
    for joined, parts in (
        (problem.rows(RUN_AT).instruments, [each.rows(RUN_AT).instruments for each in alone]),
        (problem.bins(RUN_AT).instruments, [each.bins(RUN_AT).instruments for each in alone]),
    ):
        first = parts[0].shape[0]
        np.testing.assert_allclose(joined[:first, :4], parts[0], rtol=1e-12)
        np.testing.assert_allclose(joined[first:, 4:], parts[1], rtol=1e-12)
        assert not joined[:first, 4:].any()
        assert not joined[first:, :4].any()
    layout = problem.bins(RUN_AT).layout
    np.testing.assert_array_equal(np.unique(layout.axis_of_row), [0, 4])
    assert layout.axis_of_row.shape == layout.flight_of_row.shape


def test_scores_of_one_time_are_added_over_the_axes():
    rng = np.random.default_rng(3)
    item, other = columns(1), columns(2, axis=1)
    late = columns(4, flight=1, axis=1, runs=(slice(10, 50),))
    rows = LaggedRuns((item, other, late), PAIR, (LAG,)).rows(RUN_AT)
    assert isinstance(rows.layout, AxisRows)
    test, e = rng.standard_normal((rows.response.size, 2)), rng.standard_normal(rows.response.size)
    scores = rows.layout.scores(test, e)
    each = test * e[:, None]
    wanted = np.concatenate([each[:550] + each[550:1100], each[1100:]])
    assert scores.shape == (550 + 40, 2)
    np.testing.assert_allclose(scores, wanted, atol=1e-13)


@pytest.mark.parametrize(("seconds", "degree"), [(14.9, 0), (15.0, 1), (40.0, 1)])
def test_long_runs_lose_a_line_in_time_and_short_ones_a_constant(seconds, degree):
    """Thrust of one command falls during a flight, for any weights and in rows of either kind."""
    count, rng = round(seconds / 0.05), np.random.default_rng(3)
    counted = rng.random(count) < 0.9
    time = np.arange(count) * 0.05
    moved = rng.standard_normal((count, 2))
    drifting = moved + np.column_stack([3.0 - 0.2 * time, 1e3 + time])
    for valid in (None, counted):
        run = SpectralRun(0, count, 0.05, (0.04, 5.0), counted=valid)
        left = run.spectrum(drifting) - run.spectrum(moved)
        assert (np.abs(left).max() < 1e-9) == bool(degree)
        here = AxisColumns(0.05, (slice(0, count),), drifting[:, :1], moved[:, :1], lambda _: moved[:, :0],
                           drifting[:, 1:], valid=valid)  # fmt: skip
        still = replace(here, responses=moved[:, :1], instruments=moved[:, 1:])
        rows, flat = (LaggedRuns((item,), PAIR[:1], ()).rows({}) for item in (here, still))
        assert np.allclose(rows.response, flat.response, atol=1e-9) == bool(degree)
        assert np.allclose(rows.instruments, flat.instruments, atol=1e-9) == bool(degree)


def test_band_without_a_bin_is_empty():
    run = SpectralRun(0, 20, 0.01, (0.04, 5.0))
    assert (run.count, run.spectrum(np.random.default_rng(0).standard_normal((20, 2))).shape) == (0, (0, 2))


def test_whitening_divides_every_column_and_blends_the_responses():
    run = SpectralRun(0, 400, 0.01, (0.04, 5.0))
    rng = np.random.default_rng(2)
    parts = rng.standard_normal((run.count, 4)) + 1j * rng.standard_normal((run.count, 4))
    bins = SpectralRegression(parts[:, :2], parts[:, 2:], parts[:, :0], PAIR, BinRows((run,)))
    blend, power = rng.uniform(0.0, 1.0, run.count), rng.uniform(0.5, 2.0, run.count)
    theta = np.array([0.7, -0.3])
    rows = bins.whitened(blend, power, np.empty((2 * run.count, 0)))
    item, other = bins.residuals(theta).T
    wanted = ((1.0 - blend) * item + blend * other) / np.sqrt(power)
    left = rows.response - rows.regressors @ theta
    np.testing.assert_allclose(left, np.concatenate([wanted.real, wanted.imag]), atol=1e-12)


# Fractional difference equations: free run, impulse and frequency response, stability, bad input.

ORDER = ev.UnknownOrder("order", 0.2, 1.2)
LAGGED = ev.FractionalDifferenceModel(
    (0.0, ORDER, ev.FractionalTerm(0.3, 1)), (0.0, ev.FractionalTerm(ORDER, 2))
)
LAGGED_TRUTH = {"output_coefficient_2": 4.0, "output_coefficient_3": -0.7, "order": 0.8}
LAGGED_TRUTH |= {"input_coefficient_1": 1.5, "input_coefficient_2": 0.4}


def relaxation(operator=None):
    return ev.FractionalDifferenceModel((0.0, 0.6), (0.0,), operator or ev.FractionalDifference())


def mittag_leffler_step(t):
    """1 - E_alpha(-t^alpha) of order 0.6."""
    x = -(mpmath.mpf(t) ** 0.6)
    return 1.0 - float(mpmath.nsum(lambda k: x**k / mpmath.gamma(0.6 * k + 1), [0, mpmath.inf]))


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


MODEL = ev.FractionalDifferenceModel
ENDLESS = {"output_coefficient_2": -1.0, "input_coefficient_1": 1.0}
GROWING = ENDLESS | {"output_coefficient_2": -3.0}
NINE = {"output": np.ones(9), "input": np.ones(9)}
HOLED, LATE = ev.Signals(1.0, NINE, valid=np.arange(9) > 1), ev.Signals(1.0, NINE, offset=4)
SECOND = ev.UnknownOrder("second", 1.1, 1.9)


def with_orders(output, input_order=0.0):
    """A model of known and unknown orders."""
    return lambda: MODEL(output, (input_order,))


def sharing(noise, column, name):
    """The noise that a column shares with a fractional part of a channel."""
    return lambda: of_noise(noise).shared_noise([column], [(FractionalPart(name, 0.5),)], 0)


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


def given(changes):
    regression(**({"response": Y, "regressors": PHI} | changes))


def short_record(count, valid, ask):
    """Too short whatever is asked first."""
    mask = {None: None, "first": np.arange(count) != 0, "none": np.zeros(count, dtype=bool)}[valid]
    signals = make_signals(count, valid=mask, noise={name: WhiteNoise(0.1) for name in NAMES})
    getattr(VerticalMotion(intercept=False).regression(signals, lags("input", 0, 5)), ask)()


def response_of(changes):
    u, y, r = np.random.default_rng(1).standard_normal((3, 4000))
    ev.frequency_response(**({"u": u, "y": y, "reference": r, "rate_hz": 100.0} | changes))


class Uneven(LaggedInputs):
    def columns(self, signals, _command):
        rising = signals.channel("velocity_z")[0] > 0.0
        return np.zeros((signals.sample_count, 1 + int(rising)))


def problem_of_runs(runs):
    rising, falling = (flight_signals(velocity_z=sign * np.ones(800)) for sign in (1.0, -1.0))
    Vertical().problem(tuple(prepared_of(signals, *runs) for signals in (rising, falling)), Uneven())


BARE = regression(response=Y, regressors=PHI, instruments=PHI)
OF_FLIGHTS = replace(regression(response=Y, regressors=PHI), layout=SampleRows(np.arange(10) // 5))
NO_RUN = "Expected at least one usable run of flight; received none"
FIRST_FIVE = {"response": Y[:5], "regressors": PHI[:5], "instruments": np.empty((5, 0))}
ASKED = ("rows", "instrument_noise_covariance", "regressor_noise_covariance", "instruments_share_noise")
LAGS = rows("lags", UsageError, lambda first, last: lags("input", first, last),
    *((first, last, "Expected") for first, last in ((2, 1), (-1, 3), (0, 99_999_999_999), (0, 10_000))),
)  # fmt: skip
SHORT_RECORDS = rows("short record", TooFewSamplesError, short_record,
    *itertools.product((0, 1, 3, 5), (None, "first", "none"), ASKED, ("Expected .*; received",)),
)  # fmt: skip
GIVEN = rows("arrays", None, given, *(
    (changes, error, f"Expected .*{text}|{text}.*; received")
    for changes, error, text in (
    ({"response": Y[:, None]}, ShapeError, r"response of shape \(rows,\)"),
    ({"regressors": PHI[None]}, ShapeError, "regressors with two dimensions"),
    ({"response": Y[:5]}, ShapeError, "equally many rows"),
    ({"instruments": PHI[:5]}, ShapeError, "equally many rows"),
    ({"names": ["K"]}, ShapeError, "one name for each of 2 regressors"),
    ({"response": Y[:1], "regressors": PHI[:1]}, TooFewSamplesError, "at least 2 rows"),
    ({"noise_covariance": np.eye(2)}, ShapeError, "a 3 x 3 covariance"),
    ({"noise_covariance": np.triu(np.ones((3, 3)))}, CovarianceError, "symmetric"),
    ({"noise_covariance": np.diag([1.0, -1.0, 1.0])}, CovarianceError, "positive semidefinite"),
    ({"instruments": PHI, "instrument_noise_covariance": np.eye(3)}, ShapeError, "a 2 x 3 covariance"),
    ({"instruments": PHI, "instrument_noise_covariance": ENDLESS_NOISE}, NonFiniteError, "noise covariance"),
)))  # fmt: skip
LAYOUTS = rows("layout", ShapeError, lambda problem, changes: replace(problem, **changes),
    *((BARE, {"layout": SampleRows(np.arange(n) // 5)},
        rf"a layout of 10 rows.*; received one of shape \({n},\)") for n in (0, 9, 11)),
    (OF_FLIGHTS, FIRST_FIVE, "a layout of 5 rows"),
)  # fmt: skip
NO_PROBLEM = rows("columns", None,
    lambda which, parameters: LaggedRuns(which, parameters, (LAG,)).rows(RUN_AT),
    ((columns(1, runs=()),), PAIR, TooFewSamplesError, "at least one usable run"),
    ((columns(1, runs=(slice(0, 40),), band_hz=(0.04, 0.25)),), PAIR, TooFewSamplesError,
        "2 frequencies or more between 0.04 and 0.25 Hz in the runs used; received none"),
    ((columns(1), columns(2, instruments=3, flight=1)), PAIR, InstrumentError, r"\[4, 3\] columns"),
    ((columns(1, candidates=3),), PAIR, ShapeError, "one or two candidates.*received 3"),
    ((columns(1),), (*PAIR, Parameter("c")), ShapeError,
        "a fixed or moving column for each of 3 parameters; received 1 and 1"),
)  # fmt: skip
RESPONSES = rows("frequency response", None, response_of,
    ({"y": np.ones(99)}, DataError, "arrays of the same lengths"),
    ({"u": np.ones(4000)}, DataError, "a u that changes"),
    ({"rate_hz": 0.0}, ParameterError, "rate_hz above zero"),
    ({"rate_hz": 2000.0}, TooFewSamplesError, "a run of 5 s or more"),
    ({"level": 1.0}, ParameterError, "a confidence level between 0 and 1"),
    ({"frequency_hz": [1.0, 60.0]}, ParameterError, "frequencies between 0 and 50 Hz"),
    ({"period_s": 0.0123}, ParameterError, "a whole number of samples"),
    ({"period_s": 30.0}, TooFewSamplesError, "a run of two periods"),
)  # fmt: skip
CALLS = calls("call", None,
    (lambda: ev.FractionalTerm(3.5), ParameterError, "an order between -3 and 3"),
    (lambda: ev.FractionalTerm(0.5, -1), UsageError, "a lag of zero or more samples"),
    (lambda: ev.UnknownOrder("a", 0.9, 0.2), ParameterError, "the lower end first"),
    (lambda: ev.UnknownOrder("", 0.1, 0.2), UsageError, "a name for an unknown order"),
    (with_orders((ORDER, 0.0)), ParameterError, "a known order of the first"),
    (with_orders((0.0, ORDER, SECOND)), ParameterError, "orders 0.2 to 1.2 and 1.1 to 1.9"),
    (with_orders((0.0, ORDER), replace(ORDER, high=0.3)), ParameterError, "one range of the order 'order'"),
    (with_orders((0.0, replace(ORDER, name="input_coefficient_1"))), ParameterError, "names of their own"),
    (lambda: LAGGED.simulate({"order": 0.5}, np.ones(9)), ParameterError, "none of output_coefficient_2"),
    (lambda: LAGGED.simulate(LAGGED_TRUTH, np.ones((9, 2))), ShapeError, "an input of shape"),
    (lambda: LAGGED.simulate(LAGGED_TRUTH, np.array([1.0, np.nan])), NonFiniteError, "a finite input"),
    (lambda: LAGGED.impulse_response(LAGGED_TRUTH, 0), ParameterError, "one sample or more"),
    (lambda: LAGGED.impulse_response(LAGGED_TRUTH, 5, rate_hz=0.0), ParameterError, "a positive rate"),
    (lambda: LAGGED.frequency_response(LAGGED_TRUTH, np.array([0.7])), ParameterError, "up to 0.5 Hz"),
    (lambda: LAGGED.frequency_response(LAGGED_TRUTH, np.array(0.1)), ShapeError, "frequencies of shape"),
    (lambda: LAGGED.problem(ev.Signals(1.0, {"output": np.ones(9)})), MissingChannelError, "'input'"),
    (lambda: LAGGED.problem(HOLED), DataError, "every sample of which is valid; received samples that are"),
    (lambda: FilteredSignals(LATE, ev.FractionalDifference()), DataError, "one that begins at sample 4"),
    (lambda: relaxation().simulate(GROWING, np.ones(9)), ParameterError, "received one with 1 growing mode"),
    (lambda: relaxation().impulse_response(ENDLESS, 9), ParameterError, "solved for the newest output"),
    (lambda: of_noise(ev.WhiteNoise(0.5)).noise_covariance(((FractionalPart("z", 0.5),),), 0),
        MissingNoiseError, "a declared noise of channel 'z'"),
    (sharing(WhiteNoise(0.5), Column("z", 1), "z"), MissingNoiseError, "a declared noise of channel 'z'"),
    (sharing(WhiteNoise(1.0), Column("x", gain_channel="z"), "x"), UsageError, "without a gain of another"),
    (BARE.regressor_noise_covariance, MissingNoiseError, "Expected the covariance .*; received none"),
    (BARE.instrument_noise_covariance, MissingNoiseError, "Expected the covariance .*; received none"),
    (lambda: LaggedReferences(("pilot_throttle",)).columns(flight_signals(), np.zeros(800)),
        MissingChannelError, "pilot_throttle"),
    (lambda: problem_of_runs(()), TooFewSamplesError, NO_RUN),
    (lambda: problem_of_runs((slice(0, 800),)), InstrumentError, "same instruments in every flight"),
)  # fmt: skip


test_refused = table(LAGS, SHORT_RECORDS, GIVEN, LAYOUTS, NO_PROBLEM, RESPONSES, CALLS)


def test_bins_of_a_run_with_gaps_are_fewer_independent_ones():
    rng, counted = np.random.default_rng(1), np.arange(6000) // 60 % 2 > 0
    run = SpectralRun(0, 6000, 0.01, (0.1, 20.0), counted=counted)
    pairs = rng.normal(size=(600, 2, 6000))
    spectra = [run.spectrum(pair.T) for pair in pairs]
    products = np.array([(z.conj() * e).real.sum() / np.linalg.norm(z) for z, e in (s.T for s in spectra)])
    each = np.mean([np.mean(np.abs(s[:, 1]) ** 2) for s in spectra]) / 2.0
    assert each / products.var() == pytest.approx(run.independent, rel=0.15)
    assert run.independent < 0.6
