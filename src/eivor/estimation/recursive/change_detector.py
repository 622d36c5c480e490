"""A change of a parameter: cumulative sums of what an estimate leaves of the samples that follow it.

The estimate before a look of samples leaves mean scores m of them; H m is a change of the parameters, see
`References`. With what the look's own rows say of a parameter, q over the average, the part q of a change
shows, with the variance q. Its ratio to the root of q is divided by a robust scale of those before it, the
median of their magnitudes, and limited to a number u. Sums to both sides grow by sqrt(q) u - q d with the
drift d, the logarithm of the likelihood ratio of a change by 2 d but for a factor.

That variance is one of errors that are independent over a look. Where an input stands still they are not:
the change that such a look shows grows with q as its error does, and it tells no more than an average one.
So beyond q = 1 the ratio is to q, and counts as of q = 1; a look of less than a tenth counts for nothing.

While a sum is not zero, looks are held against the estimate from before it began: one that forgets would
follow the change and leave nothing to sum. A sum beyond the threshold is a change: what lies before the last
looks is forgotten then.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.recursive.looks import Look, References
from eivor.shapes import Float, Int

#: Median magnitude of normal numbers over their standard deviation, inverted.
NORMAL_MEDIAN = 1.4826
#: Looks after a change that are listened to only: one memory, until what was kept of before has faded.
REST = 8
#: Least of what a look shows of a parameter over what looks do on average, to show anything.
LEAST_SEEN = 0.1
#: What a change counts in the sums to both sides.
SIDES = np.array([[1.0], [-1.0]])


@dataclass(frozen=True, slots=True)
class ChangeDetector:
    """When a change is told.

    Parameters
    ----------
    threshold : float
        Sum that is a change.
    drift : float
        What every look takes off the sums: half the smallest change that is to be told quickly, in standard
        deviations of a look.
    limit : float
        Largest magnitude of one look.
    scale_looks : int
        Looks that the scale is the median of.
    least_looks : int
        Looks before the first that is summed.
    kept_looks : int
        Looks that are kept after a change.
    held_looks : int
        Looks for which a sum is held against one estimate at most.

    Raises
    ------
    UsageError
        When one is not above zero, or the limit is not above the drift.
    """

    threshold: float = 13.0
    drift: float = 0.75
    limit: float = 4.0
    scale_looks: int = 80
    least_looks: int = 20
    kept_looks: int = 3
    held_looks: int = 16

    def __post_init__(self) -> None:
        for name in ("threshold", "drift", "limit"):
            checks.number(name, getattr(self, name))
        looks = ("scale_looks", "least_looks", "kept_looks", "held_looks")
        for name in looks:
            checks.whole(name, getattr(self, name))
        if not all(getattr(self, name) > 0 for name in ("threshold", "drift", *looks)):
            raise UsageError("a detector whose numbers are above zero", repr(self), "The defaults are.")
        if not self.limit > self.drift:
            raise UsageError(
                "a limit above the drift", f"{self.limit:g} and {self.drift:g}", "No sum would ever grow."
            )


@dataclass(frozen=True, slots=True)
class Change:
    """A change that was told.

    Parameters
    ----------
    parameter : str
        Whose.
    sample : int
        Samples of the stream, counted from its first row, after which it was told.
    upwards : bool
        Whether the parameter grew.
    """

    parameter: str
    sample: int
    upwards: bool


@dataclass(frozen=True)
class Watch:
    """What a detector saw so far.

    Parameters
    ----------
    references : References or None
        Estimates that a look may be held against; None for none yet.
    before : ndarray, shape (looks, m)
        Changes that the last looks showed against the newest, of one variance; NaN where they showed none.
    sums : ndarray, shape (2, m)
        To both sides, upwards first.
    held : ndarray, shape (2, m)
        How many references before the newest each sum is held against.
    resting : int
        Looks that are not summed any more, after a change.
    """

    references: References | None = None
    before: Float[np.ndarray, "looks m"] = field(default_factory=lambda: np.zeros((0, 0)))
    sums: Float[np.ndarray, "2 m"] = field(default_factory=lambda: np.zeros((2, 0)))
    held: Int[np.ndarray, "2 m"] = field(default_factory=lambda: np.zeros((2, 0), dtype=np.int64))
    resting: int = 0

    def expecting(self, newest: References | None, detector: ChangeDetector) -> Watch:
        """With the estimate just before the next look; None where there is none."""
        if newest is None:
            return self
        watched = newest.mapped.shape[1]
        if self.references is None:
            before = self.before if self.before.size else np.zeros((0, watched))
            nothing = np.zeros((2, watched), dtype=np.int64)
            return Watch(newest, before, nothing.astype(np.float64), nothing, self.resting)
        references = self.references.then(newest, detector.held_looks)
        oldest = references.theta.shape[0] - 1
        held = np.where(self.sums > 0.0, np.minimum(self.held + 1, oldest), 0)
        return Watch(references, self.before, self.sums, held, self.resting)

    def after(self, look: Look, detector: ChangeDetector) -> Watch:
        """With one more look; one without rows, or that nothing is expected of, shows nothing."""
        if self.references is None or not look.count > 0.0:
            return self
        change, seen = self.references.shown(look)
        roots = np.sqrt(np.where(seen < LEAST_SEEN, 0.0, np.minimum(seen, 1.0)))
        units, sums = _in_units(change, seen), self.sums
        if self.before.shape[0] >= detector.least_looks and not self.resting:
            places = (roots.shape[0] - 1 - self.held, np.arange(roots.shape[1]))
            root, most = roots[places], detector.limit
            step = np.maximum(np.minimum(np.nan_to_num(units[places]) / _scale(self.before), most), -most)
            sums = np.maximum(sums + root * (SIDES * step - detector.drift * root), 0.0)
        before = np.concatenate([self.before, units[-1:]])[-detector.scale_looks :]
        return Watch(self.references, before, sums, self.held, max(self.resting - 1, 0))

    def told(self, detector: ChangeDetector) -> tuple[tuple[int, bool], ...]:
        """Numbers of the parameters that changed, and whether they grew."""
        sides, parameters = np.nonzero(self.sums > detector.threshold)
        return tuple((int(j), bool(side == 0)) for side, j in zip(sides, parameters, strict=True))

    def reset(self) -> Watch:
        """After a change: nothing to hold looks against, and no sums for a while; the scale is kept."""
        return Watch(before=self.before, resting=REST)


def _in_units(change: Float[np.ndarray, "W m"], seen: Float[np.ndarray, "W m"]) -> Float[np.ndarray, "W m"]:
    """Changes of one variance: over sqrt(q), or q where that is more; NaN where a look shows nothing."""
    nothing = seen < LEAST_SEEN
    told = np.where(nothing, 1.0, seen)
    return np.where(nothing, np.nan, change / np.maximum(np.sqrt(told), told))


def _scale(before: Float[np.ndarray, "looks m"]) -> Float[np.ndarray, " m"]:
    """Robust standard deviations of looks that show something; infinite where most showed no change."""
    sizes = np.sort(np.abs(before), axis=0)  # NaN last
    half = np.count_nonzero(~np.isnan(sizes), axis=0) // 2
    middle = np.nan_to_num(sizes[half, np.arange(sizes.shape[1])])
    scale: Float[np.ndarray, " m"] = np.where(middle > 0.0, NORMAL_MEDIAN * middle, np.inf)
    return scale
