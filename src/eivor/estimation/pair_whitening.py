"""Whitening of paired spectral rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import EllipsisType

import numpy as np

from eivor.errors import EstimationError
from eivor.estimation import sampled_motion as sampling
from eivor.estimation.moments import FittedNoise
from eivor.estimation.weighting import POWER_FLOOR, RENEWALS, RowWeighting, WhitenedRows
from eivor.inference.diagnostics.record import orthonormal_basis
from eivor.models.regression import Regression
from eivor.models.separable import Nuisance, SampledState, SeparableProblem, Values
from eivor.models.spectral import BinRows, SpectralRegression
from eivor.signals.noise import WhiteNoise
from eivor.tools import Complex, Float, Int

PerBin = Float[np.ndarray, " bins"]
Vector = Float[np.ndarray, " n"]

#: Frequency that strengths of noises are identified at [Hz]; orders say what they are beside it.
STRENGTH_AT_HZ = 1.0
#: Share of the responses' power that counts as rounding.
ROUNDING = 1e-8


@dataclass(frozen=True)
class PairedBins:
    """Bins of all runs at some parameters."""

    layout: BinRows
    theta: Vector
    state: SampledState
    floor: float = 0.0
    order: Int[np.ndarray, " bins"] | EllipsisType = ...  # Of the bins; default: that of the runs

    @cached_property
    def frequency_hz(self) -> PerBin:
        return np.concatenate([run.frequency_hz for run in self.layout.runs])[self.order]

    @cached_property
    def step_s(self) -> PerBin:
        """Time between samples of each bin's run [s]."""
        return np.concatenate([np.full(run.count, run.step_s) for run in self.layout.runs])[self.order]

    @cached_property
    def log_scale(self) -> PerBin:
        """Logarithm of a difference's gain over that at `STRENGTH_AT_HZ`."""
        return np.log(
            np.sin(np.pi * self.frequency_hz * self.step_s) / np.sin(np.pi * STRENGTH_AT_HZ * self.step_s)
        )

    def shapes(self) -> sampling.Shapes:
        """C of one unit of noise of the inputs, of the state, of the response, and of a disturbance."""
        entries, K = np.ones(self.frequency_hz.size), float(self.theta[self.state.index])
        rate = 2j / self.step_s * np.tan(np.pi * self.frequency_hz * self.step_s) + K
        driven = float(np.sum((self.theta * self.state.driven_density) ** 2)) * entries
        return (
            sampling.PairSpectrum(driven + self.floor, driven + self.floor, driven.astype(complex)),
            sampling.PairSpectrum(K * K * entries, np.abs(rate) ** 2, K * rate.conj()),
            sampling.PairSpectrum(entries, 0.0 * entries, 0.0j * entries),
            sampling.PairSpectrum(entries, entries, entries.astype(complex)),
        )

    @cached_property
    def density_scale(self) -> PerBin:
        """One-sided power per Hz over a bin's power: 2 T over the mean square of the taper."""
        runs = self.layout.runs
        return np.concatenate([np.full(run.count, 2.0 * run.step_s / np.mean(run.taper**2)) for run in runs])

    def residual(self, bins: SpectralRegression) -> sampling.Pair:
        """r_1 and r_2, per root of Hz."""
        result = responses(bins) - (bins.regressors @ self.theta)[:, None]
        return result.T * np.sqrt(self.density_scale)

    def fitted_noises(self, bins: SpectralRegression) -> tuple[FittedNoise, ...]:
        """Fitted noises with errors; strengths are amplitude densities at `STRENGTH_AT_HZ`."""
        return sampling.fitted_noises(*self.fitted(bins), f"per root of Hz, at {STRENGTH_AT_HZ:g} Hz")

    def fitted(
        self, bins: SpectralRegression
    ) -> tuple[sampling.PairedEquations, sampling.Pair, sampling.NoiseModel, sampling.NoisePrior]:
        """Residuals in order, with the noises that fit them, declared ones as they are."""
        order = np.argsort(self.frequency_hz, kind="stable")
        pairs, residual = replace(self, order=order), self.residual(bins)[:, order]
        densities = self.state.state_density, self.state.response_density
        velocity, acceleration = (None if np.isnan(density) else WhiteNoise(density) for density in densities)
        prior = sampling.noise_prior(pairs, residual, 1.0, (velocity, acceleration), disturbance_order=None)
        return pairs, residual, sampling.fitted_noise(pairs, residual, prior.centre, prior), prior


def responses(bins: SpectralRegression) -> Complex[np.ndarray, "bins 2"]:
    """A and s v: central differences of v, over cos^2(pi f T)."""
    quarter = [np.cos(np.pi * run.frequency_hz * run.step_s) for run in bins.layout.runs]
    return np.column_stack([bins.responses[:, 0], bins.responses[:, -1] / np.concatenate(quarter) ** 2])


def paired_bins(problem: SeparableProblem, theta: Vector, nuisances: Values) -> PairedBins:
    """Bins of a problem at some parameters."""
    state = problem.sampled_state(nuisances)
    if state is None:
        expected = "a motion whose state and its derivative were both measured, for a spectral method"
        remedy = "Log the accelerometer and the velocity, or use reference_iv."
        raise EstimationError(expected, "one of them alone", remedy)
    bins = problem.bins(nuisances)
    pairs = PairedBins(bins.layout, theta, state)
    power = np.abs(bins.responses[:, 0]) ** 2 * pairs.density_scale
    return replace(pairs, floor=ROUNDING * float(np.median(power)))


#: Neighbours of a bin, on each side, that identify the power of its input without itself.
INPUT_NEIGHBOURS = 3
#: A bin is a line of the input where its power exceeds its noise and its neighbours' power by this factor.
LINE = 12.0
#: Least share of signal in the input's power.
LEAST_SHARE = 1e-3
#: Squared distance of a pair of residuals beyond which it is held back.
FAR = 12.0
#: Neighbours on each side that periodograms are averaged over, at least and at most, and how many averaged
#: ones the identity counts for.
FEWEST, MOST, IDENTITY = 6, 100, 6.0
#: Largest leverage that a residual is corrected for.
LARGEST_LEVERAGE = 3.0


def signal_weights(spectrum: Complex[np.ndarray, " bins"], noise_variance: float) -> PerBin:
    """w, the squared share of signal in the input's power near each bin."""
    power, around = np.abs(spectrum) ** 2, power_around(spectrum)
    line = power > LINE * np.maximum(around, noise_variance)
    share = 1.0 - noise_variance / np.where(line, power, around)
    return np.clip(share, LEAST_SHARE, 1.0) ** 2


def power_around(spectrum: Complex[np.ndarray, " bins"]) -> PerBin:
    """Power near each bin, without the bin itself."""
    power = np.abs(spectrum) ** 2
    index = np.arange(power.size)
    first = np.maximum(index - INPUT_NEIGHBOURS, 0)
    last = np.minimum(index + INPUT_NEIGHBOURS + 1, power.size)
    sums = np.concatenate([[0.0], np.cumsum(power)])
    around = (sums[last] - sums[first] - power) / np.maximum(last - first - 1, 1)
    return np.maximum(around, np.finfo(np.float64).tiny)


def held_back(residual: sampling.Pair, C: sampling.PairSpectrum) -> PerBin:
    """min(1, 12 / r^H C^-1 r)."""
    distance = sampling.inner(residual, C.solved(residual)).real
    return np.minimum(1.0, FAR / np.maximum(distance, 1e-300))


def corrected_spectrum(
    model: sampling.PairSpectrum, residual: sampling.Pair, leverage: PerBin
) -> sampling.PairSpectrum:
    """Spectrum of the residuals, the model corrected by their own periodogram."""
    lost = np.sqrt(1.0 - np.minimum(leverage, LARGEST_LEVERAGE) / 4.0)
    white = model.whitened(residual) / lost
    index = np.arange(white.shape[1])
    half = np.clip(index + 1, FEWEST, MOST)
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, index.size)
    count = (last - first).astype(np.float64)

    def averaged(values: Float[np.ndarray, "bins k"]) -> Float[np.ndarray, "bins k"]:
        sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        return (sums[last] - sums[first]) / count[:, None]

    return recoloured(model, white, averaged, count)


def recoloured(
    model: sampling.PairSpectrum,
    white: sampling.Pair,
    averaged: Callable[[Float[np.ndarray, "bins k"]], Float[np.ndarray, "bins k"]],
    count: PerBin,
) -> sampling.PairSpectrum:
    """L P L^H of a model L L^H, P means of I and of the periodogram of what it whitened over so many bins."""
    across = white[0] * white[1].conj()
    averages = averaged(np.stack([*np.abs(white) ** 2, across.real, across.imag], axis=1))
    share = count / (count + IDENTITY)
    first, two, real, imaginary = share * averages.T + np.outer([1.0, 1.0, 0.0, 0.0], 1.0 - share)
    across = real + 1j * imaginary
    top, below, bottom = model.root  # L = [top 0; below bottom]
    return sampling.PairSpectrum(
        top**2 * first,
        np.abs(below) ** 2 * first + bottom**2 * two + 2.0 * (below * across * bottom).real,
        top * (first * below.conj() + across * bottom),
    )


@dataclass(frozen=True)
class CombinedProblem(SeparableProblem):
    """A problem whose candidates for the response are combined, with weights of each bin."""

    problem: SeparableProblem  # With two candidates
    weights: Complex[np.ndarray, "bins 2"]
    nuisances: tuple[Nuisance, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "nuisances", self.problem.nuisances)

    def rows(self, nuisances: Values) -> Regression:
        return self.problem.rows(nuisances)

    def bins(self, nuisances: Values) -> SpectralRegression:
        bins = self.problem.bins(nuisances)
        return replace(bins, responses=(responses(bins) * self.weights).sum(axis=1, keepdims=True))


@dataclass(frozen=True)
class PairRows(WhitenedRows):
    """Rows of one pass, by a noise model that was fitted to residuals."""

    pair: SeparableProblem = field(kw_only=True)  # With two candidates, which `problem` combines
    C: sampling.PairSpectrum = field(kw_only=True)
    corrected: bool = field(kw_only=True)  # See `PairWhitening`

    def criterion(self, theta: Vector, nuisances: Values, /) -> float | None:
        """Of the model as it is, twice the sum of log det C + r^H C^-1 r: minus twice the log likelihood."""
        if self.corrected:
            return None
        C, bins = self.C, self.pair.bins(nuisances)
        residual = paired_bins(self.pair, theta, nuisances).residual(bins)
        return 2.0 * float((np.log(C.determinant) + sampling.inner(residual, C.solved(residual)).real).sum())

    def renewed(self, theta: Vector, nuisances: Values, /) -> PairRows:
        return _by_residuals(self.pair, self.corrected, theta, nuisances, self.renewals - 1)


def _by_residuals(
    problem: SeparableProblem, corrected: bool, theta: Vector, nuisances: Values, renewals: int
) -> PairRows:
    pairs, bins = paired_bins(problem, theta, nuisances), problem.bins(nuisances)
    C, factor = pairs.fitted(bins)[2].spectrum(pairs), np.ones(bins.responses.shape[0])
    if corrected:
        residual = pairs.residual(bins)
        # the model corrected by the residuals' own periodogram: a wrong model costs efficiency alone
        count = np.concatenate([run.smoothed_over for run in pairs.layout.runs])
        C = recoloured(C, C.whitened(residual), pairs.layout.smoothed, count)
        factor = held_back(residual, C)
    return _weighted(problem, bins, corrected, C, factor * pairs.density_scale, renewals)


def _weighted(
    problem: SeparableProblem,
    bins: SpectralRegression,
    corrected: bool,
    C: sampling.PairSpectrum,
    factor: PerBin,
    renewals: int,
) -> PairRows:
    spread = np.maximum(C.first + C.second - 2.0 * C.cross.real, np.finfo(np.float64).tiny)
    shares = np.stack([C.second - C.cross.conj(), C.first - C.cross], axis=1) / spread[:, None]
    power = np.maximum(C.determinant, 0.0) / spread
    power = np.maximum(power, POWER_FLOOR * float(np.median(power))) / factor
    basis = orthonormal_basis(bins.layout.stacked(bins.instruments / np.sqrt(power)[:, None]))
    combined, blend = CombinedProblem(problem, shares), np.zeros(power.size)
    return PairRows(combined, renewals, blend, power, basis, pair=problem, C=C, corrected=corrected)


@dataclass(frozen=True, slots=True)
class PairWhitening(RowWeighting):
    """Combine both equations of a sampled state by the spectrum of their residuals."""

    corrected: bool  # By the residuals' periodogram; else the likelihood's model as it is

    def first_pass(self, problem: SeparableProblem) -> PairRows:
        first_values = problem.first_values
        bins = problem.bins(first_values)
        paired_bins(problem, np.zeros(bins.regressors.shape[1]), first_values)
        entries = np.ones(bins.responses.shape[0])
        C = sampling.PairSpectrum(entries, entries, 0.0j * entries)
        return _weighted(problem, bins, self.corrected, C, entries, RENEWALS)

    def last_pass(self, problem: SeparableProblem, theta: Vector, nuisances: Values, /) -> PairRows:
        return _by_residuals(problem, self.corrected, theta, nuisances, 0)
