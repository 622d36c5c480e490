"""Interface of an estimation method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum

from eivor.estimation.estimate import Estimate
from eivor.estimation.moments import ProblemMoments
from eivor.models.regression import LinearProblem
from eivor.models.separable import SeparableProblem

#: What methods estimate from.
Problem = LinearProblem | SeparableProblem | ProblemMoments


class NaturalInstruments(Enum):
    """What serves as instruments of a flight when nothing else is requested."""

    REFERENCES = "references"
    LAGS = "lags"


class Method(ABC):
    """One way to estimate."""

    name: str
    natural_instruments: NaturalInstruments = NaturalInstruments.REFERENCES

    @property
    @abstractmethod
    def needs_instruments(self) -> bool:
        """True when problems must have instruments."""

    @property
    def of_flights(self) -> Method:
        """The method that it is of problems with nuisances; itself unless it says otherwise."""
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
