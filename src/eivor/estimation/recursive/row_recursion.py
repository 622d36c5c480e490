"""A recursion over rows of any origin: products that fade, the estimate they make, changes that are met."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from eivor.errors import TooFewSamplesError
from eivor.estimation.estimate import Estimate
from eivor.estimation.fit import identify
from eivor.estimation.linear import LinearMethod
from eivor.estimation.moments import CrossMoments, ProblemMoments
from eivor.estimation.recursive.change_detector import Change, ChangeDetector, Watch
from eivor.estimation.recursive.faded_covariance import equation_map, faded_covariance
from eivor.estimation.recursive.faded_products import FadedProducts, nothing_yet
from eivor.estimation.recursive.forgetting import BLOCKS_PER_LOOK, Forgetting
from eivor.estimation.recursive.looks import looks_at_once, looks_between, newest_reference
from eivor.estimation.recursive.timed_rows import TimedRows
from eivor.models.equation import Parameter


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
    changes : tuple of Change
        Those that the last rows showed.
    """

    parameters: tuple[Parameter, ...]
    method: LinearMethod
    forgetting: Forgetting
    detector: ChangeDetector | None = None
    faded: FadedProducts | None = None
    watching: Watch = field(default_factory=Watch)
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
        span = looks_at_once(self.forgetting) * self.forgetting.look
        for stretch in rows.stretches(faded.samples, span):
            rest = stretch
            while rest.count:
                seen, rest = seen._watched(seen.faded or faded, rest, self.detector)
        return seen

    def _watched(
        self, faded: FadedProducts, rows: TimedRows, detector: ChangeDetector
    ) -> tuple[RowRecursion, TimedRows]:
        """With rows up to the end of the first look that tells a change, and the rows that are left."""
        after, watching = faded.then(rows), self.watching
        for look, reference in looks_between(faded, after):
            watching = watching.after(look, detector)
            told = watching.told(detector)
            if told:
                names = [parameter.name for parameter in self.parameters]
                changes = (*self.changes, *(Change(names[j], look.sample, up) for j, up in told))
                taken = look.sample - faded.samples
                kept = faded.then(rows.between(0, taken)).last(detector.kept_looks * BLOCKS_PER_LOOK)
                watching = watching.reset().expecting(newest_reference(kept), detector)
                return (
                    replace(self, faded=kept, watching=watching, changes=changes),
                    rows.between(taken, rows.count),
                )
            watching = watching.expecting(reference, detector)
        return replace(self, faded=after, watching=watching), rows.between(0, 0)

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
