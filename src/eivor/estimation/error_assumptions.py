"""What the sets that need no strength of instruments suppose of the errors, in numbers and in words."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from eivor import checks
from eivor.errors import TooFewSamplesError, UsageError
from eivor.estimation.moment_rows import MomentRows
from eivor.inference.sets.anderson_rubin import homoskedastic_region, robust_region
from eivor.inference.sets.confidence_region import ConfidenceRegion


class ErrorAssumption(ABC):
    """What an Anderson-Rubin test supposes of the errors, and the region that follows."""

    @property
    @abstractmethod
    def sentence(self) -> str:
        """The assumption in words."""

    @abstractmethod
    def region(self, rows: MomentRows, level: float) -> ConfidenceRegion:
        """Region of independent equations."""


@dataclass(frozen=True, slots=True)
class AutocorrelatedErrors(ErrorAssumption):
    """Errors may be autocorrelated and heteroskedastic.

    Parameters
    ----------
    averages : int, optional
        Number B of cosine averages. Default: 0.4 rows^(2/3), and two for each equation at least. Fewer allow
        for slower errors and make wider sets.
    """

    averages: int | None = None

    def __post_init__(self) -> None:
        if self.averages is not None:
            checks.whole("averages", self.averages)
            if self.averages < 1:
                raise UsageError("one cosine average or more", f"{self.averages}", "Leave averages out.")

    @property
    def sentence(self) -> str:
        """The assumption in words."""
        return (
            "The instruments are uncorrelated with the error of their row once the declared noises are "
            "accounted for; errors may be autocorrelated and heteroskedastic, over times much shorter than "
            "the record. Holds in large samples, whatever the strength of the instruments."
        )

    def region(self, rows: MomentRows, level: float) -> ConfidenceRegion:
        """Region of the robust test.

        Raises
        ------
        TooFewSamplesError
            When the record is too short for the averages, or these are fewer than the equations.
        """
        equations = rows.test_functions.shape[1]
        if self.averages is not None and not equations <= self.averages < rows.columns.shape[0]:
            raise TooFewSamplesError(
                f"as many cosine averages as equations, {equations}, and fewer than samples",
                f"{self.averages}",
                "Leave averages out, or drop instruments.",
            )
        return robust_region(rows.names, rows.scores(self.averages), level)


@dataclass(frozen=True, slots=True)
class HomoskedasticErrors(ErrorAssumption):
    """Errors are white, with one variance: the classical test, in closed form."""

    @property
    def sentence(self) -> str:
        """The assumption in words."""
        return (
            "Errors are white, of one variance, and independent of the instruments. With normal errors the "
            "joint region is exact in every sample; otherwise it holds in large ones. Whatever the strength "
            "of the instruments."
        )

    def region(self, rows: MomentRows, level: float) -> ConfidenceRegion:
        """Region of the classical test.

        Raises
        ------
        UsageError
            For compensated equations, whose scores do not have the variance that the test supposes.
        """
        if rows.noise.any():
            raise UsageError(
                "equations without compensation for the classical test",
                "compensated equations, whose errors share noise with their instruments",
                "Use AutocorrelatedErrors(), the default, which takes the scores' variance as it is.",
            )
        return homoskedastic_region(rows.names, rows.test_functions, rows.columns, level, rows.partialled)
