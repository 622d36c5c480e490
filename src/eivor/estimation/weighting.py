"""Weights of rows and of equations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from eivor import checks
from eivor.errors import InstrumentError, NoUniqueSolutionError, TooFewSamplesError, UsageError
from eivor.estimation.moments import CrossMoments, Moments
from eivor.inference.covariance import Bartlett, kernel_sum_covariance, newey_west_bandwidth, unit_scale
from eivor.inference.diagnostics.record import orthonormal_basis
from eivor.linalg.system import LinearSystem
from eivor.models.regression import LinearProblem, Regression
from eivor.models.separable import SeparableProblem, Values, values_of
from eivor.models.spectral import BinRows, SpectralRegression
from eivor.tools import Complex, Float, Int

Vector = Float[np.ndarray, " n"]
PerBin = Float[np.ndarray, " bins"]

#: Equations after weighting, L^-1 A theta = L^-1 b, and the lower triangular L; None without a weight.
Weighted = tuple[LinearSystem, Float[np.ndarray, "p p"] | None]


class EquationWeighting(ABC):
    """A way to weight equations."""

    passes = 1  # Number of times the estimate is made; weights are renewed between passes

    @abstractmethod
    def equations(
        self, system: LinearSystem, moments: Moments, problem: LinearProblem | None, theta: Vector | None, /
    ) -> Weighted:
        """Equations weighted for the first pass, or by the residuals of the pass before, at its theta."""


@dataclass(frozen=True, slots=True)
class Unweighted(EquationWeighting):
    """Every equation with weight one, as in the paper's (24) and (30)."""

    def equations(self, system: LinearSystem, *_: object) -> Weighted:
        return system, None


@dataclass(frozen=True, slots=True)
class TwoStage(EquationWeighting):
    """Weight by the inverse of mean(psi psi'): two-stage least squares, efficient for white errors."""

    def equations(self, system: LinearSystem, moments: Moments, *_: object) -> Weighted:
        L = weight_factor(_cross_moments(moments).instruments)
        return divided(system, L), L


def _cross_moments(moments: Moments) -> CrossMoments:
    if not isinstance(moments, CrossMoments):
        remedy = "Two-stage weighting goes with an instrumental assembler; make the moments with its method."
        raise UsageError("moments with the instruments' own products", type(moments).__name__, remedy)
    return moments


@dataclass(frozen=True, slots=True)
class TwoStepRobust(EquationWeighting):
    """Two-stage first, then weight by the covariance of the equations at its residuals: two-step GMM."""

    bandwidth: int | None = None  # Lags of the Bartlett kernel. Default: 4 (N/100)^(2/9) (Newey and West)
    passes = 2

    def __post_init__(self) -> None:
        if self.bandwidth is not None:
            expected = "a bandwidth of zero or more lags"
            checks.counted("bandwidth", self.bandwidth, 0, expected, "Zero sees no lag.")

    def equations(
        self, system: LinearSystem, moments: Moments, problem: LinearProblem | None, theta: Vector | None, /
    ) -> Weighted:
        """Two-stage without theta; with it, divided by the Cholesky factor of the scores' covariance."""
        if theta is None:
            return TwoStage().equations(system, moments)
        if problem is None:
            remedy = "Use two-stage weighting for data that do not fit in memory."
            raise UsageError("the rows themselves for a robust weighting", "moments only", remedy)
        rows = problem.rows()
        scores = rows.instruments * (rows.response - rows.regressors @ theta)[:, None]
        if isinstance(moments, CrossMoments):
            scores = scores + moments.shared_noise(theta)
        lags = newey_west_bandwidth(rows.response.size) if self.bandwidth is None else self.bandwidth
        covariance = kernel_sum_covariance([scores], len(scores), Bartlett(), float(lags))
        L = weight_factor(covariance / len(scores))
        return divided(system, L), L


def weight_factor(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Cholesky factor of a covariance of equations, by which they are divided."""
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale) if scale.all() else np.zeros_like(covariance)
    eigenvalues = np.linalg.eigvalsh(correlation)
    if eigenvalues[0] <= covariance.shape[0] * np.finfo(np.float64).eps * max(eigenvalues[-1], 0.0):
        expected = "linearly independent instruments"
        received = f"instruments of which one is a combination of the others (eigenvalues {eigenvalues})"
        raise InstrumentError(expected, received, "Remove one, or use an unweighted instrumental method.")
    return scale[:, None] * np.linalg.cholesky(correlation)


def divided(system: LinearSystem, L: Float[np.ndarray, "p p"]) -> LinearSystem:
    """L^-1 A theta = L^-1 b."""
    stacked = np.column_stack([system.matrix, system.right])
    both = scipy.linalg.solve_triangular(L, stacked, lower=True)
    return LinearSystem(both[:, :-1], both[:, -1])


#: Columns of which the instruments leave less than this share have no error but rounding.
EXACT = 1e-12


@dataclass(frozen=True, slots=True)
class LimitedInformation(EquationWeighting):
    """Two-stage weights, and the columns' errors for a solver that takes them into account."""

    def equations(self, system: LinearSystem, moments: Moments, *_: object) -> Weighted:
        moments = _cross_moments(moments)
        L, columns = weight_factor(moments.instruments), moments.columns
        instruments = L.shape[0]
        if moments.rows <= instruments:
            expected = f"more rows than the {instruments} instruments, for what they leave of the columns"
            remedy = "Give a longer record, or fewer instruments."
            raise TooFewSamplesError(expected, f"{moments.rows:g}", remedy)
        # S: what the instruments leave of the columns' products, without the rounding of columns they span
        projected = scipy.linalg.solve_triangular(L, moments.equations, lower=True)
        S = columns - projected.T @ projected
        exact = np.diag(S) <= EXACT * np.diag(columns)
        S[exact] = 0.0
        S[:, exact] = 0.0
        noisy = np.ix_(~exact, ~exact)
        scale = unit_scale(np.diag(S)[~exact])
        if not exact.all() and np.linalg.eigvalsh(np.outer(scale, scale) * S[noisy])[0] <= EXACT:
            expected = "equations with an error, of which a least one can be found"
            received = "a response that is a combination of regressors and instruments but for rounding"
            remedy = "Use extended_iv or generalized_iv: of exact data they give the exact answer."
            raise NoUniqueSolutionError(expected, received, remedy)
        weighted = replace(divided(system, L), error_covariance=S, error_degrees=moments.rows - instruments)
        return weighted, L


@dataclass(frozen=True, slots=True)
class WeightedRows:
    """A problem's rows with weights of one pass: rows in time, as they are."""

    problem: SeparableProblem
    renewals: int  # Passes that follow

    def rows(self, nuisances: Values) -> Regression:
        return self.problem.rows(nuisances)

    def products(self, points: Sequence[Values]) -> Float[np.ndarray, "points p n_plus_1"]:
        """Mean of psi [phi' y] at many values of the nuisances."""
        weighted = (self.rows(point) for point in points)
        columns = ((rows, np.column_stack([rows.regressors, rows.response])) for rows in weighted)
        return np.stack([rows.instruments.T @ data / rows.response.size for rows, data in columns])

    def criterion(self, _theta: Vector, _nuisances: Values, /) -> float | None:
        """Criterion of candidates, where weights give a better one than the estimate; by default None."""
        return None

    def renewed(self, _theta: Vector, _nuisances: Values, /) -> WeightedRows:
        """Rows of the next pass, from an estimate."""
        return self


class RowWeighting(ABC):
    """A way to weight rows."""

    needs_spectra = True  # Whether rows must be bins of spectra, which plain regressions do not have

    @abstractmethod
    def first_pass(self, problem: SeparableProblem) -> WeightedRows:
        """Rows weighted before anything is known."""

    @abstractmethod
    def last_pass(self, problem: SeparableProblem, theta: Vector, nuisances: Values, /) -> WeightedRows:
        """Rows weighted by the residuals of an estimate, for good."""


@dataclass(frozen=True, slots=True)
class EqualRows(RowWeighting):
    """Every row in time with weight one."""

    needs_spectra = False

    def first_pass(self, problem: SeparableProblem) -> WeightedRows:
        return WeightedRows(problem, 0)

    def last_pass(self, problem: SeparableProblem, *_: object) -> WeightedRows:
        return WeightedRows(problem, 0)


#: Weights of spectral rows are renewed so often.
RENEWALS = 2
#: Power never falls below this share of its median, so that no bin takes all the weight.
POWER_FLOOR = 1e-6
#: Most rows of a column over points at once; more would fill the memory.
BATCH_NUMBERS = 4_000_000


#: Places of a run's columns that stay and that move, their Q' [phi y] at some values of the nuisances, and
#: their products with each other: at each of these, or of an interpolation those that move of all nodes.
RunSums = tuple[Int[np.ndarray, " f"], Int[np.ndarray, " m"], Float[np.ndarray, "T q b"], np.ndarray]


@dataclass(frozen=True)
class WhitenedRows(WeightedRows):
    """Blend and power at each bin, and the whitened instruments' orthonormal basis."""

    blend: PerBin
    power: PerBin
    basis: Float[np.ndarray, "rows q"]
    disturbed: float = 0.0

    def rows(self, nuisances: Values) -> Regression:
        whitened = self.problem.bins(nuisances).whitened(self.blend, self.power, self.basis)
        if whitened.regressor_noise is None or not self.disturbed:
            return whitened
        noise = whitened.regressor_noise.copy()
        noise[-1, -1] += self.disturbed
        return replace(whitened, regressor_noise=noise)

    def products(self, points: Sequence[Values]) -> Float[np.ndarray, "points p n_plus_1"]:
        interpolation = self.problem.interpolation
        if interpolation is None:
            return self._products(points)
        return np.tensordot(interpolation.weights(values_of(points)), self._node_products, 1)

    @cached_property
    def _node_products(self) -> Float[np.ndarray, "nodes p n_plus_1"]:
        interpolation = self.problem.interpolation
        return self._products([] if interpolation is None else interpolation.points)

    def _products(self, points: Sequence[Values]) -> Float[np.ndarray, "points p n_plus_1"]:
        size = max(BATCH_NUMBERS // self.basis.shape[0], 1)
        if len(points) > size:
            parts = (points[first : first + size] for first in range(0, len(points), size))
            return np.concatenate([self._products(part) for part in parts])
        products = [self._run_products(len(points), *run) for run in self._runs(points, self.basis)]
        return np.asarray(sum(products) / self.basis.shape[0])

    @staticmethod
    def _run_products(
        points: int, psi: np.ndarray, fixed: np.ndarray, still: np.ndarray, moving: np.ndarray, X: np.ndarray
    ) -> Float[np.ndarray, "points q n_plus_1"]:
        E = np.zeros((points, psi.shape[1], still[-1] + 1))
        E[:, :, still] = psi.T @ fixed.T
        E[:, :, moving] = (X @ psi).transpose(0, 2, 1)
        return E

    @cached_property
    def _fixed(self) -> tuple[BinRows, Complex[np.ndarray, "f_plus_1 bins"], Int[np.ndarray, " f_plus_1"]]:
        """Whitened bins of the fixed columns and of the response, and their places."""
        bins, still = self.problem.bins(self.problem.first_values), self.problem.still
        response = (1.0 - self.blend) * bins.responses[:, 0] + self.blend * bins.responses[:, -1]
        fixed = np.column_stack([bins.regressors[:, :still], response]).T / np.sqrt(self.power)
        return bins.layout, fixed, np.append(np.arange(still), bins.regressors.shape[1])

    def _runs(self, points: Sequence[Values], basis: Float[np.ndarray, "rows q"]) -> Iterator[Any]:
        """Rows of Q of each run, fixed columns and their places, places of moving columns, and these."""
        layout, fixed, still = self._fixed
        start = 0
        for run, (moving, X) in zip(layout.runs, self.problem.moving_columns(points), strict=True):
            here = slice(start, start + run.count)
            known, weight = fixed[:, here], np.tile(1.0 / np.sqrt(self.power[here]), 2)
            rows = slice(2 * here.start, 2 * here.stop)
            yield basis[rows], np.concatenate([known.real, known.imag], axis=1), still, moving, X * weight
            start = here.stop

    def sums(self, points: Sequence[Values], basis: Float[np.ndarray, "rows q"]) -> Iterator[RunSums]:
        """Products of each run at some values of the nuisances."""
        joint, size = self.problem.interpolation is not None, max(BATCH_NUMBERS // self.basis.shape[0], 1)
        if not joint and len(points) > size:
            parts = (points[first : first + size] for first in range(0, len(points), size))
            for run in zip(*[list(self.sums(part, basis)) for part in parts], strict=True):  # one by one
                still, moving, *products = zip(*run, strict=True)
                yield still[0], moving[0], *map(np.concatenate, products)
            return
        for psi, fixed, still, moving, X in self._runs(points, basis):
            E = self._run_products(len(points), psi, fixed, still, moving, X)
            stacked = X.reshape(X.shape[0] * X.shape[1], X.shape[2]) if joint else X  # runs may have no bins
            count, cross = len(fixed), stacked @ fixed.T
            power = np.empty((*stacked.shape[:-2], *2 * (count + stacked.shape[-2],)))
            power[..., :count, :count] = fixed @ fixed.T
            power[..., count:, count:] = stacked @ stacked.swapaxes(-1, -2)
            power[..., count:, :count], power[..., :count, count:] = cross, cross.swapaxes(-1, -2)
            yield still, moving, E, power

    def renewed(self, theta: Vector, nuisances: Values, /) -> WhitenedRows:
        return replace(whitened_by_residuals(self.problem, theta, nuisances), renewals=self.renewals - 1)


@dataclass(frozen=True, slots=True)
class SpectralWhitening(RowWeighting):
    """Blend two responses and whiten all columns, with orthonormal instruments (so two-stage as well)."""

    def first_pass(self, problem: SeparableProblem) -> WhitenedRows:
        bins = problem.bins(problem.first_values)
        count = bins.responses.shape[0]
        return _whitened(problem, bins, np.full(count, 0.5), np.ones(count), RENEWALS)

    def last_pass(self, problem: SeparableProblem, theta: Vector, nuisances: Values, /) -> WhitenedRows:
        return whitened_by_residuals(problem, theta, nuisances)


def whitened_by_residuals(problem: SeparableProblem, theta: Vector, nuisances: Values) -> WhitenedRows:
    """Rows with blend and power from the residuals of an estimate, run by run; final weights."""
    bins = problem.bins(nuisances)
    whitened = _whitened(problem, bins, *residual_spectrum(bins, bins.residuals(theta)))
    rows = whitened.rows(nuisances)
    if rows.regressor_noise is None:
        return whitened
    # variance of residuals that no known noise explains: the response answers more than the columns
    residual, signs = rows.response - rows.regressors @ theta, np.append(theta, -1.0)
    unexplained = float(np.mean(residual**2) - signs @ rows.regressor_noise @ signs)
    return replace(whitened, disturbed=max(unexplained, 0.0))


def residual_spectrum(
    bins: SpectralRegression, residuals: Complex[np.ndarray, "bins r"]
) -> tuple[PerBin, PerBin]:
    """Blend q and power S at each bin, smoothed within each run."""
    first, last = residuals[:, 0], residuals[:, -1]
    powers = np.column_stack([np.abs(first) ** 2, np.abs(last) ** 2, (first * last.conj()).real])
    S11, S22, S12 = bins.layout.smoothed(powers).T
    spread = S11 + S22 - 2.0 * S12
    blend = np.divide(S11 - S12, spread, out=np.full_like(S11, 0.5), where=spread > 0.0)
    blend = np.clip(blend, 0.0, 1.0)
    power = bins.layout.smoothed((np.abs((1.0 - blend) * first + blend * last) ** 2)[:, None])[:, 0]
    for S in np.split(power, bins.layout.ends):
        np.maximum(S, POWER_FLOOR * float(np.median(S)) if S.size else 0.0, out=S)
    if not power.all():
        power = np.where(power > 0.0, power, max(float(power.max()), 1.0) * POWER_FLOOR)
    return blend, power


def _whitened(
    problem: SeparableProblem, bins: SpectralRegression, blend: PerBin, power: PerBin, renewals: int = 0
) -> WhitenedRows:
    instruments = bins.layout.stacked(bins.instruments / np.sqrt(power)[:, None])
    return WhitenedRows(problem, renewals, blend, power, orthonormal_basis(instruments))
