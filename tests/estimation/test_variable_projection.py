"""The search for lag and delay against one joint nonlinear least squares; intervals that know the lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy
import scipy.linalg
import scipy.optimize
from scipy import stats
from vertical_flight_signals import FRICTION, GAIN, LAG_S, STEP_S, Noise, flights, problem

import shape_checks
from eivor.errors import UsageError
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import identify, least_squares, reference_iv, total_least_squares
from eivor.estimation.moments import Instrumental
from eivor.estimation.weighting import TwoStage
from eivor.linalg import LeastSquares
from eivor.linalg.system import LinearSystem
from eivor.linalg.total_least_squares import AugmentedLeastSquares, TotalLeastSquares
from eivor.linalg.total_least_squares import LeastSquares as LeastSquares_objectives

TWO_STAGE = LinearMethod("two_stage", Instrumental(), LeastSquares(), equation_weighting=TwoStage())


def residual_at(flight, joint, delay_s=0.0):
    """Residual of the equation of motion in time, with the actuator written out sample by sample."""
    K, K_u, lag = joint
    command = flight.signals.channel("rotor_command_1")
    whole = round(delay_s / STEP_S)
    state, states = command[0], [command[0]]
    for k in range(1, command.size):
        received = command[max(k - 1 - whole, 0)]
        state = received + (state - received) * np.exp(-STEP_S / lag)
        states.append(state)
    run = flight.runs[0]
    terms = [flight.signals.channel(name)[run] for name in ("specific_force_z", "velocity_z")]
    terms.append(np.array(states)[run] ** 2)
    s, v, U = (term - term.mean() for term in terms)
    return s + K * v - K_u * U


def test_direct_search_is_joint_nonlinear_least_squares():
    (flight,) = flights(1, seconds=8.0, noise=Noise(), seed=1)
    fit = identify(problem(flight), least_squares())
    start = np.array([1.0, 30.0, 0.02])
    joint = scipy.optimize.least_squares(
        lambda x: residual_at(flight, x), start, x_scale=start, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    np.testing.assert_allclose(fit.values, joint.x, rtol=1e-4)
    np.testing.assert_allclose(fit.residuals, joint.fun, atol=1e-4)
    # The white part of the joint covariance is that of nonlinear least squares.
    variance = float(joint.fun @ joint.fun) / (joint.fun.size - 3)
    wanted = variance * np.linalg.inv(joint.jac.T @ joint.jac)
    np.testing.assert_allclose(fit.joint_covariance.part("classical").matrix, wanted, rtol=2e-3)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("method", [least_squares(), TWO_STAGE, reference_iv()], ids=lambda m: m.name)
def test_intervals_include_the_uncertainty_of_the_lag(method):
    (flight,) = flights(1, seconds=20.0, noise=Noise(), seed=3)
    searched = identify(problem(flight), method)
    fixed = identify(problem(flight, lags=np.array([searched.nuisances["actuator_lag"]])), method)
    assert "actuator_lag" not in fixed.names
    for number, name in enumerate(("viscous_friction", "input_gain")):
        assert fixed.parameters[name] == pytest.approx(searched.parameters[name], rel=1e-3)
        both = [fit.joint_covariance.part("classical").matrix[number, number] for fit in (searched, fixed)]
        assert both[1] < both[0]
    # The lag tells on the gain: an interval that took it for known would be much too narrow.
    assert both[1] < 0.9 * both[0]


def test_unknown_names_and_levels_are_refused():
    (flight,) = flights(1, seconds=8.0, noise=Noise(), seed=6)
    fit = identify(problem(flight), least_squares())
    with pytest.raises(UsageError, match=r"Expected a parameter out of viscous_friction, .*; received 'K'"):
        fit.interval("K")
    for level in (0.0, 1.0, 95.0):
        with pytest.raises(UsageError, match="Expected a confidence level between 0 and 1"):
            fit.interval("viscous_friction", level)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    "method", [least_squares(), total_least_squares(), TWO_STAGE, reference_iv()], ids=lambda m: m.name
)
@pytest.mark.parametrize("unit", [1e-4, 1e5])
def test_the_unit_of_the_command_changes_the_gain_only(method, unit):
    (flight,) = flights(1, seconds=12.0, noise=Noise(), seed=7)
    channels = dict(flight.signals.channels)
    channels["rotor_command_1"] = unit * channels["rotor_command_1"]
    scaled = replace(flight, signals=replace(flight.signals, channels=channels))
    plain, other = (identify(problem(f), method) for f in (flight, scaled))
    for name, power in (("viscous_friction", 0), ("actuator_lag", 0), ("input_gain", -2)):
        assert other.parameters[name] == pytest.approx(plain.parameters[name] * unit**power, rel=1e-5)
        ends = np.array(plain.interval(name)) * unit**power
        assert other.interval(name) == pytest.approx(tuple(ends), rel=1e-4)


RUNS = 100
TRUTH = np.array([FRICTION, GAIN, LAG_S])


@pytest.fixture(scope="module")
def spread():
    """Estimates of many calm flights with white noise, with their joint covariances."""
    with shape_checks.unchecked():
        return estimates_of_many()


def estimates_of_many():
    fits = [
        identify(problem(flight, lags=np.geomspace(0.02, 0.12, 4)), reference_iv())
        for flight in flights(RUNS, seconds=15.0, noise=Noise(), seed=9)
    ]
    return np.array([fit.values for fit in fits]), [fit.joint_covariance for fit in fits]


@pytest.mark.calibration
@pytest.mark.parametrize("number", range(3))
def test_intervals_cover(spread, number):
    values, covariances = spread
    direction = np.eye(3)[number]
    half = np.array([C.half_width(direction) for C in covariances])
    covered = int((np.abs(values[:, number] - TRUTH[number]) <= half).sum())
    # The wider of two intervals covers at least as often as either: only the lower bound is sharp.
    assert covered >= stats.binom.ppf(1e-4, RUNS, 0.95)
    robust = np.array(
        [
            stats.t(8).ppf(0.975) * np.sqrt(C.part("equal_weighted_cosines").matrix[number, number])
            for C in covariances
        ]
    )
    covered = int((np.abs(values[:, number] - TRUTH[number]) <= robust).sum())
    assert covered >= stats.binom.ppf(1e-4, RUNS, 0.92)


@pytest.mark.parametrize(
    ("solver", "equations"),
    [
        (LeastSquares_objectives(), 3),
        (LeastSquares_objectives(), 7),
        (AugmentedLeastSquares(), 7),
        (TotalLeastSquares(), 7),
    ],
)
def test_objectives_are_those_of_each_system(solver, equations):
    systems = np.random.default_rng(equations).normal(size=(5, equations, 4)) * [1.0, 1e3, 1e-3, 1.0]
    each = [solver.solve(LinearSystem(system[:, :-1], system[:, -1])).objective for system in systems]
    np.testing.assert_allclose(solver.objectives(systems), each, rtol=1e-9, atol=1e-20)
