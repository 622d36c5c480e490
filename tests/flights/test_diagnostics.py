"""Diagnostics of a flight: constancy, least squares beside the estimate, memory, leverage of runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import eivor as ev
from eivor.flights.result import FEWEST_RUNS, run_leverage
from eivor.inference.diagnostics.excitation import Swing
from eivor.report.flight import checks
from estimation.vertical_flight_signals import Noise, flights, problem

EXAMPLE = Path(ev.__file__).parent / "data" / "example_flight.parquet"
LAGS = np.geomspace(0.02, 0.12, 5)


@pytest.fixture(scope="module")
def example() -> ev.FlightEstimate:
    return ev.identify_flight(ev.read_log(str(EXAMPLE)))


@pytest.mark.thorough
def test_leverage_of_a_run_is_the_solution_without_it():
    made = problem(*flights(4, seconds=30.0, noise=Noise(gust=0.3)), lags=LAGS)
    fit = ev.identify(made, ev.methods.reference_iv())
    leverage = run_leverage(ev.diagnose(fit))
    assert leverage.shift.shape == (4, 3)
    equation, rows = fit.best.equation, fit.best.rows
    jacobian = np.column_stack([rows.regressors, fit.best.nuisance_columns])
    for flight in range(4):
        rest = rows.layout.flight_of_row != flight
        P, G, e = equation.test_functions[rest], jacobian[rest], equation.residual[rest]
        # the lag was searched for to a tolerance, so that the scores add up to zero only nearly
        np.testing.assert_allclose(leverage.shift[flight], np.linalg.solve(P.T @ G, P.T @ e), rtol=0.03)


@pytest.mark.thorough
def test_few_runs_are_cut_into_tenths():
    made = problem(*flights(FEWEST_RUNS - 1, seconds=30.0, noise=Noise()), lags=LAGS)
    leverage = run_leverage(ev.diagnose(ev.identify(made, ev.methods.reference_iv())))
    assert leverage.shift.shape == (10, 3)


@pytest.mark.calibration
def test_constancy_keeps_its_size_in_flights():
    """Flights in gusts: no more of them change than the level says."""
    runs = 12
    each = [problem(*flights(1, seconds=40.0, noise=Noise(gust=0.5), seed=s), lags=LAGS) for s in range(runs)]
    p_values = [ev.diagnose(ev.identify(item, ev.methods.reference_iv())).constancy.p_value for item in each]
    assert sum(p < 0.05 for p in p_values) <= stats.binom.ppf(1.0 - 1e-4, runs, 0.06)


@pytest.mark.thorough
def test_a_change_between_flights_is_told():
    """A command that is scaled from the second flight on: the gain per command is another one."""
    first, second = flights(2, seconds=40.0, noise=Noise())
    channels = dict(second.signals.channels)
    channels["rotor_command_1"] = 1.1 * channels["rotor_command_1"]
    changed = replace(second, signals=replace(second.signals, channels=channels))
    fit = ev.identify(problem(first, changed, lags=LAGS), ev.methods.reference_iv())
    diagnose = ev.diagnose(fit)
    assert diagnose.constancy.p_value <= 0.01
    assert diagnose.constancy.break_at == pytest.approx(0.5, abs=0.05)
    gain = fit.names.index("input_gain")
    assert diagnose.constancy.change[gain] / fit.parameters["input_gain"] == pytest.approx(
        1.0 / 1.21 - 1.0, abs=0.07
    )
    assert any("change during the record" in reason.sentence for reason in diagnose.reasons)


def test_numbers_of_the_example(example):
    numbers = example.diagnostics
    friction = example.quantities["viscous_friction"]
    # calm air and a faithful model: least squares agrees, nothing changes, nothing drifts
    assert numbers["least_squares_viscous_friction"] == pytest.approx(friction.value, abs=friction.std_error)
    assert numbers["constancy_p_value"] > 0.01
    assert 0.15 <= numbers["constancy_break"] <= 0.85
    assert abs(numbers["residual_memory"]) < 0.3
    assert abs(numbers["leverage_viscous_friction"]) < 1.5
    assert numbers["leverage_segments"] == 10.0
    assert 1.0 <= numbers["leverage_segment"] <= 10.0


def test_checks_are_said_in_words(example):
    sentence = dict(checks(example))
    assert list(sentence) == [
        "sensors",
        "instruments",
        "agreement",
        "constancy",
        "periods",
        "residual",
        "leverage",
        "least squares",
        "left out",
    ]
    assert "first-stage F" in sentence["instruments"]
    assert sentence["agreement"].startswith("the instruments agree")
    assert sentence["constancy"].startswith("the parameters stay the same")
    assert sentence["periods"].startswith("no periodic component in the residual (p ")
    assert sentence["least squares"] == "would give K 0.186 1/s"
    result = example.fit.checks
    index = example.names.index("viscous_friction")

    def moved(values: np.ndarray, by: float) -> np.ndarray:
        return np.where(np.arange(values.size) == index, by, values)

    worse = replace(
        result,
        agreement=replace(result.agreement, p_value=1e-9),
        constancy=replace(
            result.constancy, p_value=0.001, break_at=0.4, change=moved(result.constancy.change, 0.1)
        ),
        endogeneity=replace(
            result.endogeneity, p_value=0.001, difference=moved(result.endogeneity.difference, -0.3)
        ),
        leverage=replace(
            result.leverage,
            in_std_errors=np.vstack([moved(row, -3.0) for row in result.leverage.in_std_errors]),
        ),
        memory=replace(result.memory, memory=0.9),
        periodicity=replace(
            result.periodicity, parameters=(Swing("viscous_friction", "1/s", 6.0, 0.1, 1e-6),), left_over=()
        ),
    )
    sentence = dict(checks(replace(example, fit=replace(example.fit, checks=worse))))
    assert sentence["agreement"] == "the instruments disagree (p <= 0.001)"
    assert sentence["constancy"] == (
        "the parameters change (p <= 0.001), most likely 40% into the time used: K by +0.1 1/s"
    )
    assert sentence["periods"] == "K varies by ±0.1 1/s with a period of 6 s (p <= 0.001)"
    pushed = replace(
        worse,
        periodicity=replace(result.periodicity, left_over=(Swing("acceleration", "m/s²", 6.0, 0.3, 1e-6),)),
    )
    said_of_a_push = dict(checks(replace(example, fit=replace(example.fit, checks=pushed))))["periods"]
    assert said_of_a_push == (
        "what the model leaves over of the acceleration swings by ±0.3 m/s² with a period of 6 s "
        "(p <= 0.001), as by a wind or a supply that swings"
    )
    assert "standard errors off" in sentence["least squares"]
    assert sentence["residual"].endswith("(it drifts)")
    assert sentence["leverage"].endswith("-3.0 standard errors: inspect that part")


def test_nothing_is_checked_without_an_estimate(example):
    assert checks(replace(example, fit=None)) == ()


@pytest.mark.thorough
def test_a_direct_method_has_fewer_checks():
    identify_flight = ev.identify_flight(ev.read_log(str(EXAMPLE)), ev.FlightOptions(method="least_squares"))
    sentence = dict(checks(identify_flight))
    assert "instruments" not in sentence
    assert "least squares" not in sentence
    assert "constancy" in sentence
