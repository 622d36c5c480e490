"""Spectral whitening: rows in frequency, divided by the residual's own spectrum.

Two residuals are at hand, E1 of the accelerometer and E2 of the differentiated velocity. In each run and
around each frequency their powers S11, S22 and cross-power S12 (means over the bins within +-30 %) give
the blend q = (S11 - Re S12) / (S11 + S22 - 2 Re S12), cut to [0, 1], with the least power, and the power
S of the blended residual, by whose root every column is divided. It acts as a complementary filter that
finds its own crossover, and removes fractional noise of any order without being told the order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from eivor.errors import UsageError
from eivor.estimation.weighting import UnweightedEquations, WeightedEquations, Weighting, Weights
from eivor.inference.diagnostics.instrument_tests import orthonormal_basis
from eivor.models.regression import Regression
from eivor.models.separable import SeparableProblem
from eivor.models.spectral import BinRows, SpectralRegression

#: Power never falls below this share of its median, so that no bin takes all the weight.
POWER_FLOOR = 1e-6


@dataclass(frozen=True, slots=True)
class SpectralWeights(Weights):
    """Blend and power at each bin, and the whitened instruments' orthonormal basis.

    Parameters
    ----------
    blend, power : ndarray, shape (bins,)
        q and S.
    basis : ndarray, shape (rows, q)
        Of the instruments divided by sqrt(S).
    """

    blend: Float[np.ndarray, " bins"]
    power: Float[np.ndarray, " bins"]
    basis: Float[np.ndarray, "rows q"]

    def regression(self, problem: SeparableProblem, lag_s: float, delay_s: float) -> Regression:
        """Whitened rows."""
        return problem.bins(lag_s, delay_s).whitened(self.blend, self.power, self.basis)


@dataclass(frozen=True, slots=True)
class SpectralWhitening(Weighting):
    """Blend two responses and whiten all columns, with orthonormal instruments (so two-stage as well).

    Parameters
    ----------
    passes : int
        Estimates made; the first with equal blend and flat power.
    """

    passes: int = 3

    @property
    def needs_instrument_products(self) -> bool:
        """No: the instruments are made orthonormal."""
        return False

    def start(self, problem: SeparableProblem) -> Weights:
        """Equal blend, flat power."""
        bins = problem.bins(float(problem.lag_grid_s[0]), problem.delays_s[0])
        count = bins.responses.shape[0]
        return _weights(bins, np.full(count, 0.5), np.ones(count))

    def renewed(
        self,
        weights: Weights,  # noqa: ARG002 - the interface's
        problem: SeparableProblem,
        theta: Float[np.ndarray, " n"],
        lag_s: float,
        delay_s: float,
    ) -> Weights:
        """Blend and power from the residuals, run by run."""
        bins = problem.bins(lag_s, delay_s)
        blend, power = residual_spectrum(bins, bins.residuals(theta))
        return _weights(bins, blend, power)

    def equations(self, at: UnweightedEquations) -> WeightedEquations:
        """Return the equations of whitened rows; raise for plain rows, which have no spectra.

        Raises
        ------
        UsageError
            When the rows were not whitened before.
        """
        if at.problem is None or not isinstance(at.problem.rows().layout, BinRows):
            raise UsageError(
                "a flight, whose runs have spectra, for a method with spectral whitening",
                "a regression of plain rows",
                "Use identify_flight, or another method.",
            )
        return WeightedEquations(at.system)


def residual_spectrum(
    bins: SpectralRegression, residuals: Complex[np.ndarray, "bins r"]
) -> tuple[Float[np.ndarray, " bins"], Float[np.ndarray, " bins"]]:
    """Blend q and power S at each bin, smoothed within each run."""
    first, last = residuals[:, 0], residuals[:, -1]
    powers = np.column_stack([np.abs(first) ** 2, np.abs(last) ** 2, (first * last.conj()).real])
    blend, power = np.empty(powers.shape[0]), np.empty(powers.shape[0])
    start = 0
    for run in bins.layout.runs:
        here = slice(start, start + run.count)
        S11, S22, S12 = run.smoothed(powers[here]).T
        spread = S11 + S22 - 2.0 * S12
        q = np.clip(np.divide(S11 - S12, spread, out=np.full_like(S11, 0.5), where=spread > 0.0), 0.0, 1.0)
        blended = np.abs((1.0 - q) * first[here] + q * last[here]) ** 2
        S = run.smoothed(blended[:, None])[:, 0]
        blend[here] = q
        power[here] = np.maximum(S, POWER_FLOOR * float(np.median(S)) if S.size else 0.0)
        start += run.count
    if not power.all():
        power = np.where(power > 0.0, power, max(float(power.max()), 1.0) * POWER_FLOOR)
    return blend, power


def _weights(
    bins: SpectralRegression, blend: Float[np.ndarray, " bins"], power: Float[np.ndarray, " bins"]
) -> SpectralWeights:
    whitened = bins.layout.stacked(bins.instruments / np.sqrt(power)[:, None])
    return SpectralWeights(blend, power, orthonormal_basis(whitened))
