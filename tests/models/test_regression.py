"""Regressions of plain arrays: what they accept, and the sentences they refuse with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.errors import (
    CovarianceError,
    InstrumentError,
    MissingChannelError,
    MissingNoiseError,
    NonFiniteError,
    ShapeError,
    TooFewSamplesError,
)
from eivor.models.regression import SampleRows, regression
from eivor.models.separable import DrivenSignals, LaggedInputs, LaggedReferences, NoInstruments
from eivor.models.signal_regression import cross_fitted
from eivor.motions.vertical.model import GRAVITY, VerticalMotion
from eivor.motions.vertical.regression import VerticalFlight, vertical_problem
from eivor.signals.signals import Signals

RNG = np.random.default_rng(0)
PHI, Y = RNG.standard_normal((10, 2)), RNG.standard_normal(10)


@pytest.mark.parametrize("count", [0, 9, 11])
def test_a_layout_of_another_length_is_no_single_flight(count):
    """Rows of two flights would be clustered as one."""
    made = regression(response=Y, regressors=PHI)
    flights = np.arange(count) // 5
    with pytest.raises(ShapeError, match=rf"a layout of 10 rows.*; received one of shape \({count},\)"):
        replace(made, layout=SampleRows(flights))
    kept = replace(made, layout=SampleRows(np.arange(10) // 5))
    np.testing.assert_array_equal(kept.layout.flight_of_row, [0] * 5 + [1] * 5)
    with pytest.raises(ShapeError, match="a layout of 5 rows"):
        replace(kept, response=Y[:5], regressors=PHI[:5], instruments=np.empty((5, 0)))


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"response": Y[:, None]}, ShapeError, r"response of shape \(rows,\)"),
        ({"regressors": Y}, ShapeError, "regressors with two dimensions"),
        ({"response": Y[:5]}, ShapeError, "equally many rows"),
        ({"names": ["K"]}, ShapeError, "one name for each of 2 regressors"),
        ({"response": Y[:1], "regressors": PHI[:1]}, TooFewSamplesError, "at least 2 rows"),
        ({"noise_covariance": np.eye(2)}, ShapeError, "a 3 x 3 covariance"),
        ({"noise_covariance": np.triu(np.ones((3, 3)))}, CovarianceError, "symmetric"),
        ({"noise_covariance": np.diag([1.0, -1.0, 1.0])}, CovarianceError, "positive semidefinite"),
        ({"instruments": PHI, "instrument_noise_covariance": np.eye(3)}, ShapeError, "a 2 x 3 covariance"),
        (
            {"instruments": PHI, "instrument_noise_covariance": np.full((2, 3), np.inf)},
            NonFiniteError,
            "instrument noise covariance",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_the_reason(given, error, said):
    with pytest.raises(error, match=f"Expected .*{said}|{said}.*; received"):
        regression(**({"response": Y, "regressors": PHI} | given))


def test_noise_that_was_not_given_is_asked_for():
    bare = regression(response=Y, regressors=PHI, instruments=PHI)
    for ask in (bare.regressor_noise_covariance, bare.instrument_noise_covariance):
        with pytest.raises(MissingNoiseError, match=r"Expected the covariance .*; received none"):
            ask()
    assert not bare.instruments_share_noise()
    zero = regression(
        response=Y, regressors=PHI, instruments=PHI, instrument_noise_covariance=np.zeros((2, 3))
    )
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
    columns = LaggedReferences(("reference_position_z", "reference_velocity_z")).columns(
        DrivenSignals(signals, np.zeros(800))
    )
    assert columns.shape == (800, 5 + 2)
    wanted = [signals.channel("reference_position_z")]
    for _ in range(4):
        before, state = wanted[-1], [wanted[-1][0]]
        for k in range(1, 800):
            state.append(before[k - 1] + (state[-1] - before[k - 1]) * np.exp(-STEP_S / 0.4))
        wanted.append(np.array(state))
    np.testing.assert_allclose(columns[:, :5], np.column_stack(wanted), atol=1e-10)
    np.testing.assert_array_equal(columns[:, 5], signals.channel("reference_velocity_z"))
    assert LaggedReferences(()).columns(DrivenSignals(signals, np.zeros(800))).shape == (800, 0)
    assert LaggedReferences(("a", "b")).label == "a, b"
    with pytest.raises(MissingChannelError, match="pilot_throttle"):
        LaggedReferences(("pilot_throttle",)).columns(DrivenSignals(signals, np.zeros(800)))


def test_lagged_inputs_are_the_past_and_rest_before_it():
    mapped = np.random.default_rng(1).standard_normal(50)
    columns = LaggedInputs(1, 4).columns(DrivenSignals(flight_signals(50), mapped))
    for j, lag in enumerate(range(1, 5)):
        np.testing.assert_allclose(columns[lag:, j], mapped[:-lag], atol=1e-12)
        np.testing.assert_allclose(columns[:lag, j], mapped[0], atol=1e-12)
    short = LaggedInputs(1, 15).columns(DrivenSignals(flight_signals(6), mapped[:6]))
    np.testing.assert_allclose(short[:, 10], mapped[0], atol=1e-12)
    assert NoInstruments().columns(DrivenSignals(flight_signals(6), mapped[:6])).shape == (6, 0)


def test_rows_of_pooled_flights_are_those_of_each_without_its_means():
    signals, other = flight_signals(seed=3), flight_signals(seed=4)
    flights = (
        VerticalFlight(signals, "input", False, (slice(0, 300), slice(350, 800))),
        VerticalFlight(other, "input", False, (slice(100, 700),)),
    )
    problem = vertical_problem(flights, VerticalMotion(), LaggedReferences(("reference_position_z",)))
    rows = problem.rows(AT)
    assert rows.response.size == 300 + 450 + 600
    np.testing.assert_array_equal(rows.layout.flight_of_row, np.repeat([0, 1], [750, 600]))
    start = 0
    for flight, run in (
        (flights[0], slice(0, 300)),
        (flights[0], slice(350, 800)),
        (flights[1], slice(100, 700)),
    ):
        here = slice(start, start + run.stop - run.start)
        start = here.stop
        s = flight.signals.channel("specific_force_z")[run]
        v = flight.signals.channel("velocity_z")[run]
        U = flight.mapped_input(VerticalMotion(), 0.05, 0.02)[run]
        np.testing.assert_allclose(rows.response[here], s - s.mean(), atol=1e-12)
        np.testing.assert_allclose(rows.regressors[here, 0], v.mean() - v, atol=1e-12)
        np.testing.assert_allclose(rows.regressors[here, 1], U - U.mean(), atol=1e-12)
    # In frequency: a run's block is what its own flight alone gives.
    bins = problem.bins(AT)
    alone = vertical_problem((flights[1],), VerticalMotion(), problem.rule).bins(AT)
    count = alone.layout.runs[0].count
    np.testing.assert_allclose(bins.regressors[-count:], alone.regressors, atol=1e-12)
    np.testing.assert_allclose(bins.instruments[-count:], alone.instruments, atol=1e-12)
    np.testing.assert_allclose(bins.responses[-count:], alone.responses, atol=1e-12)


def test_flights_that_cannot_share_a_problem_are_refused():
    runs = (slice(0, 800),)
    with pytest.raises(TooFewSamplesError, match="Expected at least one usable run of flight; received none"):
        vertical_problem((VerticalFlight(flight_signals(), "input", False, ()),), VerticalMotion())

    class Uneven(LaggedInputs):
        def columns(self, driven):
            rising = driven.signals.channel("velocity_z")[0] > 0.0
            return np.zeros((driven.signals.sample_count, 1 + int(rising)))

    flights = [
        VerticalFlight(flight_signals(velocity_z=sign * np.ones(800)), "input", False, runs)
        for sign in (1.0, -1.0)
    ]
    with pytest.raises(InstrumentError, match="same instruments in every flight"):
        vertical_problem(tuple(flights), VerticalMotion(), Uneven())


def test_measured_actuators_have_a_delay_of_either_sign_and_no_lag():
    flight = VerticalFlight(flight_signals(), "input", True, (slice(0, 800),))
    problem = vertical_problem((flight,), VerticalMotion())
    np.testing.assert_array_equal(problem.lag.grid, [0.0])
    assert problem.delay.searched
    assert problem.delay.grid[0] < 0.0 < problem.delay.grid[-1]
    rows = [problem.rows({"actuator_lag": 0.0, "delay": delay}).regressors[:, 1] for delay in (0.02, -0.03)]
    step = round(0.05 * 100)
    between = slice(50, 700)
    moved = np.roll(rows[1], step)[between] - rows[0][between]
    np.testing.assert_allclose(moved - moved.mean(), 0.0, atol=1e-9)
