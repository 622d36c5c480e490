r"""Rows of flights, both equations combined by the spectrum of what they leave.

Where both residuals have the same parameters, what tells these of the pair is

    1^H C^-1 [a; s v] / 1^H C^-1 1    against    x theta,    with the power    S = 1 / 1^H C^-1 1,

and its rows over the root of S are those of the likelihood; what is left of the pair tells C alone.
Instruments, over the same root, are those of the least variance in what they span when the equations are
solved in two stages.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eivor.estimation.spectral.pair_spectrum import Pair, PairSpectrum, inner
from eivor.estimation.spectral.paired_bins import paired_bins, responses
from eivor.estimation.spectral.weights import IDENTITY, held_back, recoloured, shrunk
from eivor.estimation.weighting.rows import RowWeighting, WeightedRows
from eivor.estimation.weighting.whitening import POWER_FLOOR, WhitenedRows
from eivor.inference.diagnostics.instrument_tests import orthonormal_basis
from eivor.models.regression import Regression
from eivor.models.separable import Nuisance, SeparableProblem, Values
from eivor.models.spectral import BinRows, SpectralRegression
from eivor.shapes import Complex, Float


@dataclass(frozen=True)
class CombinedProblem(SeparableProblem):
    """A problem whose candidates for the response are combined, with weights of each bin.

    Parameters
    ----------
    problem : SeparableProblem
        With two candidates.
    weights : ndarray of complex, shape (bins, 2)
        Of both.
    """

    problem: SeparableProblem
    weights: Complex[np.ndarray, "bins 2"]
    nuisances: tuple[Nuisance, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "nuisances", self.problem.nuisances)

    def rows(self, at: Values) -> Regression:
        """Rows in time, of the problem itself."""
        return self.problem.rows(at)

    def bins(self, at: Values) -> SpectralRegression:
        """Rows in frequency with one response."""
        bins = self.problem.bins(at)
        combined = (responses(bins) * self.weights).sum(axis=1, keepdims=True)
        return replace(bins, responses=combined)


class PairSpectra(ABC):
    """What rows are weighted by, from a noise model that was fitted to residuals."""

    @abstractmethod
    def weights(
        self, model: PairSpectrum, residual: Pair, layout: BinRows, /
    ) -> tuple[PairSpectrum, Float[np.ndarray, " bins"]]:
        """C, and a factor that holds back residuals far out."""

    def criterion(self, _C: PairSpectrum, _residual: Pair, /) -> float | None:
        """What candidates are compared by; by default None, so that equations are."""
        return None


@dataclass(frozen=True, slots=True)
class ModelledSpectra(PairSpectra):
    """The model as it is, of the likelihood."""

    def weights(
        self, model: PairSpectrum, residual: Pair, _layout: BinRows, /
    ) -> tuple[PairSpectrum, Float[np.ndarray, " bins"]]:
        """The model, and ones."""
        return model, np.ones(residual.shape[1])

    def criterion(self, C: PairSpectrum, residual: Pair, /) -> float:
        """Twice the sum of log det C + r^H C^-1 r, minus twice the logarithm of the likelihood."""
        return 2.0 * float((np.log(C.determinant) + inner(residual, C.solved(residual)).real).sum())


@dataclass(frozen=True, slots=True)
class CorrectedSpectra(PairSpectra):
    """The model corrected by the residuals' own periodogram: a wrong model costs efficiency alone."""

    def weights(
        self, model: PairSpectrum, residual: Pair, layout: BinRows, /
    ) -> tuple[PairSpectrum, Float[np.ndarray, " bins"]]:
        """The corrected model, and min(1, 12 / r^H C^-1 r)."""
        white = model.whitened(residual)
        across = white[0] * white[1].conj()
        products = np.stack([np.abs(white[0]) ** 2, np.abs(white[1]) ** 2, across.real, across.imag], axis=1)
        found, first = np.empty_like(products), 0
        for run in layout.runs:
            here, count = slice(first, first + run.count), run.smoothed_over
            means = run.smoothed(products[here])
            found[here, :2] = shrunk(means[:, :2], count)
            found[here, 2:] = means[:, 2:] * (count / (count + IDENTITY))[:, None]
            first += run.count
        C = recoloured(model, found[:, 0], found[:, 1], found[:, 2] + 1j * found[:, 3])
        return C, held_back(residual, C)


@dataclass(frozen=True)
class PairRows(WeightedRows):
    """Rows of one pass.

    Parameters
    ----------
    problem : SeparableProblem
        Whose bins.
    spectra : PairSpectra
        What the next pass weights by.
    C : PairSpectrum
        What this one weights by.
    white : WhitenedRows
        The combined and whitened rows.
    renewals : int
        Passes that follow.
    """

    problem: SeparableProblem
    spectra: PairSpectra
    C: PairSpectrum
    white: WhitenedRows
    renewals: int

    def rows(self, at: Values) -> Regression:
        """Combined and whitened rows."""
        return self.white.rows(at)

    def products(self, points: Sequence[Values]) -> Float[np.ndarray, "points p n_plus_1"]:
        """Mean of psi [phi' y] at many values of the nuisances."""
        return self.white.products(points)

    def columns(self, points: Sequence[Values]) -> Float[np.ndarray, "points rows n_plus_1"]:
        """Combined and whitened rows of [phi y] at many values of the nuisances."""
        return self.white.columns(points)

    def criterion(self, theta: Float[np.ndarray, " n"], at: Values, /) -> float | None:
        """The spectra's, at some parameters."""
        residual = paired_bins(self.problem, theta, at).residual(self.problem.bins(at))
        return self.spectra.criterion(self.C, residual)

    @property
    def renewal(self) -> Callable[[Float[np.ndarray, " n"], Values], PairRows] | None:
        """Weights by the residuals, while there are passes to follow."""
        return self._renewed if self.renewals else None

    def _renewed(self, theta: Float[np.ndarray, " n"], at: Values) -> PairRows:
        return _by_residuals(self.problem, self.spectra, theta, at, self.renewals - 1)


def _by_residuals(
    problem: SeparableProblem, spectra: PairSpectra, theta: Float[np.ndarray, " n"], at: Values, renewals: int
) -> PairRows:
    pairs, bins = paired_bins(problem, theta, at), problem.bins(at)
    model = pairs.fitted(bins).spectrum(pairs)
    C, factor = spectra.weights(model, pairs.residual(bins), pairs.layout)
    return _weighted(problem, bins, spectra, (C, factor * pairs.density_scale), renewals)


def _weighted(
    problem: SeparableProblem,
    bins: SpectralRegression,
    spectra: PairSpectra,
    weights: tuple[PairSpectrum, Float[np.ndarray, " bins"]],
    renewals: int,
) -> PairRows:
    C, factor = weights
    spread = np.maximum(C.first + C.second - 2.0 * C.cross.real, np.finfo(np.float64).tiny)
    shares = np.stack([C.second - C.cross.conj(), C.first - C.cross], axis=1) / spread[:, None]
    power = np.maximum(C.determinant, 0.0) / spread
    power = np.maximum(power, POWER_FLOOR * float(np.median(power))) / factor
    instruments = orthonormal_basis(bins.layout.stacked(bins.instruments / np.sqrt(power)[:, None]))
    combined = CombinedProblem(problem, shares)
    return PairRows(
        problem, spectra, C, WhitenedRows(combined, np.zeros(power.size), power, instruments), renewals
    )


@dataclass(frozen=True, slots=True)
class PairWhitening(RowWeighting):
    """Combine both equations of a sampled state by the spectrum of what they leave.

    Parameters
    ----------
    spectra : PairSpectra
        What rows are weighted by.
    passes : int
        Estimates made; the first with both equations alike and flat power.
    """

    spectra: PairSpectra
    passes: int = 3

    @property
    def needs_spectra(self) -> bool:
        """Yes."""
        return True

    def first_pass(self, problem: SeparableProblem) -> PairRows:
        """Both alike, flat power.

        Raises
        ------
        EstimationError
            When the problem has no state whose derivative was measured.
        """
        at = problem.first_values
        bins = problem.bins(at)
        paired_bins(problem, np.zeros(bins.regressors.shape[1]), at)
        ones = np.ones(bins.responses.shape[0])
        alike = PairSpectrum(ones, ones, 0.0j * ones)
        return _weighted(problem, bins, self.spectra, (alike, ones), self.passes - 1)

    def last_pass(self, problem: SeparableProblem, theta: Float[np.ndarray, " n"], at: Values, /) -> PairRows:
        """By the residuals of an estimate."""
        return _by_residuals(problem, self.spectra, theta, at, 0)
