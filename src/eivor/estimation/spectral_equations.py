"""Spectral estimating equations of a sampled motion, and their covariance."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.errors import EstimationError, WeakInstrumentsWarning
from eivor.estimation import sampled_motion as sampling
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.moments import Compensated, FittedNoise
from eivor.estimation.pair_whitening import LARGEST_LEVERAGE, corrected_spectrum, held_back, signal_weights
from eivor.inference.covariance import COSINE_AVERAGES, cosine_averages
from eivor.linalg.total_least_squares import AugmentedLeastSquares, LeastSquares
from eivor.models.regression import AxisRows, Parameter, Regression
from eivor.models.signal_regression import SignalRegression
from eivor.signals.noise import MeasurementNoise
from eivor.tools import Complex, Float, Int

Spectra = Complex[np.ndarray, "n 2 bins"]
Matrix = Float[np.ndarray, "n m"]

#: Method whose answer serves as start, and where spectra do not serve.
GENERALIZED_IV = LinearMethod("generalized_iv", Compensated(), AugmentedLeastSquares())


@dataclass(frozen=True)
class Pilot:
    """Start of a search."""

    motion: sampling.SampledMotion
    transient: float
    noise: sampling.NoiseModel  # Noises that fit
    prior: sampling.NoisePrior


def consistent_estimate(problem: SignalRegression) -> Estimate:
    """Generalized IV of the same problem, without its warnings, which are reported later."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WeakInstrumentsWarning)
        return GENERALIZED_IV.estimate(problem)


def pilot_at(
    motion: sampling.SampledMotion,
    input_variance: float,
    declared: tuple[MeasurementNoise | None, MeasurementNoise | None] = (None, None),
) -> Pilot:
    """Noises that fit the residuals at some parameters; those of z' and z'' as declared, where they are."""
    transient = first_transient(motion)
    residual = motion.steady_state(transient)
    prior = sampling.noise_prior(motion, residual, input_variance, declared)
    return Pilot(motion, transient, sampling.fitted_noise(motion, residual, prior.centre, prior), prior)


def first_transient(motion: sampling.SampledMotion) -> float:
    """The transient t by least squares on the second residual."""
    shape, residual = motion.memory, motion.residuals()[1]
    return float((shape.conj() * residual).real.sum() / (np.abs(shape) ** 2).sum())


#: Passes of spectrum and equations, Newton's steps in each, and the relative change that ends them.
EQUATION_PASSES, STEPS, EQUATION_TOLERANCE = 8, 12, 1e-7
#: Relative change of the parameters in a pass below which they rest.
AT_REST = 1e-4
#: Largest share of a parameter that one step may change it by.
LARGEST_SHARE = 0.5
#: Fewest samples with ramps among the nuisances.
RAMP_SAMPLES = 400


@dataclass(frozen=True)
class SpectralSolution:
    """Solution of the equations, with the parts of its covariance."""

    motion: sampling.SampledMotion
    nuisances: Float[np.ndarray, " q"]  # Transient, and ramps
    spectrum: sampling.PairSpectrum
    instrument: Complex[np.ndarray, " bins"]
    input_variance: float
    weights: Float[np.ndarray, " bins"]
    factors: Float[np.ndarray, " bins"]
    free_blend: bool
    change: float = np.inf  # Relative change of the parameters in the last pass
    noises: tuple[FittedNoise, ...] = ()
    noise_test: Float[np.ndarray, " bins"] | None = None  # 1 / S_u where sigma_u^2 is unknown

    @property
    def converged(self) -> bool:
        """Whether the last pass left the parameters where they were."""
        return self.change < AT_REST

    @property
    def parameters(self) -> int:
        """Number of parameters: K, b, and rho where it is free."""
        return 3 if self.free_blend else 2

    @property
    def values(self) -> Float[np.ndarray, " 2"]:
        """Friction and gain."""
        return np.array([self.motion.friction, self.motion.gain])

    @cached_property
    def covariance(self) -> SpectralCovariance:
        return spectral_covariance(self)

    @cached_property
    def residual(self) -> sampling.Pair:
        """r, without the nuisances' part."""
        return self.motion.corrected(self.nuisances, self.nuisance_shapes)

    @cached_property
    def nuisance_shapes(self) -> Complex[np.ndarray, "q 2 bins"]:
        """Derivatives of the residuals by nuisances: psi."""
        return self.motion.nuisance_shapes(self.nuisances.size > 1)

    @cached_property
    def tests(self) -> Spectra:
        """Test functions before C^-1: w c U d_j, c psi, and c U s / S_u where sigma_u^2 is unknown."""
        by_instrument = self.corrections * self.instrument
        shapes = self.nuisance_shapes * self.factors
        return np.concatenate([by_instrument[: self.parameters], shapes, by_instrument[self.parameters :]])

    @cached_property
    def corrections(self) -> Complex[np.ndarray, "m 2 bins"]:
        """Tests that correct for the input's noise: w c d_j, and c s / S_u where sigma_u^2 is unknown."""
        directions = self.motion.directions[: self.parameters] * (self.weights * self.factors)
        if self.noise_test is None:
            return directions
        return np.concatenate(
            [directions, (self.motion.input_noise * (self.factors * self.noise_test))[None]]
        )

    @property
    def noisy(self) -> Int[np.ndarray, " m"]:
        """Numbers of the equations that the input's noise is taken off."""
        return np.delete(np.arange(self.tests.shape[0]), self.parameters + np.arange(self.nuisances.size))

    def scores(self) -> Float[np.ndarray, " n"]:
        """Left sides of the equations."""
        result = _products(self.tests, self.spectrum.solved(self.residual)[None])[:, 0]
        if self.input_variance:
            by_noise = self.spectrum.solved(self.motion.input_noise)
            result[self.noisy] += self.input_variance * _products(self.corrections, by_noise[None])[:, 0]
        return result

    def stepped(self) -> sampling.SampledMotion:
        return shifted(self.motion, -np.linalg.solve(self.sensitivity, self.scores())[: self.parameters])

    @cached_property
    def _derivatives(self) -> tuple[Complex[np.ndarray, "k 2 bins"], Complex[np.ndarray, "p 2 bins"]]:
        """C^-1 times the derivatives of the residuals, and those of the compensation."""
        solved = self.spectrum.solved(self.motion.directions[: self.parameters])
        parts = [solved * self.motion.record.input, self.spectrum.solved(self.nuisance_shapes)]
        return np.concatenate(parts), solved * self.input_variance

    @cached_property
    def sensitivity(self) -> Float[np.ndarray, "n n"]:
        """J, the derivative of the equations by parameters and nuisances, a sum over bins."""
        slopes, noise = self._derivatives
        result = np.zeros((self.tests.shape[0], self.tests.shape[0]))
        result[:, : len(slopes)] = _products(self.tests, slopes)
        result[np.ix_(self.noisy, np.arange(len(noise)))] -= _products(self.corrections, noise)
        if self.noise_test is not None:
            by_noise = self.spectrum.solved(self.motion.input_noise)
            result[self.noisy, -1] = _products(self.corrections, by_noise[None])[:, 0]
        return result

    def leverage(self, inverse: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " bins"]:
        """Share of each bin in J, as the trace of J^-1 times it."""
        slopes, noise = self._derivatives
        shares = _shares(self.tests, np.tensordot(inverse[: len(slopes)].T, slopes, 1))
        shares -= _shares(self.corrections, np.tensordot(inverse[: len(noise), self.noisy].T, noise, 1))
        if self.noise_test is None:
            return shares
        by_noise = self.spectrum.solved(self.motion.input_noise)
        return shares + _shares(self.corrections, inverse[-1, self.noisy][:, None, None] * by_noise)


def _products(left: Spectra, right: Complex[np.ndarray, "m 2 bins"]) -> Matrix:
    """Re of x^H y, summed over bins."""
    return _flat(left) @ _flat(right).T


def _flat(pairs: Spectra) -> Float[np.ndarray, "n numbers"]:
    """Real and imaginary parts in a row: Re of x^H y is the product of two such rows."""
    return np.ascontiguousarray(pairs).reshape(pairs.shape[0], -1).view(np.float64)


def _shares(left: Spectra, right: Spectra) -> Float[np.ndarray, " bins"]:
    """Re of x^H y of each bin, summed over the other axes."""
    return (left.real * right.real + left.imag * right.imag).sum(axis=(0, 1))


def solved_equations(
    pilot: Pilot,
    input_variance: float,
    instrument: Complex[np.ndarray, " bins"] | None = None,
    free_blend: bool = False,
    noise_test: Float[np.ndarray, " bins"] | None = None,
) -> SpectralSolution:
    """Solve from a pilot, with instruments of the input's own spectrum or another."""
    record = pilot.motion.record
    ramps = record.count >= RAMP_SAMPLES
    closed = instrument is not None
    bins = record.input if instrument is None else instrument
    weights = np.ones(bins.size) if closed else signal_weights(record.input, input_variance)
    noise, prior, leverage = pilot.noise, pilot.prior, np.zeros(bins.size)
    solution = SpectralSolution(
        pilot.motion,
        nuisances=np.array([pilot.transient, 0.0, 0.0])[: 3 if ramps else 1],
        spectrum=noise.spectrum(pilot.motion),
        instrument=bins,
        input_variance=0.0 if closed else input_variance,
        weights=weights,
        factors=np.ones(bins.size),
        free_blend=free_blend,
        noise_test=noise_test,
    )
    for number in range(EQUATION_PASSES):
        residual = solution.residual
        if noise_test is not None:
            variance = max(solution.input_variance, 0.0)
            noise = replace(noise, input_variance=variance)
            prior = replace(prior, centre=replace(prior.centre, input_variance=variance))
            solution = replace(solution, weights=signal_weights(record.input, variance))
        noise = sampling.fitted_noise(solution.motion, residual, noise, prior) if number else noise
        C = corrected_spectrum(noise.spectrum(solution.motion), residual, leverage)
        solution = replace(solution, spectrum=C, factors=held_back(residual, C))
        old = solution.motion
        solution, leverage = _newton(solution)
        new = solution.motion
        change = abs(new.friction / old.friction - 1.0) + abs(new.gain / old.gain - 1.0)
        solution = replace(solution, change=change)
        if solution.converged:
            break
    noises = sampling.fitted_noises(solution.motion, solution.residual, noise, prior, sampling.MEASURE)
    return replace(solution, noises=noises)


def _newton(solution: SpectralSolution) -> tuple[SpectralSolution, Float[np.ndarray, " bins"]]:
    """Newton's steps at fixed weights; the leverage of each bin at their beginning."""
    start = solution
    try:
        inverse = np.linalg.inv(start.sensitivity)
    except np.linalg.LinAlgError as error:
        expected = "an input that moves the vehicle"
        raise EstimationError(expected, "equations without a unique solution", "Excite it more.") from error
    for _ in range(STEPS):
        step = -inverse @ solution.scores()
        largest = float(np.max(np.abs(step[:2]) / np.abs([solution.motion.friction, solution.motion.gain])))
        if largest > LARGEST_SHARE:
            step *= LARGEST_SHARE / largest
        last = solution.parameters + solution.nuisances.size
        solution = replace(
            solution,
            motion=shifted(solution.motion, step[: solution.parameters]),
            nuisances=solution.nuisances + step[solution.parameters : last],
            input_variance=solution.input_variance + float(step[last:].sum()),
        )
        if largest < EQUATION_TOLERANCE:
            break
    return solution, np.maximum(start.leverage(inverse), 0.0)


def shifted(motion: sampling.SampledMotion, step: Float[np.ndarray, " n"]) -> sampling.SampledMotion:
    """Motion whose friction, gain, and rho where the step has one, are moved."""
    values = np.array([motion.friction, motion.gain, motion.blend]) + np.pad(step, (0, 3 - step.size))
    return sampling.SampledMotion(motion.record, *values.tolist())


def solved_rows(solution: SpectralSolution, parameters: tuple[Parameter, ...]) -> Estimate:
    """Linear equations that the solution meets, and their solution."""
    return LinearMethod("", Compensated(), LeastSquares()).solve(whitened_rows(solution, parameters))


def whitened_rows(solution: SpectralSolution, parameters: tuple[Parameter, ...]) -> Regression:
    """Rows of both equations, sample by sample, one equation after the other."""
    motion, C, count = solution.motion, solution.spectrum, solution.motion.record.count
    n = solution.parameters
    direction = motion.directions[:n]
    theta = np.array([motion.friction, motion.gain, motion.blend])[:n]
    tests, nuisance_tests = solution.tests[:n], solution.tests[n : n + solution.nuisances.size]
    weighted_shapes = C.solved(solution.nuisance_shapes).conj()
    by_nuisance = np.einsum("jkb,lkb->jl", weighted_shapes, tests).real
    by_shape = np.einsum("jkb,lkb->jl", weighted_shapes, nuisance_tests).real
    orthogonal = tests - np.tensordot(np.linalg.solve(by_shape, by_nuisance).T, nuisance_tests, 1)
    X = -series_of(C.whitened(direction * motion.record.input), count).reshape(direction.shape[0], -1).T
    Psi = -series_of(C.whitened(orthogonal), count).reshape(direction.shape[0], -1).T
    residual = series_of(C.whitened(solution.residual), count).ravel()
    # the input noise's part of products of instruments with [X y], a mean over rows
    response = motion.input_noise + np.tensordot(theta, direction, 1)
    noisy = C.solved(np.concatenate([direction, response[None]])) * (solution.weights * solution.factors)
    shared = solution.input_variance / count * np.einsum("jkb,lkb->jl", direction.conj(), noisy).real
    samples = np.tile(np.arange(count), 2)
    layout = AxisRows(np.zeros(2 * count, dtype=np.int64), np.repeat([0, 1], count), samples)
    return Regression(residual + X @ theta, X, Psi, parameters, layout, instrument_noise=shared)


def series_of(pairs: sampling.Pairs, count: int) -> Float[np.ndarray, "*shape 2 samples"]:
    """Series of pairs of unitary spectra without means."""
    bins = np.zeros((*pairs.shape[:-1], count // 2 + 1), dtype=np.complex128)
    bins[..., 1 : pairs.shape[-1] + 1] = pairs
    return np.fft.irfft(bins, count, axis=-1) * np.sqrt(count)


#: Fewest degrees of freedom.
LEAST_DEGREES = 3.0
EVERY = slice(None)


@dataclass(frozen=True)
class SpectralCovariance:
    """Both covariances of K, b, and rho where it is free."""

    model: Float[np.ndarray, "n n"]
    in_time: Float[np.ndarray, "n n"]
    degrees: Float[np.ndarray, " n"]  # Degrees of freedom of each parameter
    influence: Float[np.ndarray, "samples n"]
    noise_error: float = 0.0  # Standard error of sigma_u^2


def spectral_covariance(solution: SpectralSolution, chosen: slice = EVERY) -> SpectralCovariance:
    """Covariances at a solution, of all its parameters or of some."""
    full_inverse = np.linalg.inv(solution.sensitivity)
    inverse = full_inverse[: solution.parameters][chosen]
    combined = np.tensordot(inverse, solution.tests, axes=1)
    bin_meat = _meat(solution, inverse, combined)
    powers = np.einsum("jjb->jb", bin_meat)
    degrees = 2.0 * powers.sum(axis=1) ** 2 / (powers**2).sum(axis=1)
    leverage = np.clip(solution.leverage(full_inverse), 0.0, LARGEST_LEVERAGE)
    enlarged = np.sqrt((powers / (1.0 - leverage / 4.0)).sum(axis=1) / powers.sum(axis=1))
    model = bin_meat.sum(axis=2) * np.outer(enlarged, enlarged)
    record = solution.motion.record
    residual = series_of(solution.spectrum.whitened(solution.residual), record.count)
    combined_series = series_of(solution.spectrum.whitened(combined), record.count)
    influence = (0.5 * np.einsum("jkt,kt->tj", combined_series, residual)) * enlarged
    in_time = sum_covariance(influence)
    noise_error = 0.0
    if solution.noise_test is not None:
        last = np.tensordot(full_inverse[-1:], solution.tests, axes=1)
        noise_error = float(np.sqrt(_meat(solution, full_inverse[-1:], last).sum()))
    return SpectralCovariance(model, in_time, np.maximum(degrees, LEAST_DEGREES), influence, noise_error)


def sum_covariance(series: Float[np.ndarray, "samples n"]) -> Float[np.ndarray, "n n"]:
    """Long-run covariance of the sums of series, of as many cosine averages as have the least error."""
    count = series.shape[0]
    averages = cosine_averages(series, max(COSINE_AVERAGES, round(0.4 * count ** (2.0 / 3.0))))
    return averages.T @ averages / averages.shape[0]


def _meat(solution: SpectralSolution, inverse: Matrix, combined: Spectra) -> Float[np.ndarray, "n n bins"]:
    """J^-1 M J^-T, bin by bin, for some rows of J^-1 and the tests that they combine."""
    meat = np.einsum("jkb,lkb->jlb", combined.conj(), solution.spectrum.solved(combined)).real
    if solution.input_variance:
        by_noise = np.tensordot(inverse[:, solution.noisy], solution.corrections, axes=1)
        shared = solution.spectrum.solved(solution.motion.input_noise)
        phi = np.einsum("jkb,kb->jb", by_noise.conj(), shared)
        meat += solution.input_variance**2 * (phi[:, None] * phi[None, :]).real
    return 0.5 * meat
