"""The seven methods of the paper's table: recovery, equivalences, invariances, and the errata of (29)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import eivor as ev
from eivor.linalg import TotalLeastSquares

SEVEN = (
    "least_squares",
    "total_least_squares",
    "bias_compensated_least_squares",
    "extended_iv",
    "extended_iv_tls",
    "generalized_iv",
    "generalized_iv_tls",
)
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
    v = np.zeros(count)
    for k in range(count - 1):
        v[k + 1] = decay * v[k] + K_U / K * (1.0 - decay) * u[k]
    return {"velocity_z": v, "specific_force_z": K_U * u - K * v, "input": u}


def noisy(channels, stds, rng):
    measured = {
        name: values + stds.get(name, 0.0) * rng.standard_normal(values.size)
        for name, values in channels.items()
    }
    noise = {name: ev.WhiteNoise(std=stds.get(name, 0.0)) for name in channels}
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


@pytest.mark.parametrize("name", SEVEN)
def test_rows_of_arrays_and_of_signals_agree(name):
    """Slices and folded matrix products against one matrix of lags."""
    rng = np.random.default_rng(1)
    signals = noisy(motion(rng), {"velocity_z": 0.005, "input": 0.1, "specific_force_z": 0.005}, rng)
    problem = MOTION.regression(signals, lags_of(name))
    rows = replace(
        problem.rows(),
        instrument_noise=problem.instrument_noise_covariance(),
        regressor_noise=problem.regressor_noise_covariance(),
    )
    a, b = (method_of(name).solve(p).solution.theta for p in (problem, rows))
    np.testing.assert_allclose(a, b, rtol=1e-11)


UNIT_FREE = (
    "least_squares",
    "total_least_squares",
    "bias_compensated_least_squares",
    "extended_iv",
    "generalized_iv",
)


@pytest.mark.parametrize("name", UNIT_FREE)
@settings(max_examples=13)
@given(exponent=st.integers(-6, 6))
def test_invariance_under_a_change_of_units(name, exponent):
    """The input and its noise in other units; the paper's unweighted TLS forms do not have this."""
    scale = 10.0**exponent
    rng = np.random.default_rng(2)
    stds = {"velocity_z": 0.005, "input": 0.1, "specific_force_z": 0.005}
    signals = noisy(motion(rng, 500), stds, rng)
    other = replace(
        signals,
        channels={**signals.channels, "input": scale * signals.channels["input"]},
        noise={**signals.noise, "input": ev.WhiteNoise(std=scale * 0.1)},
    )
    weighting = ev.methods.TwoStage()
    method = getattr(ev.methods, name)(weighting) if name.endswith("_iv") else method_of(name)
    fits = [ev.identify(MOTION.regression(s, lags_of(name)), method) for s in (signals, other)]
    assert fits[1].parameters["input_gain"] * scale == pytest.approx(
        fits[0].parameters["input_gain"], rel=1e-7
    )
    assert fits[1].parameters["viscous_friction"] == pytest.approx(
        fits[0].parameters["viscous_friction"], rel=1e-7
    )


@pytest.mark.parametrize("name", SEVEN)
def test_permutation_of_columns_permutes_the_estimates(name):
    rng = np.random.default_rng(5)
    signals = noisy(motion(rng, 500), {"velocity_z": 0.005, "input": 0.1, "specific_force_z": 0.005}, rng)
    problem = MOTION.regression(signals, lags_of(name))
    swapped = replace(
        problem,
        equation=replace(problem.equation, terms=problem.equation.terms[::-1]),
        instrument_columns=problem.instrument_columns[::-1],
    )
    a, b = (ev.identify(p, method_of(name)).parameters for p in (problem, swapped))
    assert a["viscous_friction"] == pytest.approx(b["viscous_friction"], rel=1e-8)
    assert a["input_gain"] == pytest.approx(b["input_gain"], rel=1e-8)


def short_record(seed):
    """Sixty samples with so much noise that least squares and total least squares differ."""
    rng = np.random.default_rng([97, seed])
    stds = {"velocity_z": 0.02, "input": 0.3, "specific_force_z": 0.02}
    return noisy(motion(rng, 60), stds, rng)


def sums_over_rows(signals, name, order=5):
    """X and b of (23) or (29): sums over all rows, as printed, with N in the row of lag 0."""
    velocity, drive, response = (signals.channels[n] for n in ("velocity_z", "input", "specific_force_z"))
    generalized = name.startswith("generalized")
    rows = slice(order, None)
    Psi = np.column_stack(
        [drive[order - lag : drive.size - lag] for lag in range(0 if generalized else 1, order + 1)]
    )
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
    signals = short_record(seed)
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
    if name.endswith("_tls"):
        svd = replace(method_of(name), solver=TotalLeastSquares())
        np.testing.assert_allclose(svd.solve(problem).solution.theta, full, rtol=1e-9)


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
        problem = MOTION.regression(
            noisy(motion(rng, 1000), {"input": self.STD}, rng), ev.lags("input", 0, 5)
        )
        np.testing.assert_allclose(
            problem.instrument_noise_covariance(), self.compensation(0, self.STD**2), atol=1e-15
        )

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
