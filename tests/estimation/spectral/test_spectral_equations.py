"""The equations against their naive form, bin by bin, and the linear rows that stand for their solution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import eivor as ev
from eivor.estimation.pair_whitening import corrected_spectrum, power_around, signal_weights
from eivor.estimation.sampled_motion import SampledMotion, SampledProblem, sampled_problem
from eivor.estimation.spectral_equations import (
    SpectralSolution,
    consistent_estimate,
    pilot_at,
    solved_equations,
    solved_rows,
    spectral_covariance,
    whitened_rows,
)

ProblemOf = Callable[[str, int, int], ev.SignalRegression]


@pytest.fixture
def sampled(problem_of: ProblemOf) -> SampledProblem:
    return sampled_problem(problem_of("rich", 1001, 11), "spectral_giv")


@pytest.fixture(params=[False, True], ids=["held", "free rho"])
def solution(sampled: SampledProblem, request: pytest.FixtureRequest) -> SpectralSolution:
    start = SampledMotion(sampled.record, *consistent_estimate(sampled.problem).best.values[:2].tolist())
    pilot = pilot_at(start, sampled.input_variance)
    return solved_equations(pilot, sampled.input_variance, free_blend=request.param)


def dense_spectrum(solution: SpectralSolution, k: int) -> np.ndarray:
    C = solution.spectrum
    return np.array([[C.first[k], C.cross[k]], [C.cross[k].conj(), C.second[k]]])


def test_the_naive_sums_are_zero(solution: SpectralSolution) -> None:
    motion, U = solution.motion, solution.motion.record.input
    scores, sizes = np.zeros(solution.parameters), np.zeros(solution.parameters)
    nuisances = np.zeros(solution.nuisances.size)
    residual = solution.residual
    for k in range(U.size):
        inverse = np.linalg.inv(dense_spectrum(solution, k))
        wc = solution.weights[k] * solution.factors[k]
        right = inverse @ (U[k].conj() * residual[:, k] + motion.input_noise[:, k] * solution.input_variance)
        for j in range(solution.parameters):
            term = wc * (motion.directions[j][:, k].conj() @ right).real
            scores[j] += term
            sizes[j] += abs(term)
        for j, psi in enumerate(solution.nuisance_shapes):
            nuisances[j] += solution.factors[k] * (psi[:, k].conj() @ inverse @ residual[:, k]).real
    assert np.abs(scores).max() < 1e-6 * sizes.max()
    np.testing.assert_allclose(nuisances, 0.0, atol=1e-6 * sizes.max())


def test_rows_meet_the_same_equations(solution: SpectralSolution, sampled: SampledProblem) -> None:
    parameters = (*sampled.problem.parameters, ev.VerticalMotion().parameters[0])[: solution.parameters]
    if solution.parameters == 3:
        parameters = (*parameters[:2], type(parameters[0])("intersample_share"))
    motion = solution.motion
    theta = np.array([motion.friction, motion.gain, motion.blend])[: solution.parameters]
    solved = solved_rows(solution, parameters)
    np.testing.assert_allclose(solved.solution.theta, theta, rtol=1e-7, atol=1e-8)
    rows = whitened_rows(solution, parameters)
    current = spectral_covariance(solution).influence.sum(axis=0)
    assert current.shape == (solution.parameters,)
    assert rows.response.size == 2 * sampled.record.count
    assert np.var(rows.response - rows.regressors @ theta) == pytest.approx(1.0, abs=0.15)


def test_the_compensation_matters(sampled: SampledProblem, solution: SpectralSolution) -> None:
    start = SampledMotion(sampled.record, solution.motion.friction, solution.motion.gain)
    pilot = pilot_at(start, sampled.input_variance)
    without = solved_equations(pilot, 0.0, free_blend=solution.free_blend)
    lost = 1.0 - without.motion.gain / solution.motion.gain
    noise = sampled.input_variance / float(np.mean(np.abs(sampled.record.input) ** 2))
    assert lost > 0.2 * noise > 0.0


def test_weights_read_their_own_bin_at_lines_only() -> None:
    rng = np.random.default_rng(0)
    noise_variance = 0.5
    bins = rng.standard_normal(200) + 1j * rng.standard_normal(200)
    before = signal_weights(bins, noise_variance)
    around = power_around(bins)[100]
    for factor, line in ((11.0, False), (13.0, True)):
        bins[100] = np.sqrt(factor * around)
        after = signal_weights(bins, noise_variance)
        expected = (1.0 - noise_variance / (factor * around)) ** 2 if line else before[100]
        assert after[100] == pytest.approx(expected, rel=1e-9)
        assert (after[[99, 101]] > before[[99, 101]]).all()
        assert ((after >= 1e-6) & (after <= 1.0)).all()


def test_a_wrong_model_is_corrected_by_the_residuals(solution: SpectralSolution) -> None:
    """Residuals four times as strong as the model has them: most of it is found."""
    C = solution.spectrum
    rng = np.random.default_rng(1)
    white = (rng.standard_normal((2, C.first.size)) + 1j * rng.standard_normal((2, C.first.size))) / np.sqrt(
        2
    )
    top, below, bottom = C.root
    residual = 2.0 * np.stack([top * white[0], below * white[0] + bottom * white[1]])
    spectrum = corrected_spectrum(C, residual, np.zeros(C.first.size))
    ratio = np.median(spectrum.first / C.first), np.median(spectrum.second / C.second)
    np.testing.assert_allclose(ratio, 4.0, rtol=0.12)
