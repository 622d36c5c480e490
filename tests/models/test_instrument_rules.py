"""Instrument rules against filters that are written out, and flights of several vehicles together."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.errors import InstrumentError, MissingChannelError, TooFewSamplesError
from eivor.models.separable import DrivenSignals, LaggedInputs, LaggedReferences, NoInstruments
from eivor.motions.vertical.model import GRAVITY, VerticalMotion
from eivor.motions.vertical.regression import VerticalFlight, VerticalFlights
from eivor.signals.signals import Signals
from eivor.signals.thrust_map import Power

STEP_S = 0.01


def flight_signals(count: int = 800, seed: int = 0, **more: np.ndarray) -> Signals:
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


def test_several_rotors_enter_by_the_mean_of_their_mapped_states_times_the_tilt():
    rng = np.random.default_rng(2)
    rotors = {f"rotor_command_{i}": 100.0 + 10.0 * rng.standard_normal(400) for i in (1, 2, 3, 4)}
    signals = flight_signals(400, **rotors)
    flight = VerticalFlight(signals, "rotor_command", False, (slice(0, 400),))
    mapped_input = flight.mapped_input(VerticalMotion(Power(2.0)), 0.0, 0.0)
    wanted = 0.98 * np.mean([values**2 for values in rotors.values()], axis=0)
    np.testing.assert_allclose(mapped_input, wanted, rtol=1e-13)
    # The rotor is slow, not its thrust: the lag comes first.
    lagged = flight.mapped_input(VerticalMotion(Power(2.0)), 0.05, 0.0)
    separated = [
        VerticalFlight(signals, name, False, (slice(0, 400),)).mapped_input(
            VerticalMotion(Power(2.0)), 0.05, 0.0
        )
        for name in rotors
    ]
    np.testing.assert_allclose(lagged, np.mean(separated, axis=0), rtol=1e-12)


def test_rows_of_pooled_flights_are_those_of_each_without_its_means():
    signals, other = flight_signals(seed=3), flight_signals(seed=4)
    flights = (
        VerticalFlight(signals, "input", False, (slice(0, 300), slice(350, 800))),
        VerticalFlight(other, "input", False, (slice(100, 700),)),
    )
    problem = VerticalFlights(flights, VerticalMotion(), LaggedReferences(("reference_position_z",)))
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
    alone = VerticalFlights((flights[1],), VerticalMotion(), problem.rule).bins(AT)
    count = alone.layout.runs[0].count
    np.testing.assert_allclose(bins.regressors[-count:], alone.regressors, atol=1e-12)
    np.testing.assert_allclose(bins.instruments[-count:], alone.instruments, atol=1e-12)
    np.testing.assert_allclose(bins.responses[-count:], alone.responses, atol=1e-12)


def test_flights_that_cannot_share_a_problem_are_refused():
    runs = (slice(0, 800),)
    with pytest.raises(TooFewSamplesError, match="Expected at least one usable run of flight; received none"):
        VerticalFlights((VerticalFlight(flight_signals(), "input", False, ()),), VerticalMotion())

    class Uneven(LaggedInputs):
        def columns(self, driven):
            rising = driven.signals.channel("velocity_z")[0] > 0.0
            return np.zeros((driven.signals.sample_count, 1 + int(rising)))

    flights = [
        VerticalFlight(flight_signals(velocity_z=sign * np.ones(800)), "input", False, runs)
        for sign in (1.0, -1.0)
    ]
    with pytest.raises(InstrumentError, match="same instruments in every flight"):
        VerticalFlights(tuple(flights), VerticalMotion(), Uneven())


def test_measured_actuators_have_a_delay_of_either_sign_and_no_lag():
    flight = VerticalFlight(flight_signals(), "input", True, (slice(0, 800),))
    problem = VerticalFlights((flight,), VerticalMotion())
    np.testing.assert_array_equal(problem.lag.grid, [0.0])
    assert problem.delay.refined
    assert problem.delay.grid[0] < 0.0 < problem.delay.grid[-1]
    rows = [problem.rows({"actuator_lag": 0.0, "delay": delay}).regressors[:, 1] for delay in (0.02, -0.03)]
    step = round(0.05 * 100)
    between = slice(50, 700)
    moved = np.roll(rows[1], step)[between] - rows[0][between]
    np.testing.assert_allclose(moved - moved.mean(), 0.0, atol=1e-9)
