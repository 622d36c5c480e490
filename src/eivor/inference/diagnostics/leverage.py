"""How much each stretch of a record moves the estimate.

With the test functions kept, the equations of the rest of the record are solved by a step from the estimate,

    theta_(-k) - theta = -(M - M_k)^-1 S_k,   S_k, M_k the scores and the sensitivity of stretch k,

exactly when they are linear. In standard errors of the estimate: one of S stretches that are alike moves a
parameter by about 1/sqrt(S - 1).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eivor.inference.covariances.covariance import unit_scale
from eivor.inference.diagnostics.diagnostic import Diagnostic, Row, Subject
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float, Int

#: Change by one stretch, in standard errors of the estimate, that is worth a look; 1/3 is usual for ten.
LARGE_LEVERAGE = 1.5


@dataclass(frozen=True)
class SegmentLeverage(Diagnostic):
    """What leaving out each stretch does.

    Parameters
    ----------
    shift : ndarray, shape (S, n)
        Change of the estimate when a stretch is left out, in the parameters' units; NaN where the rest
        does not determine them.
    in_std_errors : ndarray, shape (S, n)
        The same over the standard errors of the estimate.
    segments : tuple of (int, int)
        First row and end of each stretch.
    """

    shift: Float[np.ndarray, "S n"]
    in_std_errors: Float[np.ndarray, "S n"]
    segments: tuple[tuple[int, int], ...]

    @property
    def most(self) -> Int[np.ndarray, " n"]:
        """The stretch that moves each parameter most."""
        return np.argmax(np.nan_to_num(np.abs(self.in_std_errors), nan=-1.0), axis=0)

    @property
    def largest(self) -> Float[np.ndarray, " n"]:
        """By how much it does, in standard errors, with its sign."""
        return self.in_std_errors[self.most, np.arange(self.shift.shape[1])]

    def rows(self, of: Subject, /) -> Iterator[Row]:
        """The largest change of each parameter, and by which stretch."""
        for j, name in enumerate(of.names):
            yield Row("leverage", f"{name}, {self._where(j, of)}", float(self.largest[j]), 1.0)

    def lines(self, of: Subject, /) -> Iterator[str]:
        """The largest change of each parameter, and by which stretch."""
        for j, name in enumerate(of.names):
            where = f"standard errors of {name}, {self._where(j, of)}"
            yield f"largest leverage     {self.largest[j]:>+10.2f}  {where}"

    def reasons(self, of: Subject, /) -> Iterator[Reason]:
        """Stretches that move a parameter much."""
        for j, name in enumerate(of.names):
            by = float(self.largest[j])
            if abs(by) > LARGE_LEVERAGE:
                yield Reason(
                    Status.WEAK,
                    f"One stretch of the record, from {self._where(j, of)}, moves {name} by {abs(by):.1f} "
                    "standard errors.",
                    "Look at it, and identify without it.",
                )

    def _where(self, j: int, of: Subject) -> str:
        first, end = self.segments[self.most[j]]
        return f"{of.at_row(first)} to {of.at_row(end)}"


def segment_leverage(
    sums: Float[np.ndarray, "S n"],
    sensitivities: Float[np.ndarray, "S n n"],
    std_errors: Float[np.ndarray, " n"],
    segments: tuple[tuple[int, int], ...],
) -> SegmentLeverage:
    """Drop-one estimates from the stretches' own equations. Performs no checks.

    Parameters
    ----------
    sums : ndarray, shape (S, n)
        Sum of the scores over each stretch; zero in total.
    sensitivities : ndarray, shape (S, n, n)
        Minus their derivatives by the estimate.
    std_errors : ndarray, shape (n,)
        Of the estimate.
    segments : tuple of (int, int)
        First row and end of each stretch.
    """
    M = sensitivities.sum(axis=0)
    scale = unit_scale(np.abs(np.diag(M)))
    shift = np.full(sums.shape, np.nan)
    for k, (own, score) in enumerate(zip(sensitivities, sums, strict=True)):
        rest = np.outer(scale, scale) * (M - own)
        if np.linalg.cond(rest) < 1.0 / np.finfo(np.float64).eps:
            shift[k] = -scale * np.linalg.solve(rest, scale * score)
    return SegmentLeverage(shift, shift / std_errors, segments)
