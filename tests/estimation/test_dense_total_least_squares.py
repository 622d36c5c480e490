"""Methods solved by total least squares against their formulas with dense matrices."""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest
import scipy
import scipy.linalg

import eivor as ev
from eivor.errors import CollinearError, InstrumentError
from eivor.estimation import methods
from eivor.estimation.products import lags_without_gaps
from eivor.linalg import AugmentedLeastSquares
from eivor.linalg.system import COPIED_ROWS, PASSED_ROWS

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
    return np.array(
        [
            [
                0.0
                if item != other
                else sign * its * np.mean([covariance[item][k - lag, k - late] for k in rows])
                for other, late, its in right
            ]
            for item, lag, sign in left
        ]
    )


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

    def eigenvector(self):
        """Theta from the vector of that eigenvalue."""
        d = scipy.linalg.eigh(self.stacked.T @ self.stacked, self.S)[1][:, 0]
        return -d[:-1] / d[-1]

    def augmented(self):
        """Theta of (27) and (33) with all rows; for S = I only."""
        X, b, sigma = self.stacked[:, :-1], self.stacked[:, -1], np.sqrt(self.least)
        full = np.block([[sigma * np.eye(len(b)), X], [X.T, sigma * np.eye(2)]])
        return np.linalg.solve(full, np.append(b, np.zeros(2)))[len(b) :]


#: Of every method that total least squares solves: its first lag (None: no instruments), what is made of it.
FORMS = {
    "total_least_squares": (None, lambda signals: Dense(signals, None).shifted()),
    "extended_iv_tls": (1, lambda signals: Dense(signals, 1).shifted()),
    "generalized_iv_tls": (0, lambda signals: Dense(signals, 0).shifted()),
    "liml": (1, lambda signals: Dense(signals, 1, limited=True).shifted()),
    "generalized_liml": (0, lambda signals: Dense(signals, 0, limited=True).shifted()),
    "fuller": (1, lambda signals: with_fuller(Dense(signals, 1, limited=True))),
    "generalized_fuller": (0, lambda signals: with_fuller(Dense(signals, 0, limited=True))),
}


def with_fuller(dense):
    return dense.shifted(1.0 / dense.left_over)


def problem_of(signals, first):
    """The product's problem on the same rows."""
    lags = () if first is None else ev.lags("input", first, LAGS)
    return ev.VerticalMotion(intercept=False).regression(signals, lags)


def methods_by_name():
    made = {}
    for name in methods.__all__:
        maker = getattr(methods, name)
        if callable(maker) and name.islower() and name not in ("by_name", "regularised"):
            made[name] = maker()
    return made


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("name", FORMS)
def test_the_formula_as_it_stands(signals, name):
    first, wanted = FORMS[name]
    method, problem = methods_by_name()[name], problem_of(signals, first)
    theta = method.solve(problem).solution.theta
    np.testing.assert_allclose(theta, wanted(signals), rtol=EXACT)
    swapped = replace(method, solver=AugmentedLeastSquares()).solve(problem).solution.theta
    assert np.abs(swapped / theta - 1.0).max() > 1e6 * EXACT, "least squares in its place is not noticed"


@pytest.mark.parametrize(("name", "first"), [("extended_iv_tls", 1), ("generalized_iv_tls", 0)])
def test_the_augmented_systems_with_all_their_rows(signals, name, first):
    """(27) is (26), and (33) is (32); and both are the vector of the least singular value."""
    dense = Dense(signals, first)
    np.testing.assert_allclose(dense.augmented(), dense.shifted(), rtol=EXACT)
    np.testing.assert_allclose(dense.eigenvector(), dense.shifted(), rtol=EXACT)
    theta = methods_by_name()[name].solve(problem_of(signals, first)).solution.theta
    np.testing.assert_allclose(theta, dense.augmented(), rtol=EXACT)


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
            results = {
                key: [fit.with_covariance(item).std_error(p) for p in fit.names]
                for key, item in COVARIANCES.items()
            }
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


def problem(*, quiet: int) -> ev.Regression:
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
    made = problem(quiet=quiet)
    fit = ev.identify(made, ev.methods.extended_iv()).with_covariance(
        ev.covariances.HeteroskedasticityRobust()
    )
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
    signals = ev.Signals(
        rate_hz=5.0, channels={"velocity_z": v, "specific_force_z": u - 0.3 * v + noise, "input": 2.0 * u}
    )
    cut = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", *lags))
    method = ev.methods.extended_iv()
    fast = ev.identify(cut, method)
    assert lags_without_gaps(fast.problem)
    slow = ev.identify(cut.rows(), method)
    np.testing.assert_allclose(fast.covariance, slow.covariance, rtol=1e-9)
