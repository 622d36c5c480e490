"""Recursive identification, tracking of parameters and detection of changes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from eivor import checks
from eivor.errors import EstimationError, TooFewSamplesError, UsageError
from eivor.estimation import streaming
from eivor.estimation.estimate import Estimate, equation_map
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import identify
from eivor.estimation.moments import ProblemMoments
from eivor.inference.covariance import column_scale, unit_scale
from eivor.models.regression import Column, Parameter
from eivor.models.separable import Prior
from eivor.models.signal_regression import SignalModel
from eivor.signals.signals import Signals
from eivor.tools import Float, Int

#: Least residual of a scaled regressor on the others.
COLLINEAR_SHARE = 1e-10


@dataclass(frozen=True, slots=True)
class References:
    """Successive estimates that later looks are held against."""

    theta: Float[np.ndarray, "W n"]  # The estimates, the newest last
    mapped: Float[np.ndarray, "W m p"]
    watched: slice


def newest_reference(weighted: streaming.ExponentiallyWeightedProducts) -> References | None:
    """Least squares solution of the equations of all full blocks; None where there is no unique one."""
    equations = weighted.compensated(weighted.full)[0]
    A, b = equations[:, :-1], equations[:, -1]
    if A.shape[0] < A.shape[1]:
        return None
    scale = column_scale(A)
    Q, R = np.linalg.qr(A * scale)
    if not np.abs(np.diag(R)).min() > COLLINEAR_SHARE:
        return None
    inverse = scale[:, None] * np.linalg.solve(R, Q.T)
    mapped = weighted.full.products.count * inverse
    return References((inverse @ b)[None], mapped[None], slice(0, A.shape[1]))


#: Median magnitude of normal numbers over their standard deviation, inverted.
NORMAL_MEDIAN = 1.4826
#: Looks after a change that are listened to only: one memory, until what was kept of before has
#: exponentially weighted.
REST = 8
#: Looks that the scale is the median of, before the first that is summed, and that are kept after a change.
SCALE_LOOKS, LEAST_LOOKS, KEPT_LOOKS = 80, 20, 3
#: Least information of a look on a parameter, over the average, to count.
LEAST_STRENGTH = 0.1
#: Sign of a change in the sums to both sides.
SIDES = np.array([[1.0], [-1.0]])


@dataclass(frozen=True, slots=True)
class ChangeDetector:
    """When a change is reported.

    Raises
    ------
    UsageError
        When one is not above zero, or the limit is not above the drift.
    """

    threshold: float = 13.0  # Sum that is a change
    #: What every look takes off the sums: half the smallest change that is to be reported quickly, in
    #: standard deviations of a look
    drift: float = 0.75
    limit: float = 4.0  # Largest magnitude of one look
    held_looks: int = 16  # Looks for which a sum is held against one estimate at most

    def __post_init__(self) -> None:
        for name in ("threshold", "drift", "limit"):
            checks.number(name, getattr(self, name))
        checks.whole("held_looks", self.held_looks)
        if not all(getattr(self, name) > 0 for name in ("threshold", "drift", "held_looks")):
            raise UsageError("a detector whose numbers are above zero", repr(self), "The defaults are.")
        if not self.limit > self.drift:
            remedy = "No sum would ever grow."
            raise UsageError("a limit above the drift", f"{self.limit:g} and {self.drift:g}", remedy)


@dataclass(frozen=True, slots=True)
class Change:
    """A change that was identified."""

    parameter: str
    sample: int
    upwards: bool


@dataclass(frozen=True)
class Watch:
    """State of a detector."""

    references: References | None = None
    history: Float[np.ndarray, "looks m"] = field(default_factory=lambda: np.zeros((0, 0)))
    sums: Float[np.ndarray, "2 m"] = field(default_factory=lambda: np.zeros((2, 0)))
    held: Int[np.ndarray, "2 m"] = field(default_factory=lambda: np.zeros((2, 0), dtype=np.int64))
    resting: int = 0

    def expecting(self, newest: References | None, detector: ChangeDetector) -> Watch:
        """State with the estimate before the next look; None where there is none."""
        if newest is None:
            return self
        watched = newest.mapped.shape[1]
        if self.references is None:
            history = self.history if self.history.size else np.zeros((0, watched))
            nothing = np.zeros((2, watched), dtype=np.int64)
            return Watch(newest, history, nothing.astype(np.float64), nothing, self.resting)
        theta, mapped = (
            np.concatenate([old, new])[-detector.held_looks :]
            for old, new in ((self.references.theta, newest.theta), (self.references.mapped, newest.mapped))
        )
        held = np.where(self.sums > 0.0, np.minimum(self.held + 1, len(theta) - 1), 0)
        return replace(self, references=References(theta, mapped, newest.watched), held=held)

    def with_look(self, look: Float[np.ndarray, "p n_plus_1"] | None, detector: ChangeDetector) -> Watch:
        """State after one more look; a look without rows or reference changes nothing."""
        if self.references is None or look is None:
            return self
        # changes of the parameters by the look, and its information over the average
        mapped = np.matmul(self.references.mapped, look)
        change = mapped[:, :, -1] - np.matmul(mapped[:, :, :-1], self.references.theta[:, :, None])[:, :, 0]
        strength = np.diagonal(mapped[:, :, self.references.watched], axis1=1, axis2=2)
        uninformative, sums = strength < LEAST_STRENGTH, self.sums
        roots = np.sqrt(np.where(uninformative, 0.0, np.minimum(strength, 1.0)))
        # Of one variance: over sqrt(q), or q where that is more; NaN where a look shows nothing.
        expected = np.where(uninformative, 1.0, strength)
        units = np.where(uninformative, np.nan, change / np.maximum(np.sqrt(expected), expected))
        if self.history.shape[0] >= LEAST_LOOKS and not self.resting:
            positions = (roots.shape[0] - 1 - self.held, np.arange(roots.shape[1]))
            root = roots[positions]
            sizes = np.sort(np.abs(self.history), axis=0)  # NaN last
            half = np.count_nonzero(~np.isnan(sizes), axis=0) // 2
            median = np.nan_to_num(sizes[half, np.arange(sizes.shape[1])])
            scale = np.where(median > 0.0, NORMAL_MEDIAN * median, np.inf)  # infinite: most showed no change
            step = np.clip(np.nan_to_num(units[positions]) / scale, -detector.limit, detector.limit)
            sums = np.maximum(sums + root * (SIDES * step - detector.drift * root), 0.0)
        history = np.concatenate([self.history, units[-1:]])[-SCALE_LOOKS:]
        return replace(self, history=history, sums=sums, resting=max(self.resting - 1, 0))

    def inspected(
        self, weighted: streaming.ExponentiallyWeightedProducts, detector: ChangeDetector
    ) -> tuple[Watch, streaming.ExponentiallyWeightedProducts, tuple[tuple[int, bool], ...]]:
        """State after the last look of products; after a change only the scale stays."""
        blocks = weighted.closed.select(
            weighted.closed.blocks - streaming.BLOCKS_PER_LOOK, weighted.closed.blocks
        )
        count = blocks.products.count
        look = weighted.compensated(blocks).sum(axis=0) / count if count > 0.0 else None
        watch = self.with_look(look, detector)
        sides, parameters = np.nonzero(watch.sums > detector.threshold)
        if not sides.size:
            return watch, weighted, ()
        changed = tuple((int(j), bool(side == 0)) for side, j in zip(sides, parameters, strict=True))
        recent = weighted.last(KEPT_LOOKS * streaming.BLOCKS_PER_LOOK)
        return Watch(history=watch.history, resting=REST), recent, changed


@dataclass(frozen=True)
class RecursiveIdentification:
    """What is known of a record after the samples so far, in memory that does not grow with them.

    It is never changed: `update` returns the next one, as in ``recursion = recursion.update(chunk)``.

    Raises
    ------
    UsageError
        When the method has no cross-products, needs all rows at once, or an argument is of another type.
    """

    model: SignalModel  # The equation, such as ``ev.VerticalMotion()``
    #: Whose equations are mean cross-products: `generalized_iv`, `extended_iv`, their total least squares,
    #: `bias_compensated_least_squares`
    method: LinearMethod
    instruments: tuple[Column, ...] = ()  # Such as ``ev.lags("input", 0, 10)``
    #: Sum of the weights of all samples before, 1 / (1 - lambda): 200 for a forgetting factor of 0.995
    memory: float = streaming.DEFAULT_MEMORY
    #: What determines that a parameter changed; what lies before is forgotten then. Default: none.
    detector: ChangeDetector | None = None
    #: Changes that the last chunk showed, by the samples that had a row.
    changes: tuple[Change, ...] = field(default=(), init=False, repr=False)
    _parameters: tuple[Parameter, ...] = field(default=(), init=False, repr=False)
    _products: streaming.ExponentiallyWeightedProducts | None = field(default=None, init=False, repr=False)
    _watch: Watch = field(default_factory=Watch, init=False, repr=False)  # Sums of the detector
    _tail: Signals | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        streaming.check_chunked(self.model, self.method, self.instruments)
        check_recursive(self.method)
        streaming.Forgetting(self.memory)
        if self.detector is not None:
            checks.kind("detector", self.detector, ChangeDetector, "a ChangeDetector", "ev.ChangeDetector().")

    def update(self, chunk: Signals) -> RecursiveIdentification:
        """With the stretch of the record that follows, one sample or many, of the same channels and rate.

        However a record is cut into chunks, the estimate is the same but for rounding. Samples that are not
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
        joined = chunk if self._tail is None else streaming.continued(self._tail, chunk, lag)
        problem = self.model.regression(joined, self.instruments)
        successor = copy(self)
        successor._set(
            changes=(), _parameters=problem.parameters, _tail=streaming.last_samples(joined, max(lag, 1))
        )
        for stretch in streaming.timed_rows(problem, self.method.assembler):
            successor._add(stretch)
        return successor

    def _add(self, rows: streaming.TimedRows) -> None:
        """Add rows to a new copy, in place; look for changes where there is a detector."""
        forgetting, weighted, watch = streaming.Forgetting(self.memory), self._products, self._watch
        if weighted is None:
            weighted = streaming.empty_products(rows, forgetting)
        if self.detector is None:
            self._set(_products=weighted.updated(rows))
            return
        names, changes = [parameter.name for parameter in self._parameters], list(self.changes)
        for stretch in rows.stretches(weighted.samples, forgetting.block_length):
            weighted = weighted.updated(stretch)
            if weighted.samples % forgetting.block_length == 0:
                watch, weighted, changed = watch.inspected(weighted, self.detector)
                changes += [Change(names[j], weighted.samples, up) for j, up in changed]
                watch = watch.expecting(newest_reference(weighted), self.detector)
        self._set(_products=weighted, _watch=watch, changes=tuple(changes))

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def samples(self) -> int:
        """Samples so far that had a row: all but the first, as many as the largest lag."""
        return 0 if self._products is None else self._products.samples

    @property
    def effective_rows(self) -> float:
        """Rows of equal weight whose mean scatters as much as that of the rows so far."""
        return 0.0 if self._products is None else self._products.effective_rows

    def estimate(self) -> Estimate:
        """Estimate after the samples so far, with intervals for errors that have memory.

        Raises
        ------
        TooFewSamplesError
            When there are no more rows than parameters.
        EstimationError
            When the equations have no unique solution.
        """
        if self._tail is None:
            raise TooFewSamplesError("a chunk of samples", "none so far", "Call update(chunk) first.")
        weighted = self._products
        if weighted is None or not weighted.total.products.count > 0.0:
            remedy = "Give more samples than the largest lag, valid ones among the last of them."
            raise TooFewSamplesError("rows that are not forgotten yet", "none", remedy)
        result = identify(ProblemMoments(self._parameters, weighted.moments), self.method)
        arguments = weighted, result.theta, equation_map(result)
        return replace(result, streamed_covariance=streaming.exponentially_weighted_covariance(*arguments))


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
        After each chunk from the first on that identifies the parameters. A chunk after which they are
        not identified, at the beginning or after samples that do not count, is passed over.

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
    """Refuse a method that has no cross-products, or whose weights are made of all rows."""
    weighting = method.equation_weighting
    if method.assembler.moment_equations and weighting.passes == 1 and not method.row_weighting.needs_spectra:
        return
    raise UsageError(
        "a method of mean cross-products, which can be forgotten row by row",
        f"'{method.name}'",
        "Use generalized_iv, extended_iv, or bias_compensated_least_squares; with declared noises of zero "
        "that is least squares.",
    )


#: Share of the largest variance of the scaled instruments below which a direction of them does not vary.
CONSTANT = 1e-9
#: Share of the largest information below which there is none.
LEAST_INFORMATION_SHARE = 1e-12
#: Share of the parameter that may lie in directions without information.
RESOLVED = 1e-6
#: Times that the information of a row is renewed at the estimate.
PASSES = 3
#: Largest information of a row, which rows without error reach.
MOST_INFORMATION = 1e200
#: Largest half-width over the value with which a parameter counts as given.
LARGEST_SHARE = 0.2
#: Least part of the memory that holds samples that count.
HELD = 0.25


@dataclass(frozen=True, slots=True)
class Moment:
    """Value and half-width of a parameter after a look."""

    time_s: float  # On the log's clock [s]
    value: float
    half_width: float
    share: float  # Weights of the rows that counted over those of a memory without gaps
    change: int = 0

    @property
    def is_precise(self) -> bool:
        """Whether the half-width is a fifth of the value at most, of a fourth of the memory or more."""
        return self.share >= HELD and self.half_width <= LARGEST_SHARE * abs(self.value)


#: Estimate by weighted products and priors, its map from mean scores, and the priors' part of its covariance.
Posterior = tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n p"], Float[np.ndarray, "n n"]]


@dataclass(frozen=True, slots=True)
class Follower:
    """Follower of one parameter of several."""

    index: int
    priors: tuple[Prior | None, ...]
    start: Float[np.ndarray, " n"]  # Values near which they are
    time_s: Float[np.ndarray, " samples"]  # On the log's clock [s]

    def points(
        self, rows: streaming.TimedRows, forgetting: streaming.Forgetting, detector: ChangeDetector
    ) -> Iterator[Moment]:
        weighted, watch = streaming.empty_products(rows, forgetting), Watch()
        for stretch in rows.stretches(0, forgetting.block_length):
            weighted = weighted.updated(stretch)
            if stretch.count < forgetting.block_length:
                return
            watch, weighted, changed = watch.inspected(weighted, detector)
            change = (1 if changed[0][1] else -1) if changed else 0
            j, value, half, posterior = self.index, math.nan, math.inf, self.posterior(weighted)
            if posterior is not None:
                theta, mapped, known = posterior
                covariance = streaming.exponentially_weighted_covariance(weighted, theta, mapped)
                half = covariance.half_width(np.eye(theta.size)[j], 0.95, float(known[j, j]))
                value, share = float(theta[j]), float(mapped[j] @ weighted.moments.equations[:, j])
                if share > 0.0:  # later looks are held against what rows alone say of a change
                    newest = References(theta[None, :], mapped[None, [j]] / share, slice(j, j + 1))
                    watch = watch.expecting(newest, detector)
            counted = weighted.total.products.count / forgetting.memory
            yield Moment(float(self.time_s[weighted.samples - 1]), value, half, counted, change)

    def posterior(self, weighted: streaming.ExponentiallyWeightedProducts) -> Posterior | None:
        if not weighted.effective_rows > self.start.size:
            return None
        moments = weighted.moments
        # combinations of the instruments that vary, with the identity as their products
        products = moments.products.instruments.sum(axis=0) / moments.rows
        scale = unit_scale(np.diag(products))
        values, vectors = np.linalg.eigh(products * np.outer(scale, scale))
        varying = values > CONSTANT * max(values[-1], 0.0)
        basis = scale[:, None] * vectors[:, varying] / np.sqrt(values[varying])
        A, b = np.hsplit(basis.T @ moments.equations, [-1])
        information, projected = A.T @ A, A.T @ b[:, 0]
        precision = np.diag([0.0 if prior is None else prior.std**-2 for prior in self.priors])
        mean = np.array([0.0 if prior is None else prior.mean for prior in self.priors])
        if not information[self.index, self.index] > 0.0:
            return None
        theta = self.start
        for _ in range(PASSES):
            scores = streaming.exponentially_weighted_covariance(weighted, theta, A.T @ basis.T)
            # of a row: one over the variance of its score over its power, the largest of the covariances
            powers = np.diag(information)
            variances = [np.mean((np.diag(part.matrix) / powers)[powers > 0.0]) for part in scores.parts]
            row = 1.0 / float(max(*variances, np.finfo(np.float64).tiny))
            largest = max(float(np.abs(projected).max()), float(np.abs(information).max()))
            row = min(row, MOST_INFORMATION / largest)
            # without the directions that have no information
            normal = row * information + precision
            sizes = np.outer(*2 * [unit_scale(np.diag(normal))])
            inverse = sizes * np.linalg.pinv(normal * sizes, rcond=LEAST_INFORMATION_SHARE, hermitian=True)
            theta = inverse @ (row * projected + precision @ mean)
        known = inverse @ precision @ inverse
        # part of it may lie in a direction without information: the minimum-norm solution is no estimate
        if inverse[self.index] @ normal[:, self.index] < 1.0 - RESOLVED:
            known = np.full_like(known, math.inf)
        return theta, row * inverse @ A.T @ basis.T, known
