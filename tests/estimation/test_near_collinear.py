"""Regressors that are nearly one: standard errors against 200-digit arithmetic, or a refusal."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

import eivor as ev
from eivor.errors import CollinearError, InstrumentError

ROWS = 200
DISTANCES = [3.0 * 10.0**-k for k in range(1, 17)]
ROUNDING = np.finfo(float).eps
#: Standard errors lose a few roundings for each unit of the condition number.
ALLOWED = 100.0 * ROUNDING
COVARIANCES = {
    "classical": ev.covariances.Classical(),
    "robust": ev.covariances.HeteroskedasticityRobust(),
}
#: The formula itself cancels: it has the fourth power of the condition in it, twice.
DIGITS = 200
pytestmark = pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")


def data(distance):
    x, u, w, e = np.random.default_rng(5).standard_normal((4, ROWS))
    regressors = np.column_stack([x, x + distance * u])
    return regressors, np.column_stack([x + 0.3 * w, u - 0.2 * w, w + x]), x + 2.0 * u + 0.1 * e


def exact(regressors, instruments, response, weighting):
    """Standard errors of the formula M^-1 V M^-T in many digits."""
    with mpmath.workdps(DIGITS):
        G, Z, y = (mpmath.matrix(a.tolist()) for a in (regressors, instruments, response))
        A = Z.T * G / ROWS
        current = Z.T * Z / ROWS
        W = mpmath.eye(Z.cols) if weighting is None else current**-1
        if weighting == "robust":
            theta = mpmath.lu_solve(A.T * W * A, A.T * W * (Z.T * y) / ROWS)
            scores = times(Z, y - G * theta)
            W = (scores.T * scores / ROWS) ** -1
        M = A.T * W * A
        theta = mpmath.lu_solve(M, A.T * W * (Z.T * y) / ROWS)
        e, P = y - G * theta, Z * W * A
        variance = (e.T * e)[0] / (ROWS - 2)
        scores = times(P, e)
        results = {}
        for name, meat in (("classical", variance * (P.T * P)), ("robust", scores.T * scores)):
            covariance = M**-1 * meat * (M**-1).T / ROWS**2
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


def test_the_standard_errors_of_a_distance_of_a_millionth_of_a_millionth():
    """They were 0, of estimates as large as 2e12."""
    regressors, _, response = data(5e-12)
    fit = ev.identify(ev.regression(response=response, regressors=regressors), ev.methods.least_squares())
    error = fit.with_covariance(ev.covariances.Classical()).std_error("theta_2")
    assert error == pytest.approx(0.1 / (5e-12 * np.sqrt(ROWS)), rel=0.2)
    low, high = fit.interval("theta_2")
    assert low < 2.0 / 5e-12 < high
