"""What compensated equations weigh and score, and which instruments are refused or called weak."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import eivor as ev
from eivor.errors import InstrumentError
from eivor.inference.verdict import Status

ROWS, TRUTH = 400, np.array([0.7, -1.3])


def noisy_problem(*, instruments: int, shared_response: float = 0.3) -> tuple[ev.Regression, np.ndarray]:
    """Rows whose first instrument shares noise with the first regressor and with the response, and C, c.

    The noises are those that the covariance says: a common part of the three, and a part of the regressor.
    """
    rng = np.random.default_rng(12)
    moving = rng.standard_normal((ROWS, instruments)) + 0.5 * rng.standard_normal((ROWS, 1))
    exact = moving[:, :2] + 0.3 * moving[:, -1:]
    common = rng.standard_normal(ROWS)
    regressors = exact + 0.6 * np.outer(common, [1.0, 0.0])
    response = exact @ TRUTH + shared_response * common + 0.2 * rng.standard_normal(ROWS)
    psi = moving + np.outer(common, np.eye(instruments)[0])
    noise = np.zeros((instruments, 3))
    noise[0] = 0.6, 0.0, shared_response
    problem = ev.regression(
        response=response, regressors=regressors, instruments=psi, instrument_noise_covariance=noise
    )
    return problem, noise


def test_scores_have_what_the_noises_add_to_regressors_and_response():
    """With as many instruments as unknowns, C theta - c makes their sum vanish."""
    problem, noise = noisy_problem(instruments=2)
    fit = ev.identify(problem, ev.methods.generalized_iv())
    theta = np.array(list(fit.parameters.values()))
    residual = problem.response - problem.regressors @ theta
    sums = problem.instruments.T @ residual + ROWS * (noise[:, :2] @ theta - noise[:, 2])
    np.testing.assert_allclose(sums, 0.0, atol=1e-9 * ROWS)
    scores = fit.best.equation.scores
    np.testing.assert_allclose(scores.sum(axis=0), 0.0, atol=1e-9 * np.abs(scores).sum())


@pytest.mark.parametrize("bandwidth", [0, 3])
def test_two_steps_weigh_by_the_scores_without_their_mean(bandwidth):
    """The second step's weight is the Bartlett covariance of psi e + C theta - c at the first step."""
    problem, noise = noisy_problem(instruments=5)
    y, X, Z = problem.response, problem.regressors, problem.instruments
    A, b = Z.T @ X / ROWS - noise[:, :2], Z.T @ y / ROWS - noise[:, 2]

    def weighted(covariance):
        gain = A.T @ np.linalg.inv(covariance)
        return np.linalg.solve(gain @ A, gain @ b)

    first = weighted(Z.T @ Z / ROWS)
    scores = Z * (y - X @ first)[:, None] + noise[:, :2] @ first - noise[:, 2]
    covariance = scores.T @ scores
    for lag in range(1, bandwidth + 1):
        cross = scores[lag:].T @ scores[:-lag]
        covariance += (1.0 - lag / (bandwidth + 1.0)) * (cross + cross.T)
    method = ev.methods.generalized_iv(ev.methods.TwoStepRobust(bandwidth=bandwidth))
    fit = ev.identify(problem, method)
    np.testing.assert_allclose(list(fit.parameters.values()), weighted(covariance), rtol=1e-9)


def test_instruments_that_share_noise_are_refused_where_nothing_is_taken_off():
    problem, _ = noisy_problem(instruments=3)
    for name in ("extended_iv", "extended_iv_tls"):
        with pytest.raises(InstrumentError, match="whose measurement noise no regressor and no response"):
            ev.identify(problem, getattr(ev.methods, name)())


@pytest.mark.parametrize(("strength", "weak"), [(0.11, True), (0.22, False)])
def test_instruments_are_weak_below_a_first_stage_f_of_ten(strength, weak):
    """One instrument that moves the regressor so much that F is about 5, and about 20."""
    rng = np.random.default_rng(3)
    z, current, error = rng.standard_normal((3, ROWS))
    z -= z.mean()
    current -= z * (z @ current) / (z @ z)
    x = strength * z + current
    first_stage = strength**2 * (z @ z) / (current @ current / (ROWS - 1))
    assert 4.0 < first_stage < 6.0 if weak else 15.0 < first_stage < 25.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = ev.identify(
            ev.regression(response=x + error, regressors=x[:, None], instruments=z[:, None]),
            ev.methods.extended_iv(ev.methods.TwoStage()),
        )
    assert (fit.status is Status.WEAK) == weak
    if weak:
        assert f"first-stage F is {first_stage:.2g}" in fit.reasons[0].sentence
