"""Long memory of the residual: the order of a fractional noise that its lowest frequencies look like."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eivor.inference.diagnostics.diagnostic import Diagnostic, Row, Subject
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float
from eivor.signals.long_memory import LEAST_BANDWIDTH, estimate_long_memory

#: Longer records are averaged down to this many samples first.
LONGEST = 8192
#: Memory from which a residual is not stationary, and its long-run variance not finite.
NOT_STATIONARY = 0.5


@dataclass(frozen=True, slots=True)
class ResidualMemory(Diagnostic):
    """Memory of a residual.

    Parameters
    ----------
    memory : float
        d = -order of the fractional noise: 0 without memory, positive for a residual that drifts, 1 for a
        random walk.
    order_error : float
        Standard error.
    """

    memory: float
    order_error: float

    @property
    def drifts(self) -> bool:
        """Whether the residual is clearly not stationary."""
        return bool(self.memory - 2.0 * self.order_error > NOT_STATIONARY)

    def rows(self, _of: Subject, /) -> Iterator[Row]:
        """The memory and its standard error."""
        yield Row("memory", "", self.memory, self.order_error)

    def lines(self, _of: Subject, /) -> Iterator[str]:
        """The memory and its standard error."""
        yield f"memory               {self.memory:>10.3f}  standard error {self.order_error:.3f}"

    def reasons(self, _of: Subject, /) -> Iterator[Reason]:
        """A residual that drifts."""
        if self.drifts:
            yield Reason(
                Status.WEAK,
                f"The residual drifts: its memory is {self.memory:.2f} +- {2.0 * self.order_error:.2f}, and "
                "from 0.5 on its variance grows with the record.",
                "Add an intercept, whiten or difference the signals, or look for a slow term that is "
                "missing.",
            )


def residual_memory(residual: Float[np.ndarray, " rows"]) -> ResidualMemory | None:
    """Local Whittle order of a residual in time order, with its standard error. Performs no checks.

    Parameters
    ----------
    residual : ndarray, shape (rows,)
        e.

    Returns
    -------
    ResidualMemory or None
        None for records of fewer than 17 samples, or constant ones.

    Notes
    -----
    The order is that of the spectrum's slope at low frequencies, which averages over blocks leave alone:
    a long record is averaged to about 8192 samples, so that the transform costs no more than the pass
    over the record. The order is sought between -1 and 1.
    """
    width = -(-residual.size // LONGEST)
    usable = residual.size // width
    means = (
        residual[: usable * width].reshape(usable, width) @ np.full(width, 1.0 / width)
        if width > 1
        else residual
    )
    spread = float(np.ptp(means)) if means.size else 0.0
    if means.size <= 2 * LEAST_BANDWIDTH or spread <= 1e-12 * float(np.abs(means).max()):
        return None
    found = estimate_long_memory(means)
    return ResidualMemory(found.memory, found.order_error)
