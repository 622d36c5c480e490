"""Weightings: from a problem and the current estimate to the rows that the assembler sees.

A weighting makes `Weights` out of the problem and, pass by pass, out of the residuals; weights turn the
problem at any lag and delay into a `Regression`. The weights do not depend on the nuisance, so a whole
search over lags shares them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.models.regression import Regression
from eivor.models.separable import SeparableProblem

#: Directions of the unit-length instruments with smaller singular values are noise and are dropped.
SMALLEST_DIRECTION = 1e-4


class Weights(ABC):
    """Weights at one estimate."""

    @abstractmethod
    def regression(self, problem: SeparableProblem, lag_s: float, delay_s: float) -> Regression:
        """Weighted rows of `problem` at that lag and delay."""


class Weighting(ABC):
    """A way to weight rows or equations."""

    @property
    @abstractmethod
    def passes(self) -> int:
        """Number of times the estimate is made; weights are renewed between passes."""

    @abstractmethod
    def start(self, problem: SeparableProblem) -> Weights:
        """Weights before anything is known."""

    @abstractmethod
    def renewed(
        self,
        weights: Weights,
        problem: SeparableProblem,
        theta: Float[np.ndarray, " n"],
        lag_s: float,
        delay_s: float,
    ) -> Weights:
        """Weights from the residuals at an estimate."""

    @abstractmethod
    def fixed(self, regression: Regression) -> Regression:
        """Rows of a plain regression, without a nuisance or spectra, as this weighting sees them."""


def orthonormal_basis(instruments: Float[np.ndarray, "rows p"]) -> Float[np.ndarray, "rows q"]:
    """Orthonormal basis of the space of the instruments, each scaled to unit length first.

    Zero columns, and directions with singular values below 1e-4, are left out.
    """
    lengths = np.sqrt(np.einsum("ij,ij->j", instruments, instruments))
    moving = lengths > 0.0
    if not moving.any():
        return np.empty((instruments.shape[0], 0))
    U, singular, _ = np.linalg.svd(instruments[:, moving] / lengths[moving], full_matrices=False)
    basis: Float[np.ndarray, "rows q"] = U[:, singular >= SMALLEST_DIRECTION]
    return basis


@dataclass(frozen=True, slots=True)
class SampleWeights(Weights):
    """Rows in time, as they are, with the instruments given or replaced.

    Parameters
    ----------
    basis : ndarray, shape (rows, q), optional
        Orthonormal basis of the instruments to put in their place.
    """

    basis: Float[np.ndarray, "rows q"] | None = None

    def regression(self, problem: SeparableProblem, lag_s: float, delay_s: float) -> Regression:
        """Rows in time."""
        rows = problem.samples(lag_s, delay_s)
        if self.basis is None:
            return rows
        return _with_instruments(rows, self.basis)


@dataclass(frozen=True, slots=True)
class Unweighted(Weighting):
    """Rows in time, each with weight one."""

    @property
    def passes(self) -> int:
        """One: nothing is renewed."""
        return 1

    def start(self, problem: SeparableProblem) -> Weights:  # noqa: ARG002 - the interface's
        """Trivial weights."""
        return SampleWeights()

    def renewed(
        self,
        weights: Weights,
        problem: SeparableProblem,  # noqa: ARG002 - the interface's
        theta: Float[np.ndarray, " n"],  # noqa: ARG002
        lag_s: float,  # noqa: ARG002
        delay_s: float,  # noqa: ARG002
    ) -> Weights:
        """Return the same weights."""
        return weights

    def fixed(self, regression: Regression) -> Regression:
        """Return the rows as they are."""
        return regression


@dataclass(frozen=True, slots=True)
class TwoStage(Weighting):
    """Instrumental equations weighted by the inverse of mean psi psi': two-stage least squares.

    Done by an orthonormal basis of the instruments, which never forms that matrix.
    """

    @property
    def passes(self) -> int:
        """One: the weight does not depend on the residuals."""
        return 1

    def start(self, problem: SeparableProblem) -> Weights:
        """Orthonormal instruments."""
        first = problem.samples(float(problem.lag_grid_s[0]), problem.delays_s[0])
        return SampleWeights(orthonormal_basis(first.instruments))

    def renewed(
        self,
        weights: Weights,
        problem: SeparableProblem,  # noqa: ARG002 - the interface's
        theta: Float[np.ndarray, " n"],  # noqa: ARG002
        lag_s: float,  # noqa: ARG002
        delay_s: float,  # noqa: ARG002
    ) -> Weights:
        """Return the same weights."""
        return weights

    def fixed(self, regression: Regression) -> Regression:
        """Orthonormal instruments in place of those given."""
        return _with_instruments(regression, orthonormal_basis(regression.instruments))


def _with_instruments(rows: Regression, basis: Float[np.ndarray, "rows q"]) -> Regression:
    """Return `rows` with `basis` in place of the instruments."""
    return Regression(
        rows.response,
        rows.regressors,
        basis,
        rows.parameters,
        rows.columns,
        error_scale=rows.error_scale,
        layout=rows.layout,
    )
