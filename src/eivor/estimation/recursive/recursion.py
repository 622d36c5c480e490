"""Recursive identification of a stream of samples: an estimate at any time, by exponential forgetting.

R <- lambda R + psi [phi' y] and w <- lambda w + 1, and the method's equations of R / w: for generalized IV
(R_phi / w - C) theta = R_y / w - c. It is the exponentially weighted batch estimate, by a merge of products.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import dataclass, field, replace

from eivor import checks
from eivor.errors import EstimationError, TooFewSamplesError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.recursive.change_detector import Change, ChangeDetector
from eivor.estimation.recursive.forgetting import DEFAULT_MEMORY, Forgetting
from eivor.estimation.recursive.row_recursion import RowRecursion
from eivor.estimation.recursive.timed_rows import timed_rows
from eivor.estimation.streaming import check_chunked, continued
from eivor.models.column import Column
from eivor.models.equation import Parameter
from eivor.models.signal_regression import SignalModel
from eivor.signals.signals import Signals


@dataclass(frozen=True)
class RecursiveIdentification:
    """What is known of a record after the samples so far, in memory that does not grow with them.

    It is never changed: `update` returns the next one, as in ``recursion = recursion.update(chunk)``.

    Parameters
    ----------
    model : SignalModel
        The equation, such as ``ev.VerticalMotion()``.
    method : LinearMethod
        Whose equations are mean cross-products: `generalized_iv`, `extended_iv`, their total least squares,
        `bias_compensated_least_squares`.
    instruments : tuple of Column
        Such as ``ev.lags("input", 0, 10)``.
    memory : float
        Sum of the weights of all samples before, 1 / (1 - lambda): 200 for a forgetting factor of 0.995.
    detector : ChangeDetector, optional
        What tells that a parameter changed; what lies before is forgotten then. Default: none.

    Raises
    ------
    UsageError
        When the method has no cross-products, needs all rows at once, or an argument is of another type.
    """

    model: SignalModel
    method: LinearMethod
    instruments: tuple[Column, ...] = ()
    memory: float = DEFAULT_MEMORY
    detector: ChangeDetector | None = None
    _rows: RowRecursion | None = field(default=None, init=False, repr=False)
    _tail: Signals | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        check_chunked(self.model, self.method, self.instruments)
        check_recursive(self.method)
        Forgetting(self.memory)
        if self.detector is not None:
            checks.kind("detector", self.detector, ChangeDetector, "a ChangeDetector", "ev.ChangeDetector().")

    def update(self, chunk: Signals) -> RecursiveIdentification:
        """With the samples that follow, one or many.

        However a record is cut into chunks, the estimate is the same but for rounding.

        Parameters
        ----------
        chunk : Signals
            The stretch of the record that follows, with the same channels and rate. Samples that are not
            valid count as time that passed, and as nothing else.

        Raises
        ------
        UsageError
            When the chunk does not follow, or differs in channels or rate.
        MissingNoiseError, InstrumentError
            When the method cannot use the instruments.
        """
        checks.kind("chunk", chunk, Signals, "Signals", "Give the stretches of one record in their order.")
        lag = self.model.regression_lag(self.instruments)
        joined = chunk if self._tail is None else continued(self._tail, chunk, lag)
        problem = self.model.regression(joined, self.instruments)
        rows = replace(self._begun(problem.parameters), changes=())
        changes: tuple[Change, ...] = ()
        for stretch in timed_rows(problem, self.method.assembler):
            rows = rows.then(stretch)
            changes += rows.changes
        following = copy(self)
        object.__setattr__(following, "_rows", replace(rows, changes=changes))
        object.__setattr__(following, "_tail", end_of(joined, lag))
        return following

    def _begun(self, parameters: tuple[Parameter, ...]) -> RowRecursion:
        if self._rows is not None:
            return self._rows
        return RowRecursion(parameters, self.method, Forgetting(self.memory), self.detector)

    @property
    def samples(self) -> int:
        """Samples so far that had a row: all but the first, as many as the largest lag."""
        return 0 if self._rows is None else self._rows.samples

    @property
    def changes(self) -> tuple[Change, ...]:
        """Changes that the last chunk showed, by the samples that had a row."""
        return () if self._rows is None else self._rows.changes

    @property
    def effective_rows(self) -> float:
        """Rows of equal weight whose mean scatters as much as that of the rows so far."""
        faded = None if self._rows is None else self._rows.faded
        return 0.0 if faded is None else faded.effective_rows

    def estimate(self) -> Estimate:
        """Estimate after the samples so far, with intervals for errors that have memory.

        Raises
        ------
        TooFewSamplesError
            When there are no more rows than parameters.
        EstimationError
            When the equations have no unique solution.
        """
        if self._rows is None:
            raise TooFewSamplesError("a chunk of samples", "none so far", "Call update(chunk) first.")
        return self._rows.estimate()


def identify_recursively(
    chunks: Iterable[Signals], recursion: RecursiveIdentification
) -> Iterator[tuple[RecursiveIdentification, Estimate]]:
    """Estimates after each chunk of a stream.

    Parameters
    ----------
    chunks : iterable of Signals
        Successive stretches of one record, without an end if need be.
    recursion : RecursiveIdentification
        What was known before the first.

    Returns
    -------
    iterator of (RecursiveIdentification, Estimate)
        After each chunk from the first on that tells the parameters. A chunk after which they are not told,
        at the beginning or after samples that do not count, is passed over.

    Raises
    ------
    UsageError
        When an argument is of another type, and see `RecursiveIdentification.update`.
    """
    checks.kind("chunks", chunks, Iterable, "several Signals", "Give [signals], or ev.read_chunks(file).")
    remedy = "Make one: ev.RecursiveIdentification(model, method, instruments)."
    checks.kind("recursion", recursion, RecursiveIdentification, "a RecursiveIdentification", remedy)
    return _estimates(chunks, recursion)


def _estimates(
    chunks: Iterable[Signals], recursion: RecursiveIdentification
) -> Iterator[tuple[RecursiveIdentification, Estimate]]:
    for chunk in chunks:
        recursion = recursion.update(chunk)
        try:
            estimate = recursion.estimate()
        except (TooFewSamplesError, EstimationError):
            continue
        yield recursion, estimate


def check_recursive(method: LinearMethod) -> None:
    """Refuse a method that has no cross-products, or whose weights are made of all rows.

    Raises
    ------
    UsageError
        With methods that can be used.
    """
    weighting = method.equation_weighting
    if method.assembler.moment_equations and weighting.passes == 1 and not method.row_weighting.needs_spectra:
        return
    raise UsageError(
        "a method of mean cross-products, which can be forgotten row by row",
        f"'{method.name}'",
        "Use generalized_iv, extended_iv, or bias_compensated_least_squares; with declared noises of zero "
        "that is least squares.",
    )


def end_of(signals: Signals, lag: int) -> Signals:
    """Return the last samples of signals, as many as a row reaches back; one at least."""
    start = max(signals.sample_count - max(lag, 1), 0)
    return replace(
        signals,
        channels={name: values[start:].copy() for name, values in signals.channels.items()},
        valid=None if signals.valid is None else signals.valid[start:].copy(),
        start_s=signals.start_s + start * signals.step_s,
        offset=signals.offset + start,
    )
