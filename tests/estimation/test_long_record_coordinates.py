"""Coordinates in which the covariance of a long record is summed: some rows serve as well as all."""

from __future__ import annotations

import numpy as np
import pytest

import eivor as ev
from eivor.estimation import estimate
from eivor.estimation.products import lags_without_gaps
from eivor.linalg.system import COPIED_ROWS, PASSED_ROWS

ROWS = 4 * PASSED_ROWS


def problem(*, quiet: int) -> ev.Regression:
    """Two regressors with three instruments; over the first rows all of them are one signal."""
    rng = np.random.default_rng(3)
    Z = rng.standard_normal((ROWS, 3))
    Z[:quiet] = Z[:quiet, :1]
    X = Z @ np.array([[1.0, 0.2], [0.1, 1.5], [0.4, -0.3]]) + 0.1 * rng.standard_normal((ROWS, 2))
    X[:quiet] = Z[:quiet, :1]
    response = X @ [1.0, -2.0] + rng.standard_normal(ROWS)
    return ev.regression(response=response, regressors=X, instruments=Z)


@pytest.mark.parametrize(("quiet", "blocks"), [(0, 1), (PASSED_ROWS + 1, 2), (2 * PASSED_ROWS, 3)])
def test_covariances_are_those_of_all_rows(monkeypatch, quiet, blocks):
    made, used = problem(quiet=quiet), []
    monkeypatch.setattr(estimate, "ENOUGH_ROWS", ROWS + 1)
    whole = ev.identify(made, ev.methods.extended_iv()).covariance
    condition = estimate._condition
    monkeypatch.setattr(estimate, "ENOUGH_ROWS", 1)
    monkeypatch.setattr(estimate, "_condition", lambda root: used.append(root) or condition(root))
    some = ev.identify(made, ev.methods.extended_iv()).covariance
    np.testing.assert_allclose(some, whole, rtol=1e-10)
    # as many blocks were passed as tell the directions apart, and no more
    assert len(used) == blocks


@pytest.mark.parametrize("lags", [(0, 10), (2, 16)])
def test_filtered_lags_have_the_covariance_of_their_rows(lags):
    """Also by threads, and for filters longer than one call computes fast."""
    rng = np.random.default_rng(5)
    count = 9 * COPIED_ROWS + 100
    u, v = np.convolve(rng.standard_normal(count), [1.0, 0.7, 0.4], "same"), rng.standard_normal(count)
    v[3:] += u[:-3]
    noise = rng.standard_normal(count)
    signals = ev.Signals(
        rate_hz=5.0,
        channels={"velocity_z": v, "specific_force_z": u - 0.3 * v + noise, "input": 2.0 * u},
    )
    cut = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", *lags))
    method = ev.methods.extended_iv()
    fast = ev.identify(cut, method)
    assert lags_without_gaps(fast.best.problem)
    slow = ev.identify(cut.rows(), method)
    np.testing.assert_allclose(fast.covariance, slow.covariance, rtol=1e-9)
