"""Methods solved by total least squares against their formulas with dense matrices."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
import scipy
import scipy.linalg
import scipy.optimize
from scipy import stats
from scipy.signal import lfilter

import eivor as ev
import shape_checks
from eivor.errors import CollinearError, InstrumentError
from eivor.estimation import methods, unknown_noise
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import identify, least_squares, reference_iv, total_least_squares
from eivor.estimation.moments import Instrumental, lags_without_gaps
from eivor.estimation.unknown_noise import EquationChoice, SharedMoments, UnknownNoise, long_memory_covariance
from eivor.estimation.weighting import TwoStage
from eivor.lab.scenario_files import shipped_scenario
from eivor.linalg.system import COPIED_ROWS, PASSED_ROWS, LinearSystem
from eivor.linalg.total_least_squares import AugmentedLeastSquares, LeastSquares, TotalLeastSquares
from eivor.models.signal_regression import shared_noise
from flights.flight_logs import FRICTION, GAIN, LAG_S, STEP_S, Noise, flights, problem

ROWS, LAGS = 90, 4
NOISE = {
    "velocity_z": ev.FractionalNoise(std=0.15, order=-0.4),
    "specific_force_z": ev.FractionalNoise(std=0.2, order=-0.5),
    "input": ev.WhiteNoise(std=0.25),
}
EXACT = 1e-10


@pytest.fixture(scope="module")
def signals():
    """A short record with so much noise that least squares is far from total least squares."""
    rng = np.random.default_rng(11)
    drive = np.convolve(rng.standard_normal(ROWS + 2), [0.6, 1.0, 0.6], mode="valid")
    velocity = np.zeros(ROWS)
    for k in range(1, ROWS):
        velocity[k] = 0.8 * velocity[k - 1] + 0.5 * drive[k - 1]
    channels = {"velocity_z": velocity, "specific_force_z": 1.2 * drive - 0.7 * velocity, "input": drive}
    for name, noise in NOISE.items():
        channels[name] = channels[name] + fractional(noise) @ rng.standard_normal(ROWS)
    return ev.Signals(rate_hz=5.0, channels=channels, noise=NOISE)


def fractional(noise):
    """Matrix that makes the noise out of white: std a_(k - m), a_j = a_(j-1) (j - 1 - alpha) / j."""
    order = getattr(noise, "order", 0.0)
    a = [1.0]
    for j in range(1, ROWS):
        a.append(a[-1] * (j - 1.0 - order) / j)
    return noise.std * np.array([[a[k - m] if m <= k else 0.0 for m in range(ROWS)] for k in range(ROWS)])


def columns(signals, tags, rows):
    """Rows of columns (channel, lag, sign)."""
    return np.array([[sign * signals.channels[name][k - lag] for name, lag, sign in tags] for k in rows])


def shared(left, right, rows):
    """Mean over the rows of the covariance of two sets of columns, out of dense ROWS x ROWS covariances."""
    covariance = {name: (root := fractional(noise)) @ root.T for name, noise in NOISE.items()}
    result = np.zeros((len(left), len(right)))
    for i, (item, lag, sign) in enumerate(left):
        for j, (other, late, its) in enumerate(right):
            if item == other:
                result[i, j] = sign * its * np.mean([covariance[item][k - lag, k - late] for k in rows])
    return result


REGRESSORS = [("velocity_z", 0, -1.0), ("input", 0, 1.0)]
RESPONSE = [("specific_force_z", 0, 1.0)]


def instruments(first):
    return [("input", lag, 1.0) for lag in range(first, LAGS + 1)]


class Dense:
    """X, b of (23) or (29) as means, and S of their columns' errors."""

    def __init__(self, signals, first, *, limited=False):
        right = REGRESSORS + RESPONSE
        rows = range(0 if first is None else LAGS, ROWS)  # from the largest lag on
        both = columns(signals, right, rows)
        if first is None:  # (13): the rows themselves
            self.stacked, self.S = both, shared(right, right, rows)
            return
        psi = columns(signals, instruments(first), rows)
        cross = psi.T @ both / len(both)
        self.stacked = cross - shared(instruments(first), right, rows)
        self.S = np.eye(3)
        if limited:
            weight = np.linalg.inv(psi.T @ psi / len(both))
            self.S = both.T @ both / len(both) - cross.T @ weight @ cross
            self.stacked = scipy.linalg.sqrtm(weight).real @ self.stacked
        self.left_over = len(both) - len(instruments(first))

    @property
    def least(self):
        """Sigma^2, the least generalized eigenvalue of [X b]'[X b] and S: a column may be without error."""
        return 1.0 / scipy.linalg.eigh(self.S, self.stacked.T @ self.stacked, eigvals_only=True)[-1]

    def shifted(self, taken_off=0.0):
        """(X'X - (sigma^2 - taken_off) S) theta = X'b - (sigma^2 - taken_off) s, (15), (26) and (32)."""
        G = self.stacked.T @ self.stacked - (self.least - taken_off) * self.S
        return np.linalg.solve(G[:-1, :-1], G[:-1, -1])

    @property
    def with_fuller(self):
        return self.shifted(1.0 / self.left_over)


#: Of every method that total least squares solves: its first lag (None: no instruments), what is made of it.
FORMS = {
    "total_least_squares": (None, lambda signals: Dense(signals, None).shifted()),
    "extended_iv_tls": (1, lambda signals: Dense(signals, 1).shifted()),
    "generalized_iv_tls": (0, lambda signals: Dense(signals, 0).shifted()),
    "liml": (1, lambda signals: Dense(signals, 1, limited=True).shifted()),
    "generalized_liml": (0, lambda signals: Dense(signals, 0, limited=True).shifted()),
    "fuller": (1, lambda signals: Dense(signals, 1, limited=True).with_fuller),
    "generalized_fuller": (0, lambda signals: Dense(signals, 0, limited=True).with_fuller),
}


def problem_of(signals, first):
    """The product's problem on the same rows."""
    lags = () if first is None else ev.lags("input", first, LAGS)
    return ev.VerticalMotion(intercept=False).regression(signals, lags)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("name", FORMS)
def test_the_formula_as_it_stands(signals, name):
    first, wanted = FORMS[name]
    method, problem = getattr(methods, name)(), problem_of(signals, first)
    theta = method.solve(problem).solution.theta
    np.testing.assert_allclose(theta, wanted(signals), rtol=EXACT)
    swapped = replace(method, solver=AugmentedLeastSquares()).solve(problem).solution.theta
    assert np.abs(swapped / theta - 1.0).max() > 1e6 * EXACT, "least squares in its place is not noticed"


NEAR_ROWS = 200
DISTANCES = [3.0 * 10.0**-k for k in range(1, 17)]
ROUNDING = np.finfo(float).eps
#: Standard errors lose a few roundings for each unit of the condition number.
ALLOWED = 100.0 * ROUNDING
COVARIANCES = {"classical": ev.covariances.Classical(), "robust": ev.covariances.HeteroskedasticityRobust()}
#: The formula itself cancels: it has the fourth power of the condition in it, twice.
DIGITS = 200


def data(distance):
    x, u, w, e = np.random.default_rng(5).standard_normal((4, NEAR_ROWS))
    regressors = np.column_stack([x, x + distance * u])
    return regressors, np.column_stack([x + 0.3 * w, u - 0.2 * w, w + x]), x + 2.0 * u + 0.1 * e


def exact(regressors, instruments, response, weighting):
    """Standard errors of the formula M^-1 V M^-T in many digits."""
    with mpmath.workdps(DIGITS):
        G, Z, y = (mpmath.matrix(a.tolist()) for a in (regressors, instruments, response))
        A = Z.T * G / NEAR_ROWS
        current = Z.T * Z / NEAR_ROWS
        W = mpmath.eye(Z.cols) if weighting is None else current**-1
        if weighting == "robust":
            theta = mpmath.lu_solve(A.T * W * A, A.T * W * (Z.T * y) / NEAR_ROWS)
            scores = times(Z, y - G * theta)
            W = (scores.T * scores / NEAR_ROWS) ** -1
        M = A.T * W * A
        theta = mpmath.lu_solve(M, A.T * W * (Z.T * y) / NEAR_ROWS)
        e, P = y - G * theta, Z * W * A
        variance = (e.T * e)[0] / (NEAR_ROWS - 2)
        scores = times(P, e)
        results = {}
        for name, meat in (("classical", variance * (P.T * P)), ("robust", scores.T * scores)):
            covariance = M**-1 * meat * (M**-1).T / NEAR_ROWS**2
            results[name] = [float(mpmath.sqrt(covariance[i, i])) for i in range(2)]
    return results


def condition(equations):
    singular = np.linalg.svd(equations / np.linalg.norm(equations, axis=0), compute_uv=False)
    return singular[0] / max(singular[1], ROUNDING * singular[0])


def times(rows, column):
    return mpmath.matrix([[rows[t, j] * column[t] for j in range(rows.cols)] for t in range(rows.rows)])


METHODS = {
    "least_squares": (ev.methods.least_squares(), "regressors", None),
    "total_least_squares": (ev.methods.total_least_squares(), "regressors", None),
    "bias_compensated_least_squares": (ev.methods.bias_compensated_least_squares(), "regressors", None),
    "regressors as instruments": (ev.methods.extended_iv(), "regressors", None),
    "extended_iv": (ev.methods.extended_iv(), "instruments", None),
    "generalized_iv": (ev.methods.generalized_iv(), "instruments", None),
    "two_stage": (ev.methods.extended_iv(ev.methods.TwoStage()), "instruments", "two_stage"),
    "two_step": (ev.methods.extended_iv(ev.methods.TwoStepRobust(bandwidth=0)), "instruments", "robust"),
}


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.thorough
@pytest.mark.parametrize("name", METHODS)
def test_standard_errors_are_right_or_the_problem_is_refused(name):
    """In total least squares and the compensated methods all noise is declared to be the response's."""
    method, which, weighting = METHODS[name]
    refused = []
    for distance in DISTANCES:
        regressors, others, response = data(distance)
        instruments = regressors if which == "regressors" else others
        problem = ev.regression(
            response=response,
            regressors=regressors,
            instruments=instruments,
            noise_covariance=np.diag([0.0, 0.0, 1.0]),
            instrument_noise_covariance=np.zeros((instruments.shape[1], 3)),
        )
        try:
            fit = ev.identify(problem, method)
            each = {key: fit.with_covariance(item).std_errors for key, item in COVARIANCES.items()}
            results = {key: list(errors.values()) for key, errors in each.items()}
        except (CollinearError, InstrumentError):
            refused.append(distance)
            continue
        # Once it was too near, anything nearer is.
        assert not refused
        moments = method.assembler.moment_equations
        rounding = ALLOWED * condition(instruments.T @ regressors if moments else regressors)
        for key, errors in exact(regressors, instruments, response, weighting).items():
            np.testing.assert_allclose(results[key], errors, rtol=rounding, err_msg=f"{key} {distance}")
    squared = which == "regressors" and method.assembler.moment_equations
    # A double has sixteen digits, and three are to be left.
    assert len(refused) == len([d for d in DISTANCES if d < (1e-6 if squared else 1e-12)])


LONG_ROWS = 4 * PASSED_ROWS


def with_quiet_rows(*, quiet: int) -> ev.Regression:
    """Two regressors with three instruments; over the first rows all of them are one signal."""
    rng = np.random.default_rng(3)
    Z = rng.standard_normal((LONG_ROWS, 3))
    Z[:quiet] = Z[:quiet, :1]
    X = Z @ np.array([[1.0, 0.2], [0.1, 1.5], [0.4, -0.3]]) + 0.1 * rng.standard_normal((LONG_ROWS, 2))
    X[:quiet] = Z[:quiet, :1]
    response = X @ [1.0, -2.0] + rng.standard_normal(LONG_ROWS)
    return ev.regression(response=response, regressors=X, instruments=Z)


@pytest.mark.parametrize("quiet", [0, PASSED_ROWS + 1, 2 * PASSED_ROWS])
def test_covariances_are_those_of_all_rows(quiet):
    made, robust = with_quiet_rows(quiet=quiet), ev.covariances.HeteroskedasticityRobust()
    fit = ev.identify(made, ev.methods.extended_iv()).with_covariance(robust)
    A = made.instruments.T @ made.regressors
    scores = (made.instruments @ A) * fit.residuals[:, None]
    expected = np.linalg.inv(A.T @ A) @ (scores.T @ scores) @ np.linalg.inv(A.T @ A)
    np.testing.assert_allclose(fit.covariance, expected, rtol=1e-9)


@pytest.mark.parametrize("lags", [(0, 10), (2, 16)])
def test_filtered_lags_have_the_covariance_of_their_rows(lags):
    """Also by threads, and for filters longer than one call computes fast."""
    rng = np.random.default_rng(5)
    count = 9 * COPIED_ROWS + 100
    u, v = np.convolve(rng.standard_normal(count), [1.0, 0.7, 0.4], "same"), rng.standard_normal(count)
    v[3:] += u[:-3]
    noise = rng.standard_normal(count)
    channels = {"velocity_z": v, "specific_force_z": u - 0.3 * v + noise, "input": 2.0 * u}
    signals = ev.Signals(rate_hz=5.0, channels=channels)
    cut = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", *lags))
    method = ev.methods.extended_iv()
    fast = ev.identify(cut, method)
    assert lags_without_gaps(fast.problem)
    slow = ev.identify(cut.rows(), method)
    np.testing.assert_allclose(fast.covariance, slow.covariance, rtol=1e-9)


# Estimates of fractional difference equations: exact without noise, settled, and covered by intervals.

ORDER = ev.UnknownOrder("order", 0.3, 1.1)
MODEL = ev.FractionalDifferenceModel((0.0, ORDER), (0.0,))
TRUTH = {"output_coefficient_2": 8.0, "input_coefficient_1": 1.0, "order": 0.7}
REACH = (0, 1, 2, 4, 8, 16, 32)
FRACTIONAL_LAGS = tuple(ev.Column("input", lag) for lag in REACH)
REFERENCE = tuple(ev.Column("reference", lag) for lag in REACH)
FRACTIONAL_METHODS = {
    "least_squares": (methods.least_squares(), ()),
    "total_least_squares": (methods.total_least_squares(), ()),
    "bias_compensated_least_squares": (methods.bias_compensated_least_squares(), ()),
    "extended_iv": (methods.extended_iv(), REFERENCE),
    "extended_iv_tls": (methods.extended_iv_tls(), REFERENCE),
    "generalized_iv": (methods.generalized_iv(), FRACTIONAL_LAGS),
    "generalized_iv_two_stage": (methods.generalized_iv(methods.TwoStage()), FRACTIONAL_LAGS),
    "generalized_iv_tls": (methods.generalized_iv_tls(), FRACTIONAL_LAGS),
}


def record(count=1500, noise_ratio=0.01):
    """Record of the equation, driven by an input with memory, with both its signals noisy."""
    rng = np.random.default_rng(0)
    driven = np.convolve(rng.standard_normal(count), 0.8 ** np.arange(60))[:count]
    true = {"output": MODEL.simulate(TRUTH, driven), "input": driven}
    noise = {name: ev.WhiteNoise(noise_ratio * series.std()) for name, series in true.items()}
    measured = {name: series + noise[name].sample(count, rng) for name, series in true.items()}
    return ev.Signals(1.0, measured | {"reference": driven}, noise=noise)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("name", FRACTIONAL_METHODS)
def test_without_noise_every_method_finds_the_truth(name, known):
    """With an order that is known the problem is linear."""
    method, instruments = FRACTIONAL_METHODS[name]
    model = ev.FractionalDifferenceModel((0.0, 0.7), (0.0,)) if known else MODEL
    truth = {parameter: value for parameter, value in TRUTH.items() if not (known and parameter == "order")}
    result = ev.identify(model.problem(record(noise_ratio=0.0), instruments), method)
    assert result.parameters == pytest.approx(truth, rel=1e-9 if known else 1e-8)


#: A cell's ohmic resistance and ZARC element, in derivatives by time.
CELL = ev.FractionalDifferenceModel((0.0, ORDER), (0.0, ORDER), ev.FractionalDerivative())
CELL_TRUTH = {"output_coefficient_2": 2.0**0.8, "input_coefficient_1": 0.03}
CELL_TRUTH |= {"input_coefficient_2": 0.01 * 2.0**0.8, "order": 0.8}
STEPS_BETWEEN = 40


def of_a_cell(seed, correlation, rate_hz=20.0, count=2000):
    """Estimate of a cell whose current is linear between samples, computed at a fortieth of the step."""
    rng = np.random.default_rng(seed)
    current = lfilter([1.0], [1.0, -correlation], rng.standard_normal(count))
    current -= current[0]
    between = np.interp(np.arange((count - 1) * STEPS_BETWEEN + 1) / STEPS_BETWEEN, np.arange(count), current)
    voltage = CELL.simulate(CELL_TRUTH, between, rate_hz=STEPS_BETWEEN * rate_hz)[::STEPS_BETWEEN]
    true = {"output": voltage, "input": current}
    noise = {name: ev.WhiteNoise(0.01 * series.std()) for name, series in true.items()}
    measured = {name: series + noise[name].sample(count, rng) for name, series in true.items()}
    problem = CELL.problem(
        ev.Signals(rate_hz, measured, noise=noise),
        divided_by_output_at=CELL_TRUTH | {"output_coefficient_2": 1.5, "order": 0.7},
    )
    return ev.identify(problem, methods.bias_compensated_least_squares())


@pytest.mark.parametrize(
    ("correlation", "status"),
    [(0.98, "identified"), (0.5, "weak"), (0.0, "weak")],
    ids=["slow", "rough", "white"],
)
def test_errors_of_discretisation_are_in_the_intervals(correlation, status):
    result = of_a_cell(0, correlation)
    bare, missed = replace(result, discretisation=None), 0
    for name, value in CELL_TRUTH.items():
        low, high = result.interval(name)
        assert low < value < high
        low, high = bare.interval(name)
        missed += not low < value < high
    assert missed
    assert result.status.value == status
    assert ("Sample faster" in result.summary()) is (status == "weak")


@pytest.mark.thorough
@pytest.mark.calibration
@pytest.mark.parametrize("correlation", [0.98, 0.8, 0.0])
def test_intervals_of_cells_hold_the_truth(correlation):
    results = [of_a_cell(seed, correlation) for seed in range(30)]
    for name, value in CELL_TRUTH.items():
        intervals = [result.interval(name) for result in results]
        assert sum(low < value < high for low, high in intervals) >= 26


def test_the_estimate_is_one_like_all_others():
    problem = MODEL.problem(record(noise_ratio=0.05), FRACTIONAL_LAGS)
    result = ev.identify(problem, methods.generalized_iv())
    for name, value in TRUTH.items():
        low, high = result.interval(name, 0.999)
        assert low < value < high
    assert result.covariance.shape == (3, 3)
    time_constant = ev.derived(result, lambda item: item["output_coefficient_2"] ** (1.0 / item["order"]))
    assert time_constant.interval[0] < 8.0 ** (1.0 / 0.7) < time_constant.interval[1]
    assert "order" in result.summary()
    assert result.with_covariance(ev.covariances.Classical()).std_error("order") > 0.0


INSTRUMENTS = ev.lags("input", 0, 10)
UNKNOWN_MODEL = ev.VerticalMotion(intercept=False)


def record_unknown(name="rich-high", order=0.0, samples=3000, seed=1, **changes):
    scenario = replace(shipped_scenario(name), samples=samples, **changes)
    noise = ev.FractionalNoise(1.0, order) if order else ev.WhiteNoise(1.0)
    scenario = replace(scenario, noise={**scenario.noise, "velocity_z": noise})
    return ev.simulate(scenario, np.random.default_rng(seed)).signals


def undeclared(signals, instruments=INSTRUMENTS):
    return UNKNOWN_MODEL.regression(replace(signals, noise={}), instruments)


def test_a_white_input_is_refused_with_the_reason():
    signals = record_unknown("white", samples=2000)
    estimate = ev.identify(undeclared(signals), ev.methods.generalized_iv_unknown_noise())
    assert estimate.status.value == "refused"
    assert "does not distinguish the input gain from the noises" in estimate.summary()


def test_noise_of_any_order_adds_what_its_autocovariance_says():
    problem = undeclared(record_unknown(samples=400))
    psi = EquationChoice.GENERALIZED.columns(problem, ("velocity_z",))
    shared = SharedMoments(UNKNOWN_MODEL.regression(problem.signals, psi), ())
    order = -0.317
    noise = {"velocity_z": ev.FractionalNoise(1.0, order), "input": ev.WhiteNoise(0.0)}
    signals = replace(problem.signals, noise=noise)
    right = (*problem.regressor_columns, problem.equation.response)
    expected = shared_noise(psi, right[:2], signals, shared.problem.first)
    unit = shared.unit(UnknownNoise("velocity_z", fractional=True), order)
    np.testing.assert_allclose(unit[:, :2], expected, rtol=1e-6, atol=1e-9)


def test_errors_of_noises_add_up_those_of_all_lags():
    """Of independent white series the sum of products has the product of their powers as its variance."""
    rng = np.random.default_rng(4)
    count = 4000
    influence, error = rng.standard_normal((count, 2)), 3.0 * rng.standard_normal(count)
    covariance = long_memory_covariance(influence, error)
    np.testing.assert_allclose(np.diag(covariance) / count, [9.0, 9.0], rtol=0.2)
    assert abs(covariance[0, 1]) < 0.2 * covariance[0, 0]
    # of an instrument that is the error before and after, twice the powers, and as much again for the answers
    around = np.roll(error, 1) + np.roll(error, -1)
    assert long_memory_covariance(around[:, None], error)[0, 0] / count > 1.5 * 2.0 * 81.0


def weights_of(psi, error):
    """Soderstrom's covariance of sums of instruments times errors, over the root of their number."""
    rows = SimpleNamespace(instruments=psi, response=error, regressors=np.zeros((error.size, 0)))
    fit = SimpleNamespace(cross=np.zeros((psi.shape[1], 1)), rows=rows, _count=error.size)
    return unknown_noise._MomentSearch._covariance(fit, np.zeros(0))


def test_weights_of_unknown_noise_allow_for_memory_and_for_answers():
    rng = np.random.default_rng(8)
    white = rng.standard_normal((2, 20_000))
    slow = lfilter([0.6], [1.0, -0.8], white)  # of variance one
    # of independent series with memory the sum of products of their correlations, 1.64 / 0.36
    assert 3.0 < weights_of(slow[:1].T, slow[1])[0, 0] < 5.0
    # of an instrument that is the error before and after: two, and as much again for the answers
    error = white[0]
    around = np.roll(error, 1) + np.roll(error, -1)
    assert weights_of(around[:, None], error)[0, 0] == pytest.approx(4.0, rel=0.1)


# The search for lag and delay against one joint nonlinear least squares; intervals that know the lag.

TWO_STAGE = LinearMethod("two_stage", Instrumental(), LeastSquares(), equation_weighting=TwoStage())


def residual_at(flight, joint):
    """Residual of the equation of motion in time, with the actuator written out sample by sample."""
    K, K_u, lag = joint
    command = flight.signals.channel("rotor_command_1")
    states = [command[0]]
    for received in command[:-1]:
        states.append(received + (states[-1] - received) * np.exp(-STEP_S / lag))
    run = flight.runs[0]
    terms = [flight.signals.channel(name)[run] for name in ("specific_force_z", "velocity_z")]
    terms.append(np.array(states)[run] ** 2)
    s, v, U = (term - term.mean() for term in terms)
    return s + K * v - K_u * U


def test_direct_search_is_joint_nonlinear_least_squares():
    (flight,) = flights(1, seconds=8.0, noise=Noise(), seed=1)
    fit = identify(problem(flight), least_squares())
    start, exact = np.array([1.0, 30.0, 0.02]), dict.fromkeys(("xtol", "ftol", "gtol"), 1e-14)
    joint = scipy.optimize.least_squares(lambda x: residual_at(flight, x), start, x_scale=start, **exact)
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
PROJECTED_TRUTH = np.array([FRICTION, GAIN, LAG_S])


@pytest.fixture(scope="module")
def spread():
    """Estimates of many calm flights with white noise, with their joint covariances."""
    with shape_checks.unchecked():
        made, lags = flights(RUNS, seconds=15.0, noise=Noise(), seed=9), np.geomspace(0.02, 0.12, 4)
        fits = [identify(problem(flight, lags=lags), reference_iv()) for flight in made]
    return np.array([fit.values for fit in fits]), [fit.joint_covariance for fit in fits]


@pytest.mark.calibration
@pytest.mark.parametrize("number", range(3))
def test_intervals_cover(spread, number):
    values, covariances = spread
    away, direction = np.abs(values - PROJECTED_TRUTH)[:, number], np.eye(3)[number]
    half = [C.half_width(direction) for C in covariances]
    # The wider of two intervals covers at least as often as either: only the lower bound is sharp.
    assert (away <= half).sum() >= stats.binom.ppf(1e-4, RUNS, 0.95)
    variances = [C.part("equal_weighted_cosines").matrix[number, number] for C in covariances]
    robust = stats.t(8).ppf(0.975) * np.sqrt(variances)
    assert (away <= robust).sum() >= stats.binom.ppf(1e-4, RUNS, 0.92)


@pytest.mark.parametrize(
    ("solver", "equations"),
    [(LeastSquares(), 3), (LeastSquares(), 7), (AugmentedLeastSquares(), 7), (TotalLeastSquares(), 7)],
)
def test_objectives_are_those_of_each_system(solver, equations):
    systems = np.random.default_rng(equations).normal(size=(5, equations, 4)) * [1.0, 1e3, 1e-3, 1.0]
    each = [solver.solve(LinearSystem(system[:, :-1], system[:, -1])).objective for system in systems]
    np.testing.assert_allclose(solver.objectives(systems), each, rtol=1e-9, atol=1e-20)
