"""Whether the residual is white: autocorrelations with a band, Ljung and Box, Durbin and Watson."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eivor.inference.diagnostics.diagnostic import SIGNIFICANT, Diagnostic, Row, Subject
from eivor.inference.quantiles import chi_square_tail, normal_quantile
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float

#: Lags that are tested.
LAGS = 20
#: Rows of folded samples that are multiplied at a time: too few for the BLAS to start threads for.
FOLDED_ROWS = 512


@dataclass(frozen=True)
class ResidualWhiteness(Diagnostic):
    """Whiteness of a residual.

    Parameters
    ----------
    autocorrelation : ndarray, shape (L,)
        At lags 1..L. The mean is not taken off: an equation with an intercept has none.
    band : float
        White noise stays within +- this at a given lag with probability .95.
    ljung_box, p_value : float
        N (N + 2) sum r_l^2 / (N - l) and its tail, chi-square on L degrees of freedom (Ljung and Box 1978).
    durbin_watson : float
        sum (e_t - e_t-1)^2 / sum e_t^2: 2 for white noise, near 0 for a drifting residual.
    """

    autocorrelation: Float[np.ndarray, " L"]
    band: float
    ljung_box: float
    p_value: float
    durbin_watson: float

    @property
    def outside(self) -> int:
        """Lags whose autocorrelation is outside the band."""
        return int((np.abs(self.autocorrelation) > self.band).sum())

    def rows(self, _of: Subject, /) -> Iterator[Row]:
        """Both statistics, and every autocorrelation with its band."""
        yield Row("ljung_box", f"{self.autocorrelation.size} lags", self.ljung_box, self.p_value)
        yield Row("durbin_watson", "", self.durbin_watson, 2.0)
        for lag, r in enumerate(self.autocorrelation, start=1):
            yield Row("autocorrelation", f"lag {lag}", float(r), self.band)

    def lines(self, _of: Subject, /) -> Iterator[str]:
        """Both statistics."""
        yield f"whiteness            {self.ljung_box:>10.4g}  Ljung-Box, p-value {self.p_value:.3g}"
        yield f"Durbin-Watson        {self.durbin_watson:>10.4g}"

    def reasons(self, _of: Subject, /) -> Iterator[Reason]:
        """Autocorrelation, which white-noise standard errors do not allow for."""
        if self.p_value < SIGNIFICANT:
            yield Reason(
                Status.IDENTIFIED,
                f"The residual is autocorrelated: {self.outside} of {self.autocorrelation.size} lags are "
                f"outside the band, Durbin-Watson is {self.durbin_watson:.3g}.",
                "Keep a covariance that allows for it; white-noise standard errors are wrong here.",
            )


def residual_whiteness(residual: Float[np.ndarray, " rows"], lags: int = LAGS) -> ResidualWhiteness:
    """Whiteness of a residual in time order. Performs no checks; O(rows lags).

    Parameters
    ----------
    residual : ndarray, shape (rows,)
        e, in any unit.
    lags : int
        L; fewer when the record has less than four times as many samples.
    """
    count = residual.size
    lags = max(min(lags, (count - 1) // 4), 1)
    sums = _autoproducts(residual, lags)
    if not sums[0] > 0.0:
        return ResidualWhiteness(np.zeros(lags), normal_quantile(0.95) / np.sqrt(count), 0.0, 1.0, 2.0)
    r = sums[1:] / sums[0]
    Q = float(count * (count + 2.0) * np.sum(r**2 / (count - np.arange(1, lags + 1))))
    ends = float(residual[0] ** 2 + residual[-1] ** 2)
    watson = 2.0 - (2.0 * float(sums[1]) + ends) / float(sums[0])
    return ResidualWhiteness(r, normal_quantile(0.95) / np.sqrt(count), Q, chi_square_tail(Q, lags), watson)


def _autoproducts(e: Float[np.ndarray, " rows"], lags: int) -> Float[np.ndarray, " lags_plus_1"]:
    """sum_t e_t e_t-l for l = 0..lags, with time folded into rows of `lags` samples.

    R'R holds the products within rows and R_k'R_(k+1) those with the next row: lag l is a diagonal of each.
    """
    rows = e.size // lags
    R = e[: rows * lags].reshape(rows, lags)
    within, across = np.zeros((lags, lags)), np.zeros((lags, lags))
    for start in range(0, rows, FOLDED_ROWS):
        block = R[start : start + FOLDED_ROWS]
        within += block.T @ block
        following = R[start + 1 : start + 1 + FOLDED_ROWS]
        across += block[: following.shape[0]].T @ following
    sums = np.array([np.trace(within, lag) + np.trace(across, lag - lags) for lag in range(lags + 1)])
    for t in range(rows * lags, e.size):
        reach = min(lags, t)
        sums[: reach + 1] += e[t] * e[t - np.arange(reach + 1)]
    return sums
