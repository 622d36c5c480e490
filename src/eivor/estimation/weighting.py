"""Weightings: how rows or equations are weighted, and renewed from the residuals.

Some weight *rows*: they turn a problem at any lag and delay of an actuator into weighted rows, and do not
depend on the nuisance, so that a whole search over lags shares them. Others weight the *equations* of an
instrumental method, m(theta) = psi'(y - Phi theta): they give a factor L, and L^-1 m is made small.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.estimation.moments import Moments
from eivor.linalg.system import LinearSystem
from eivor.models.regression import LinearProblem, Regression
from eivor.models.separable import SeparableProblem


class Weights(ABC):
    """Weights of rows at one estimate."""

    @abstractmethod
    def regression(self, problem: SeparableProblem, lag_s: float, delay_s: float) -> Regression:
        """Weighted rows of `problem` at that lag and delay."""


@dataclass(frozen=True, slots=True)
class UnweightedEquations:
    """Equations of a method before they are weighted, and what a weight may be made of.

    Parameters
    ----------
    system : LinearSystem
        A and b, means over the rows.
    moments : Moments
        What they were made of.
    problem : LinearProblem or None
        The rows; None when only moments are at hand.
    theta : ndarray, shape (n,), or None
        Estimate of the pass before; None in the first.
    """

    system: LinearSystem
    moments: Moments
    problem: LinearProblem | None
    theta: Float[np.ndarray, " n"] | None


@dataclass(frozen=True, slots=True)
class WeightedEquations:
    """Equations after weighting.

    Parameters
    ----------
    system : LinearSystem
        L^-1 A theta = L^-1 b.
    factor : ndarray, shape (p, p), optional
        Lower triangular L; None for the identity.
    """

    system: LinearSystem
    factor: Float[np.ndarray, "p p"] | None = None


class Weighting(ABC):
    """A way to weight rows or equations."""

    @property
    @abstractmethod
    def passes(self) -> int:
        """Number of times the estimate is made; weights are renewed between passes."""

    @property
    @abstractmethod
    def needs_instrument_products(self) -> bool:
        """True when mean(psi psi') must be among the moments."""

    @abstractmethod
    def start(self, problem: SeparableProblem) -> Weights:
        """Row weights before anything is known."""

    @abstractmethod
    def renewed(
        self,
        weights: Weights,
        problem: SeparableProblem,
        theta: Float[np.ndarray, " n"],
        lag_s: float,
        delay_s: float,
    ) -> Weights:
        """Row weights from the residuals at an estimate."""

    @abstractmethod
    def equations(self, at: UnweightedEquations) -> WeightedEquations:
        """Equations weighted for the first pass, or by the residuals of the pass before."""


@dataclass(frozen=True, slots=True)
class SampleWeights(Weights):
    """Rows in time, as they are."""

    def regression(self, problem: SeparableProblem, lag_s: float, delay_s: float) -> Regression:
        """Rows in time."""
        return problem.samples(lag_s, delay_s)


class EquationWeighting(Weighting):
    """Weightings that leave rows as they are."""

    def start(self, problem: SeparableProblem) -> Weights:
        """Trivial weights."""
        del problem
        return SampleWeights()

    def renewed(
        self,
        weights: Weights,
        problem: SeparableProblem,
        theta: Float[np.ndarray, " n"],
        lag_s: float,
        delay_s: float,
    ) -> Weights:
        """Return the same weights."""
        del problem, theta, lag_s, delay_s
        return weights


@dataclass(frozen=True, slots=True)
class Unweighted(EquationWeighting):
    """Every row and every equation with weight one, as in the paper's (24) and (30)."""

    @property
    def passes(self) -> int:
        """One."""
        return 1

    @property
    def needs_instrument_products(self) -> bool:
        """No."""
        return False

    def equations(self, at: UnweightedEquations) -> WeightedEquations:
        """Return the equations as they are."""
        return WeightedEquations(at.system)
