"""A recursion over rows of any origin: products that fade, the estimate they make, changes that are met."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from eivor.errors import EstimationError, TooFewSamplesError
from eivor.estimation.estimate import Estimate
from eivor.estimation.fit import identify
from eivor.estimation.linear import LinearMethod
from eivor.estimation.moments import CrossMoments, ProblemMoments
from eivor.estimation.recursive.change_detector import Change, ChangeDetector, Watch
from eivor.estimation.recursive.faded_covariance import equation_map, faded_covariance
from eivor.estimation.recursive.faded_products import FadedProducts, nothing_yet
from eivor.estimation.recursive.forgetting import BLOCKS_PER_LOOK, Forgetting
from eivor.estimation.recursive.timed_rows import TimedRows
from eivor.models.equation import Parameter
from eivor.shapes import Float


@dataclass(frozen=True, slots=True)
class Expected:
    """What the next look is held against.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        The estimate at the end of the look before.
    mapped : ndarray, shape (n, p)
        See `equation_map`.
    """

    theta: Float[np.ndarray, " n"]
    mapped: Float[np.ndarray, "n p"]


@dataclass(frozen=True)
class RowRecursion:
    """What is known after the rows so far.

    Parameters
    ----------
    parameters : tuple of Parameter
        Names and units, in the order of the regressors.
    method : LinearMethod
        With cross-products for equations.
    forgetting : Forgetting
        How fast rows are forgotten.
    detector : ChangeDetector, optional
        What tells a change; None for none.
    faded : FadedProducts, optional
        Products so far; None before the first row.
    watching : Watch
        Sums of the detector.
    expected : Expected, optional
        What the next look is held against; None where the rows did not tell it.
    changes : tuple of Change
        Those that the last rows showed.
    """

    parameters: tuple[Parameter, ...]
    method: LinearMethod
    forgetting: Forgetting
    detector: ChangeDetector | None = None
    faded: FadedProducts | None = None
    watching: Watch = field(default_factory=Watch)
    expected: Expected | None = None
    changes: tuple[Change, ...] = ()

    @property
    def samples(self) -> int:
        """Samples so far that had a row, those among them that did not count."""
        return 0 if self.faded is None else self.faded.samples

    def then(self, rows: TimedRows) -> RowRecursion:
        """With the rows that follow; `changes` are those that they show."""
        faded = self.faded
        if faded is None:
            faded = nothing_yet(rows, self.forgetting, whole=self.method.needs_instruments)
        seen = replace(self, faded=faded, changes=())
        if self.detector is None:
            return replace(seen, faded=faded.then(rows))
        for stretch in rows.stretches(faded.samples, self.forgetting.look):
            seen = seen._looked((seen.faded or faded).then(stretch), self.detector)
        return seen

    def _looked(self, faded: FadedProducts, detector: ChangeDetector) -> RowRecursion:
        """With products of rows that reach to the end of a look at most, and what the look shows."""
        if faded.samples % self.forgetting.look:
            return replace(self, faded=faded)
        watching, changes = self.watching, self.changes
        shown = self._shown(faded)
        if shown is not None:
            watching = watching.after(shown, detector)
            told = watching.told(detector)
            if told:
                names = [parameter.name for parameter in self.parameters]
                changes += tuple(Change(names[j], faded.samples, upwards) for j, upwards in told)
                faded = faded.last(detector.kept_looks * BLOCKS_PER_LOOK)
                watching = watching.reset()
        return replace(self, faded=faded, watching=watching, changes=changes, expected=self._expected(faded))

    def _shown(self, faded: FadedProducts) -> Float[np.ndarray, " n"] | None:
        """Change of the parameters that the last look shows; None where it shows nothing."""
        look = faded.closed.between(faded.closed.blocks - BLOCKS_PER_LOOK, faded.closed.blocks)
        count = look.products.count
        if self.expected is None or not count > 0.0:
            return None
        scores = faded.scores(look, self.expected.theta).sum(axis=0)
        shown: Float[np.ndarray, " n"] = self.expected.mapped @ scores / count
        return shown

    def _expected(self, faded: FadedProducts) -> Expected | None:
        try:
            solved = self.method.solve_moments(_moments(faded))
        except (EstimationError, TooFewSamplesError):
            return None
        return Expected(solved.solution.theta, equation_map(solved))

    def estimate(self) -> Estimate:
        """Estimate of the rows so far, with the weights that they have now.

        Raises
        ------
        TooFewSamplesError
            When there are no more rows than parameters, or none that is not forgotten.
        EstimationError
            When the equations have no unique solution.
        """
        if self.faded is None:
            raise _no_rows()
        found = identify(ProblemMoments(self.parameters, _moments(self.faded)), self.method)
        (candidate,) = found.candidates
        covariance = faded_covariance(self.faded, candidate.theta, equation_map(candidate.solved))
        return replace(found, candidates=(replace(candidate, streamed_covariance=covariance),))


def _moments(faded: FadedProducts) -> CrossMoments:
    if not faded.total.products.count > 0.0:
        raise _no_rows()
    return faded.moments


def _no_rows() -> TooFewSamplesError:
    return TooFewSamplesError(
        "rows that are not forgotten yet",
        "none",
        "Give more samples than the largest lag, valid ones among the last of them.",
    )
