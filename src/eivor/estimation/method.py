"""Interface of an estimation method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.moments import ProblemMoments
from eivor.models.regression import LinearProblem
from eivor.models.separable import SeparableProblem

#: What methods estimate from.
Problem = LinearProblem | SeparableProblem | ProblemMoments


class Method(ABC):
    """One way to estimate."""

    name: str
    natural_instruments: str = "references"  # Of a flight when nothing else is requested: or "lags"

    @property
    @abstractmethod
    def needs_instruments(self) -> bool:
        """True when problems must have instruments."""

    @property
    def of_flights(self) -> Method:
        """The method that it is of problems with nuisances, whose instruments flights have; mostly itself."""
        return self

    @property
    def takes_out_own_noise(self) -> bool:
        """True when the noise of the regressors must be known; not so by default."""
        return False

    @property
    def first_past_input(self) -> int:
        """Lag in samples of the first of past inputs that may be an instrument."""
        return 1

    @abstractmethod
    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the parameters of a problem."""


#: Name of the method that follows another one.
OUTPUT_ERROR = "output_error"


@dataclass(frozen=True)
class OutputError(Method):
    """Least multi-step prediction errors of a motion, from the estimate of another method."""

    first: Method

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"{self.first.name}+{OUTPUT_ERROR}"

    @property
    def needs_instruments(self) -> bool:
        return self.first.needs_instruments

    @property
    def of_flights(self) -> Method:
        return self.first.of_flights

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate by the first method, of a flight; plain rows have nothing to predict."""
        if not isinstance(problem, SeparableProblem):
            expected = f"a flight of a motion whose states {OUTPUT_ERROR} predicts"
            remedy = 'Use identify_flight(..., model="rigid-body"), or another method.'
            raise UsageError(expected, type(problem).__name__, remedy)
        return self.first.estimate(problem)
