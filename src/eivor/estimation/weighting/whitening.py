"""Spectral whitening: rows in frequency, divided by the residual's own spectrum.

Two residuals are at hand, E1 of the first candidate response (an accelerometer's) and E2 of the second (a
differentiated velocity's). In each run, which is of one flight and one axis, and
around each frequency their powers S11, S22 and cross-power S12 (means over the bins within +-30 %) give
the blend q = (S11 - Re S12) / (S11 + S22 - 2 Re S12), cut to [0, 1], with the least power, and the power
S of the blended residual, by whose root every column is divided. It acts as a complementary filter that
finds its own crossover, and removes fractional noise of any order without being told the order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eivor.estimation.weighting.rows import RowWeighting, WeightedRows
from eivor.inference.diagnostics.instrument_tests import orthonormal_basis
from eivor.models.regression import Regression
from eivor.models.separable import SeparableProblem, Values
from eivor.models.spectral import SpectralRegression
from eivor.shapes import Complex, Float

#: Power never falls below this share of its median, so that no bin takes all the weight.
POWER_FLOOR = 1e-6


@dataclass(frozen=True, slots=True)
class WhitenedRows(WeightedRows):
    """Blend and power at each bin, and the whitened instruments' orthonormal basis.

    Parameters
    ----------
    problem : SeparableProblem
        Whose bins.
    blend, power : ndarray, shape (bins,)
        q and S.
    basis : ndarray, shape (rows, q)
        Of the instruments divided by sqrt(S).
    renewals : int
        Passes that follow.
    disturbed : float
        Variance of the response's error in a row beside the noise that is known of it.
    """

    problem: SeparableProblem
    blend: Float[np.ndarray, " bins"]
    power: Float[np.ndarray, " bins"]
    basis: Float[np.ndarray, "rows q"]
    renewals: int = 0
    disturbed: float = 0.0

    def rows(self, at: Values) -> Regression:
        """Whitened rows."""
        found = self.problem.bins(at).whitened(self.blend, self.power, self.basis)
        if found.regressor_noise is None or not self.disturbed:
            return found
        noise = found.regressor_noise.copy()
        noise[-1, -1] += self.disturbed
        return replace(found, regressor_noise=noise)

    def products(self, points: Sequence[Values]) -> Float[np.ndarray, "points p n_plus_1"]:
        """Mean of psi [phi' y] at many values of the nuisances, all of them multiplied at once."""
        rows = self._side_by_side(points)
        return _apart(self.basis.T @ rows / rows.shape[0], len(points))

    def columns(self, points: Sequence[Values]) -> Float[np.ndarray, "points rows n_plus_1"]:
        """Whitened rows of [phi y] at many values of the nuisances."""
        return _apart(self._side_by_side(points), len(points))

    def _side_by_side(self, points: Sequence[Values]) -> Float[np.ndarray, "rows columns"]:
        """Whitened rows: the response, and the regressors of one point after the other."""
        moved = self.problem.many_bins(points)
        return moved[0].whitened_rows(self.blend, self.power, np.column_stack([b.regressors for b in moved]))

    @property
    def renewal(self) -> Callable[[Float[np.ndarray, " n"], Values], WhitenedRows] | None:
        """Whitening by the residuals, while there are passes to follow."""
        return self._renewed if self.renewals else None

    def _renewed(self, theta: Float[np.ndarray, " n"], at: Values) -> WhitenedRows:
        return replace(whitened_by_residuals(self.problem, theta, at), renewals=self.renewals - 1)


def _apart(rows: Float[np.ndarray, "rows columns"], points: int) -> Float[np.ndarray, "points rows k"]:
    """[phi y] of each point, from the response and the regressors of all of them side by side."""
    response = np.broadcast_to(rows[:, :1], (points, rows.shape[0], 1))
    regressors = rows[:, 1:].reshape(rows.shape[0], points, -1).transpose(1, 0, 2)
    return np.concatenate([regressors, response], axis=2)


@dataclass(frozen=True, slots=True)
class SpectralWhitening(RowWeighting):
    """Blend two responses and whiten all columns, with orthonormal instruments (so two-stage as well).

    Parameters
    ----------
    passes : int
        Estimates made; the first with equal blend and flat power.
    """

    passes: int = 3

    @property
    def needs_spectra(self) -> bool:
        """Yes."""
        return True

    def first_pass(self, problem: SeparableProblem) -> WhitenedRows:
        """Equal blend, flat power."""
        bins = problem.bins(problem.first_values)
        count = bins.responses.shape[0]
        return _whitened(problem, bins, (np.full(count, 0.5), np.ones(count)), self.passes - 1)

    def last_pass(
        self, problem: SeparableProblem, theta: Float[np.ndarray, " n"], at: Values, /
    ) -> WhitenedRows:
        """See `whitened_by_residuals`."""
        return whitened_by_residuals(problem, theta, at)


def whitened_by_residuals(
    problem: SeparableProblem, theta: Float[np.ndarray, " n"], at: Values
) -> WhitenedRows:
    """Rows with blend and power from the residuals of an estimate, run by run; final weights."""
    bins = problem.bins(at)
    found = _whitened(problem, bins, residual_spectrum(bins, bins.residuals(theta)), 0)
    return replace(found, disturbed=_disturbed(found.rows(at), theta))


def _disturbed(rows: Regression, theta: Float[np.ndarray, " n"]) -> float:
    """Variance of residuals that no known noise explains: the response answers more than the columns."""
    if rows.regressor_noise is None:
        return 0.0
    residual, signs = rows.response - rows.regressors @ theta, np.append(theta, -1.0)
    return max(float(np.mean(residual**2) - signs @ rows.regressor_noise @ signs), 0.0)


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


def _whitened(
    problem: SeparableProblem,
    bins: SpectralRegression,
    weights: tuple[Float[np.ndarray, " bins"], Float[np.ndarray, " bins"]],
    renewals: int,
) -> WhitenedRows:
    blend, power = weights
    instruments = bins.layout.stacked(bins.instruments / np.sqrt(power)[:, None])
    return WhitenedRows(problem, blend, power, orthonormal_basis(instruments), renewals)
