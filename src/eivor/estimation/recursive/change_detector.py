"""A change of a parameter: cumulative sums of what an estimate leaves of the samples that follow it.

The estimate before a look of samples leaves mean scores m of them; H m is a change of the parameters, see
`equation_map`. Each parameter's is divided by a robust scale of those before it, the median of their
magnitudes, limited, and summed up to both sides less a drift. A sum beyond the threshold is a change: what
lies before the last looks is forgotten then.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.shapes import Float

#: Median magnitude of normal numbers over their standard deviation, inverted.
NORMAL_MEDIAN = 1.4826
#: Looks after a change that are listened to only: one memory, until what was kept of before has faded.
REST = 8


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

    Raises
    ------
    UsageError
        When one is not above zero, or the limit is not above the drift.
    """

    threshold: float = 9.0
    drift: float = 0.75
    limit: float = 4.0
    scale_looks: int = 80
    least_looks: int = 20
    kept_looks: int = 3

    def __post_init__(self) -> None:
        for name in ("threshold", "drift", "limit"):
            checks.number(name, getattr(self, name))
        for name in ("scale_looks", "least_looks", "kept_looks"):
            checks.whole(name, getattr(self, name))
        above = (self.threshold, self.drift, self.scale_looks, self.least_looks, self.kept_looks)
        if not all(number > 0 for number in above):
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
    before : ndarray, shape (looks, n)
        Last changes that looks showed.
    up, down : ndarray, shape (n,)
        Sums to both sides.
    resting : int
        Looks that are not summed any more, after a change.
    """

    before: Float[np.ndarray, "looks n"] = field(default_factory=lambda: np.zeros((0, 0)))
    up: Float[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(0))
    down: Float[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(0))
    resting: int = 0

    def after(self, shown: Float[np.ndarray, " n"], detector: ChangeDetector) -> Watch:
        """With one more look."""
        before = self.before if self.before.size else np.zeros((0, shown.size))
        units = np.zeros_like(shown)
        if before.shape[0] >= detector.least_looks:
            scale = NORMAL_MEDIAN * np.median(np.abs(before), axis=0)
            np.divide(shown, scale, out=units, where=scale > 0.0)
            units = np.clip(units, -detector.limit, detector.limit)
        if self.resting:
            units = np.zeros_like(shown)
        up, down = (self.up, self.down) if self.up.size else (np.zeros_like(shown), np.zeros_like(shown))
        return Watch(
            np.concatenate([before, shown[None, :]])[-detector.scale_looks :],
            np.maximum(up + units - detector.drift, 0.0),
            np.maximum(down - units - detector.drift, 0.0),
            max(self.resting - 1, 0),
        )

    def told(self, detector: ChangeDetector) -> tuple[tuple[int, bool], ...]:
        """Numbers of the parameters that changed, and whether they grew."""
        return (
            *((int(j), True) for j in np.flatnonzero(self.up > detector.threshold)),
            *((int(j), False) for j in np.flatnonzero(self.down > detector.threshold)),
        )

    def reset(self) -> Watch:
        """After a change: sums of zero, for a while; the scale is kept."""
        return replace(self, up=np.zeros_like(self.up), down=np.zeros_like(self.down), resting=REST)
