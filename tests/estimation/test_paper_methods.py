"""The seven methods of the paper's table: recovery, equivalences, invariances, and the errata of (29)."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

import eivor as ev
from inference import instrument_data as data
from reference import constants as truth

UNIT_FREE = (
    *("least_squares", "total_least_squares", "bias_compensated_least_squares"),
    *("extended_iv", "generalized_iv"),
)
SEVEN = (*UNIT_FREE, "extended_iv_tls", "generalized_iv_tls")
K, K_U, STEP, COUNT = 0.293, 0.021, 0.2, 2000
MOTION = ev.VerticalMotion(intercept=False)


def method_of(name):
    return getattr(ev.methods, name)()


def lags_of(name, order=10):
    return ev.lags("input", 0 if name.startswith("generalized") else 1, order)


def motion(rng, count=COUNT, *, white_input=False):
    """Velocity, specific force and input of the paper's vehicle, its input held between samples."""
    w = rng.standard_normal(count + 2)
    t = STEP * np.arange(count)
    u = w[2:] if white_input else 0.7 * w[1:-1] + 0.49 * w[:-2] + np.sin(0.1 * t**1.1)
    decay = np.exp(-K * STEP)
    v = lfilter([0.0, K_U / K * (1.0 - decay)], [1.0, -decay], u)
    return {"velocity_z": v, "specific_force_z": K_U * u - K * v, "input": u}


def noisy(channels, stds, rng):
    noise = {name: ev.WhiteNoise(std=stds.get(name, 0.0)) for name in channels}
    measured = {name: x + noise[name].std * rng.standard_normal(x.size) for name, x in channels.items()}
    return ev.Signals(rate_hz=1.0 / STEP, channels=measured, noise=noise)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("name", SEVEN)
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), friction=st.floats(0.1, 2.0), gain=st.floats(0.01, 10.0))
def test_recovery_without_noise(name, seed, friction, gain):
    rng = np.random.default_rng(seed)
    u, v = rng.standard_normal((2, 300)).cumsum(axis=1)
    channels = {"velocity_z": v, "input": u, "specific_force_z": gain * u - friction * v}
    fit = ev.identify(MOTION.regression(noisy(channels, {}, rng), lags_of(name)), method_of(name))
    tolerance = max(1e-9, 1e-12 * fit.condition)
    assert fit.parameters["viscous_friction"] == pytest.approx(friction, rel=tolerance)
    assert fit.parameters["input_gain"] == pytest.approx(gain, rel=tolerance)


@cache
def of_units(name, scale):
    """Friction and gain of a record whose input and its noise are in other units."""
    rng = np.random.default_rng(2)
    stds = {"velocity_z": 0.005, "input": 0.1, "specific_force_z": 0.005}
    signals = noisy(motion(rng, 500), stds, rng)
    channels = {**signals.channels, "input": scale * signals.channels["input"]}
    noise = {**signals.noise, "input": ev.WhiteNoise(std=scale * 0.1)}
    weighting = (ev.methods.TwoStage(),) if name.endswith("_iv") else ()
    problem = MOTION.regression(replace(signals, channels=channels, noise=noise), lags_of(name))
    return ev.identify(problem, getattr(ev.methods, name)(*weighting)).values


@pytest.mark.parametrize("name", UNIT_FREE)
@pytest.mark.parametrize("exponent", range(-6, 7))
def test_invariance_under_a_change_of_units(name, exponent):
    """The paper's unweighted TLS forms do not have this."""
    scale = 10.0**exponent
    np.testing.assert_allclose(of_units(name, scale) * [1.0, scale], of_units(name, 1.0), rtol=1e-7)


def sums_over_rows(signals, name, order=5):
    """X and b of (23) or (29): sums over all rows, as printed, with N in the row of lag 0."""
    velocity, drive, response = (signals.channels[n] for n in ("velocity_z", "input", "specific_force_z"))
    generalized = name.startswith("generalized")
    rows, delays = slice(order, None), range(0 if generalized else 1, order + 1)
    Psi = np.column_stack([drive[order - lag : drive.size - lag] for lag in delays])
    Phi = np.column_stack([-velocity[rows], drive[rows]])
    H = np.zeros((Psi.shape[1], 2))
    H[0, 1] = 1.0 if generalized else 0.0
    return Psi.T @ Phi - len(Phi) * signals.noise["input"].variance * H, Psi.T @ response[rows]


def augmented(X, b, upper, lower):
    """Theta of [[upper E_p, X], [X', lower E_2]] [eps; theta] = [b; 0], all p + 2 of it."""
    p, n = X.shape
    matrix = np.block([[upper * np.eye(p), X], [X.T, lower * np.eye(n)]])
    return np.linalg.solve(matrix, np.append(b, np.zeros(n)))[p:]


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("name", ["extended_iv", "extended_iv_tls", "generalized_iv", "generalized_iv_tls"])
def test_the_papers_normal_and_augmented_systems(name, seed):
    """(24) and (25), (26) and (27), (30) and (31), (32) and (33), in full and as they stand."""
    rng = np.random.default_rng([97, seed])
    # so much noise that least squares and total least squares differ
    signals = noisy(motion(rng, 60), {"velocity_z": 0.02, "input": 0.3, "specific_force_z": 0.02}, rng)
    X, b = sums_over_rows(signals, name)
    least = np.linalg.solve(X.T @ X, X.T @ b)
    if name.endswith("_tls"):
        smallest = np.linalg.svd(np.column_stack([X, b]), compute_uv=False)[-1]
        normal = np.linalg.solve(X.T @ X - smallest**2 * np.eye(2), X.T @ b)
        full = augmented(X, b, smallest, smallest)
        # ... of which least squares, in place of it, would be far off, as would other units of the columns
        assert np.abs(normal / least - 1.0).max() > 1e-4
        lengths = np.linalg.norm(X, axis=0)
        other = np.linalg.svd(np.column_stack([X / lengths, b]), compute_uv=False)[-1]
        scaled = np.linalg.solve(X.T @ X - other**2 * np.diag(lengths**2), X.T @ b)
        assert np.abs(normal / scaled - 1.0).max() > 1e-4
    else:
        smallest = np.linalg.svd(X, compute_uv=False)[-1]
        normal, full = least, augmented(X, b, smallest / np.sqrt(2.0), 0.0)
    np.testing.assert_allclose(full, normal, rtol=1e-9)
    problem = MOTION.regression(signals, lags_of(name, 5))
    fit = ev.identify(problem, method_of(name))
    np.testing.assert_allclose(list(fit.parameters.values()), full, rtol=1e-9)


class TestErrataOfEquation29:
    """C = sigma_u^2 H per row, with the 1 of H in the row of lag 0; both misprints bias the estimate."""

    RUNS, STD = 100, 0.5

    def estimates(self, shared):
        results = []
        for run in range(self.RUNS):
            rng = np.random.default_rng([29, run])
            signals = noisy(motion(rng, 500, white_input=True), {"input": self.STD}, rng)
            rows = MOTION.regression(signals, ev.lags("input", 0, 5)).rows()
            problem = replace(rows, instrument_noise=shared(rows.response.size))
            results.append(ev.identify(problem, ev.methods.generalized_iv()).parameters["input_gain"])
        return np.array(results)

    def relative_bias(self, shared):
        estimates = self.estimates(shared)
        return (estimates.mean() - K_U) / K_U, estimates.std(ddof=1) / np.sqrt(self.RUNS) / K_U

    @staticmethod
    def compensation(row, size):
        """H with its 1 in that row, times `size`, beside a response without shared noise."""
        C = np.zeros((6, 3))
        C[row, 1] = size
        return C

    def test_the_right_one_is_unbiased_and_agrees_with_the_tags(self):
        bias, error = self.relative_bias(lambda _: self.compensation(0, self.STD**2))
        assert abs(bias) <= 3.0 * error
        rng = np.random.default_rng(0)
        signals = noisy(motion(rng, 1000), {"input": self.STD}, rng)
        C = MOTION.regression(signals, ev.lags("input", 0, 5)).instrument_noise_covariance()
        np.testing.assert_allclose(C, self.compensation(0, self.STD**2), atol=1e-15)

    @pytest.mark.parametrize(
        ("misprint", "row", "size"),
        [
            ("the 1 in row 2", 1, lambda _, variance: variance),
            ("N missing: sigma^2 against a sum over N rows", 0, lambda rows, variance: variance / rows),
        ],
        ids=["row 2", "N missing"],
    )
    def test_the_printed_ones_are_biased(self, misprint, row, size):
        bias, error = self.relative_bias(lambda rows: self.compensation(row, size(rows, self.STD**2)))
        assert abs(bias) > 10.0 * error, misprint
        assert abs(bias) > 0.05


def test_gains_that_are_known_series():
    """A regressor u(k) times a known cosine shares sigma^2 mean(cos) with the plain instrument u(k)."""
    rng = np.random.default_rng(8)
    channels = motion(rng, 4000)
    tilt = 0.9 + 0.1 * np.sin(0.01 * np.arange(4000))
    channels["specific_force_z"] = K_U * tilt * channels["input"] - K * channels["velocity_z"]
    signals = noisy(channels, {"input": 0.3}, rng)
    signals = replace(signals, channels={**signals.channels, "cos_tilt": tilt})
    problem = MOTION.regression(signals, ev.lags("input", 0, 8))
    friction, (gain, _) = problem.equation.terms
    gained = (gain, ev.Column("input", gain_channel="cos_tilt"))
    problem = replace(problem, equation=replace(problem.equation, terms=(friction, gained)))
    C = problem.instrument_noise_covariance()
    assert C[0, 1] == pytest.approx(0.3**2 * tilt[8:].mean(), rel=1e-12)
    fit = ev.identify(problem, ev.methods.generalized_iv())
    assert fit.parameters["input_gain"] == pytest.approx(K_U, rel=0.05)


@pytest.mark.parametrize("name", ["bias_compensated_least_squares", "generalized_iv", "extended_iv"])
def test_intercept_and_noise_free_columns(name):
    rng = np.random.default_rng(9)
    channels = motion(rng, 4000)
    channels["specific_force_z"] = channels["specific_force_z"] + 9.8
    signals = noisy(channels, {"velocity_z": 0.002, "input": 0.2, "specific_force_z": 0.01}, rng)
    problem = ev.VerticalMotion(intercept=True).regression(signals, lags_of(name))
    fit = ev.identify(problem, method_of(name))
    assert fit.parameters["intercept"] == pytest.approx(9.8, rel=1e-3)
    assert fit.parameters["input_gain"] == pytest.approx(K_U, rel=0.1)


linearmodels = pytest.importorskip("linearmodels")


@pytest.fixture(scope="module")
def housing():
    return data.housing_problem()


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
class TestAgainstPeers:
    def test_two_stage_least_squares(self, housing):
        fit = ev.identify(housing, ev.methods.extended_iv(ev.methods.TwoStage()))
        y, endogenous, exogenous, excluded = data.housing()
        peer = linearmodels.IV2SLS(y, exogenous, endogenous, excluded).fit().params.to_numpy()
        np.testing.assert_allclose(fit.values[[1, 2, 0]], peer, rtol=1e-8)
        for name, published in truth.STATA_2SLS.items():
            assert fit.parameters[name] == pytest.approx(published, rel=1e-7)

    def test_limited_information(self, housing):
        """Stata's manual, ivregress: `ivregress liml rent pcturban (hsngval = faminc i.region)`."""
        fit = ev.identify(housing, ev.methods.liml())
        for name, printed in truth.STATA_LIML.items():
            assert fit.parameters[name] == pytest.approx(printed, rel=2e-5)

    @pytest.mark.parametrize("bandwidth", [0, 1, 4])
    def test_two_step_gmm(self, housing, bandwidth):
        fit = ev.identify(housing, ev.methods.extended_iv(ev.methods.TwoStepRobust(bandwidth=bandwidth)))
        y, endogenous, exogenous, excluded = data.housing()
        kernel = {"weight_type": "kernel", "kernel": "bartlett", "bandwidth": bandwidth}
        weights = kernel if bandwidth else {"weight_type": "robust"}
        peer = linearmodels.IVGMM(y, exogenous, endogenous, excluded, **weights).fit(iter_limit=2)
        np.testing.assert_allclose(fit.values[[1, 2, 0]], peer.params.to_numpy(), rtol=1e-8)
        if bandwidth == 0:
            for name, published in truth.STATA_GMM.items():
                assert fit.parameters[name] == pytest.approx(published, rel=1e-7)
            J = housing.response.size * fit.solution.objective
            assert pytest.approx(truth.STATA_GMM_J, rel=1e-9) == J


def test_weak_instruments_are_told():
    rng = np.random.default_rng(3)
    n = 500
    x, z = rng.standard_normal(n), rng.standard_normal((n, 3))
    problem = ev.regression(response=x + rng.standard_normal(n), regressors=x[:, None], instruments=z)
    with pytest.warns(UserWarning, match="first-stage F is .*, and 10 is needed"):
        fit = ev.identify(problem, ev.methods.extended_iv())
    assert fit.status.value == "weak"
    assert "errors white); first-stage F" in fit.summary()


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
    restricted, free = (endogenous.T @ item @ endogenous for item in (annihilator(X[:, 1:]), M))
    k = scipy.linalg.eigvalsh(restricted, free)[0]
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


ROWS, TRUTH = 400, np.array([0.7, -1.3])


def noisy_problem(*, instruments, shared_response=0.3):
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
    scores = fit.equation.scores
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
    problem = ev.regression(response=x + error, regressors=x[:, None], instruments=z[:, None])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = ev.identify(problem, ev.methods.extended_iv(ev.methods.TwoStage()))
    assert (fit.status.value == "weak") == weak
    if weak:
        assert f"first-stage F is {first_stage:.2g}" in fit.reasons[0].sentence
