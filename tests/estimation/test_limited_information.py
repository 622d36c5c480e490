"""LIML and Fuller's modification: total least squares of two-stage equations, against the k-class."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

import eivor as ev
from eivor.errors import NoUniqueSolutionError, UsageError
from eivor.linalg import Fuller

linearmodels = pytest.importorskip("linearmodels")


def weakly_instrumented(seed, rows=300):
    """An endogenous regressor, one that is its own instrument, a constant, and four instruments."""
    rng = np.random.default_rng(seed)
    Z = rng.standard_normal((rows, 4))
    standard_normal, shared = rng.standard_normal(rows), rng.standard_normal(rows)
    moved = Z @ [0.3, 0.2, 0.1, 0.1] + 0.4 * standard_normal + shared
    y = 0.8 * moved - 0.5 * standard_normal + 2.0 + 0.7 * shared + rng.standard_normal(rows)
    regressors = np.column_stack([moved, standard_normal, np.ones(rows)])
    return y, regressors, np.column_stack([standard_normal, np.ones(rows), Z])


def k_class(y, X, Z, strength):
    """Projections as dense matrices; k from a generalized eigenvalue problem of SciPy's."""

    def annihilator(W):
        return np.eye(len(y)) - W @ np.linalg.solve(W.T @ W, W.T)

    M = annihilator(Z)
    endogenous = np.column_stack([y, X[:, 0]])
    k = scipy.linalg.eigvalsh(
        endogenous.T @ annihilator(X[:, 1:]) @ endogenous, endogenous.T @ M @ endogenous
    )[0]
    k -= strength / (len(y) - Z.shape[1])
    inner = X.T @ (np.eye(len(y)) - k * M)
    return np.linalg.solve(inner @ X, inner @ y)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("strength", [0.0, 1.0, 4.0])
def test_the_k_class(seed, strength):
    y, X, Z = weakly_instrumented(seed)
    problem = ev.regression(response=y, regressors=X, instruments=Z)
    wanted = k_class(y, X, Z, strength)
    two_stage = ev.identify(problem, ev.methods.extended_iv(ev.methods.TwoStage()))
    result = ev.identify(problem, ev.methods.fuller(strength))
    np.testing.assert_allclose(list(result.parameters.values()), wanted, rtol=1e-9)
    assert abs(result.parameters["theta_1"] - two_stage.parameters["theta_1"]) > 1e-3
    peer = linearmodels.IVLIML(y, X[:, 1:], X[:, :1], Z[:, 2:], fuller=strength).fit()
    np.testing.assert_allclose(peer.params.to_numpy()[[2, 0, 1]], wanted, rtol=1e-8)
    if strength == 0.0:
        liml = ev.identify(problem, ev.methods.liml())
        np.testing.assert_allclose(list(liml.parameters.values()), wanted, rtol=1e-9)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_the_compensated_k_class():
    """(A'A - (k - 1) S) theta = A'b - (k - 1) s of two-stage equations without what noises share."""
    y, X, Z = weakly_instrumented(4)
    C = np.zeros((6, 4))
    C[0, 1], C[2, 0] = 0.2, 0.1
    problem = ev.regression(response=y, regressors=X, instruments=Z, instrument_noise_covariance=C)
    both, rows = np.column_stack([X, y]), len(y)
    weight = np.linalg.inv(Z.T @ Z / rows)
    cross = Z.T @ both / rows
    S = both.T @ both / rows - cross.T @ weight @ cross
    G = (cross - C).T @ weight @ (cross - C)
    S[1:3], S[:, 1:3] = 0.0, 0.0  # its own instrument, and the constant
    largest = scipy.linalg.eigvals(S, G).real.max()  # of the inverse, since S is singular
    for strength, method in ((0.0, ev.methods.generalized_liml()), (4.0, ev.methods.generalized_fuller(4.0))):
        shift = 1.0 / largest - strength / (rows - 6)
        wanted = np.linalg.solve(G[:-1, :-1] - shift * S[:-1, :-1], G[:-1, -1] - shift * S[:-1, -1])
        result = ev.identify(problem, method)
        np.testing.assert_allclose(list(result.parameters.values()), wanted, rtol=1e-9)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_fuller_repairs_what_weak_instruments_do_to_limited_information():
    """LIML has no moments: a single record may lie anywhere. Fuller's estimates stay where the truth is."""
    results = {"liml": [], "fuller": []}
    for seed in range(40):
        y, X, Z = weakly_instrumented([5, seed], rows=40)
        problem = ev.regression(response=y, regressors=X, instruments=np.column_stack([Z[:, :2], Z[:, 3:]]))
        for name, method in (("liml", ev.methods.liml()), ("fuller", ev.methods.fuller(4.0))):
            results[name].append(ev.identify(problem, method).parameters["theta_1"] - 0.8)
    rmse = {name: float(np.sqrt(np.mean(np.square(errors)))) for name, errors in results.items()}
    assert rmse["fuller"] < 0.5 * rmse["liml"]


def test_what_limited_information_cannot_use_is_refused():
    rng = np.random.default_rng(6)
    X = rng.standard_normal((20, 2))
    problem = ev.regression(response=X @ [1.0, 2.0] + rng.standard_normal(20), regressors=X, instruments=X)
    with pytest.raises(UsageError, match="errors' covariance was estimated"):
        ev.identify(problem, replace(ev.methods.extended_iv(), solver=Fuller()))
    exact = ev.regression(response=X @ [1.0, 2.0], regressors=X, instruments=rng.standard_normal((20, 3)))
    with pytest.raises(NoUniqueSolutionError, match="a response that is a combination of regressors"):
        ev.identify(exact, ev.methods.liml())
    with pytest.raises(UsageError, match="strength between 0 and"):
        ev.methods.fuller(-1.0)
