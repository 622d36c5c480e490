r"""Both equations of flights in bins, and the spectra of what they leave.

A state v whose derivative a is measured as well has two equations in a bin of frequency f; with T between
samples,

    r_1 = a - x theta,    r_2 = s v - x theta,    s = (2j/T) tan(pi f T),

where x are the regressors, -v among them: the relation of a sample to the next one, for an input that is
linear between samples as an actuator's state is, to K T tan(pi f T)/6 of it. Both have the same parameters,
so that these are told by one combination of both, and by nothing else. Noise of the velocity is K and s + K
in them, a disturbance one and one; noise of what drives adds what a white disturbance does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.errors import EstimationError
from eivor.estimation.fitted_noise import FittedNoise
from eivor.estimation.spectral.noise_fit import NoisePrior, fitted_noise, prior_of, told_noises
from eivor.estimation.spectral.noise_model import NoiseModel, PairedEquations
from eivor.estimation.spectral.pair_spectrum import Pair, PairSpectrum
from eivor.models.separable import SampledState, SeparableProblem, Values
from eivor.models.spectral import BinRows, SpectralRegression
from eivor.shapes import Complex, Float
from eivor.signals.noise import MeasurementNoise, WhiteNoise

#: Frequency that strengths of noises are told at [Hz]; orders say what they are beside it.
TOLD_AT_HZ = 1.0
#: Share of the responses' power that counts as rounding.
ROUNDING = 1e-8


@dataclass(frozen=True)
class PairedBins:
    """Bins of all runs at some parameters.

    Parameters
    ----------
    layout : BinRows
        The runs.
    theta : ndarray, shape (n,)
        Linear parameters.
    state : SampledState
        Whose derivative was measured.
    least : float
        Power of a residual below which it counts as rounding.
    """

    layout: BinRows
    theta: Float[np.ndarray, " n"]
    state: SampledState
    least: float = 0.0

    @cached_property
    def frequency_hz(self) -> Float[np.ndarray, " bins"]:
        """Frequency of each bin [Hz]."""
        return np.concatenate([run.frequency_hz for run in self.layout.runs])

    @cached_property
    def step_s(self) -> Float[np.ndarray, " bins"]:
        """Time between samples of each bin's run [s]."""
        return np.concatenate([np.full(run.count, run.step_s) for run in self.layout.runs])

    @cached_property
    def log_scale(self) -> Float[np.ndarray, " bins"]:
        """Logarithm of a difference's gain over that at `TOLD_AT_HZ`."""
        gain: Float[np.ndarray, " bins"] = np.log(
            np.sin(np.pi * self.frequency_hz * self.step_s) / np.sin(np.pi * TOLD_AT_HZ * self.step_s)
        )
        return gain

    def shapes(self) -> tuple[PairSpectrum, PairSpectrum, PairSpectrum, PairSpectrum]:
        """C of what drives, of the state, of the response, and of a disturbance: one unit of noise each."""
        ones, K = np.ones(self.frequency_hz.size), float(self.theta[self.state.place])
        moved = 2j / self.step_s * np.tan(np.pi * self.frequency_hz * self.step_s) + K
        driven = float(np.sum((self.theta * self.state.driven_density) ** 2)) * ones
        return (
            PairSpectrum(driven + self.least, driven + self.least, driven.astype(complex)),
            PairSpectrum(K * K * ones, np.abs(moved) ** 2, K * moved.conj()),
            PairSpectrum(ones, 0.0 * ones, 0.0j * ones),
            PairSpectrum(ones, ones, ones.astype(complex)),
        )

    @cached_property
    def density_scale(self) -> Float[np.ndarray, " bins"]:
        """Power per Hz, of both signs of frequency together, over a bin's: 2 T over what tapers leave."""
        runs = self.layout.runs
        scale: Float[np.ndarray, " bins"] = np.concatenate(
            [np.full(run.count, 2.0 * run.step_s / np.mean(run.taper**2)) for run in runs]
        )
        return scale

    def residual(self, bins: SpectralRegression) -> Pair:
        """r_1 and r_2, per root of Hz."""
        found = responses(bins) - (bins.regressors @ self.theta)[:, None]
        scaled: Pair = found.T * np.sqrt(self.density_scale)
        return scaled

    def fitted(self, bins: SpectralRegression) -> NoiseModel:
        """Noises that fit the residuals, declared ones as they are."""
        pairs, residual, prior = self._fit(bins)
        return fitted_noise(pairs, residual, prior.centre, prior)

    def told(self, bins: SpectralRegression) -> tuple[FittedNoise, ...]:
        """The same with their errors; strengths are amplitude densities at `TOLD_AT_HZ`."""
        pairs, residual, prior = self._fit(bins)
        model = fitted_noise(pairs, residual, prior.centre, prior)
        return told_noises(pairs, residual, model, prior, f"per root of Hz, at {TOLD_AT_HZ:g} Hz")

    def _fit(self, bins: SpectralRegression) -> tuple[PairedEquations, Pair, NoisePrior]:
        order = np.argsort(self.frequency_hz, kind="stable")
        pairs, residual = _Sorted(self, order), self.residual(bins)[:, order]
        declared = (_declared(self.state.state_density), _declared(self.state.response_density))
        return pairs, residual, prior_of(pairs, residual, 1.0, declared, disturbance_order=None)


@dataclass(frozen=True)
class _Sorted:
    """Paired bins in the order of their frequencies, whatever their run."""

    pairs: PairedBins
    order: np.ndarray

    @property
    def log_scale(self) -> Float[np.ndarray, " bins"]:
        return self.pairs.log_scale[self.order]

    def shapes(self) -> tuple[PairSpectrum, PairSpectrum, PairSpectrum, PairSpectrum]:
        one, two, three, four = (
            PairSpectrum(each.first[self.order], each.second[self.order], each.cross[self.order])
            for each in self.pairs.shapes()
        )
        return one, two, three, four


def _declared(density: float) -> MeasurementNoise | None:
    return None if np.isnan(density) else WhiteNoise(density)


def responses(bins: SpectralRegression) -> Complex[np.ndarray, "bins 2"]:
    """A and s v: central differences of v, over cos^2(pi f T)."""
    quarter = [np.cos(np.pi * run.frequency_hz * run.step_s) for run in bins.layout.runs]
    return np.column_stack([bins.responses[:, 0], bins.responses[:, -1] / np.concatenate(quarter) ** 2])


def paired_bins(problem: SeparableProblem, theta: Float[np.ndarray, " n"], at: Values) -> PairedBins:
    """Bins of a problem at some parameters.

    Raises
    ------
    EstimationError
        When its motion has no state whose derivative was measured.
    """
    state = problem.sampled_state(at)
    if state is None:
        raise EstimationError(
            "a motion whose state and its derivative were both measured, for a spectral method",
            "one of them alone",
            "Log the accelerometer and the velocity, or use reference_iv.",
        )
    bins = problem.bins(at)
    pairs = PairedBins(bins.layout, theta, state)
    power = np.abs(bins.responses[:, 0]) ** 2 * pairs.density_scale
    return replace(pairs, least=ROUNDING * float(np.median(power)))
