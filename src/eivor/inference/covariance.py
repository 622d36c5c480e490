"""Covariance of an estimate from its estimating equation ``sum of p_t e_t = 0``.

Notation: G (rows x n) Jacobian of the residual's model part, P (rows x n) test functions, e residual,
M = P'G. Then theta_hat - theta = M^-1 P'e to first order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from eivor.errors import CollinearError
from eivor.inference.quantiles import normal_quantile, t_quantile

#: Number of cosine averages of the autocorrelation-robust covariance.
COSINE_AVERAGES = 8
#: Pools of at least so many flights have their covariance clustered by flight as well.
CLUSTERED_FROM = 10


@dataclass(frozen=True)
class JointCovariance:
    """Covariances of one vector of estimates under successively weaker assumptions on the residual.

    Parameters
    ----------
    white : ndarray, shape (n, n)
        For white residuals.
    robust : ndarray, shape (n, n)
        Autocorrelation-robust, from `averages` equal-weighted cosine averages of the scores.
    clustered : ndarray, shape (n, n), optional
        For residuals with any dependence within a flight and none between flights.
    averages : int
        Degrees of freedom of `robust`.
    clusters : int
        Number of flights.
    """

    white: Float[np.ndarray, "n n"]
    robust: Float[np.ndarray, "n n"]
    clustered: Float[np.ndarray, "n n"] | None = None
    averages: int = COSINE_AVERAGES
    clusters: int = 1

    def std_error(self, direction: Float[np.ndarray, " n"]) -> float:
        """Largest of the standard errors of ``direction @ estimates``."""
        return float(np.sqrt(max(_variance(C, direction) for C in self._parts())))

    def half_width(
        self, direction: Float[np.ndarray, " n"], level: float = 0.95, extra_variance: float = 0.0
    ) -> float:
        """Half-width of the interval for ``direction @ estimates``: the widest of the assumptions'.

        Parameters
        ----------
        direction : ndarray, shape (n,)
            Gradient of the quantity.
        level : float
            Confidence level.
        extra_variance : float
            Variance to add that does not come from the estimates.
        """
        quantiles = [
            normal_quantile(level),
            t_quantile(level, self.averages),
            t_quantile(level, self.clusters - 1),
        ]
        return max(
            quantile * float(np.sqrt(_variance(C, direction) + extra_variance))
            for quantile, C in zip(quantiles, self._parts(), strict=False)
        )

    @property
    def matrix(self) -> Float[np.ndarray, "n n"]:
        """Robust correlations, with the largest of the standard errors on the diagonal."""
        size = self.robust.shape[0]
        largest = np.array([self.std_error(direction) for direction in np.eye(size)])
        own = np.sqrt(np.diag(self.robust))
        scale = np.divide(largest, own, out=np.zeros(size), where=own > 0.0)
        return self.robust * np.outer(scale, scale)

    def _parts(self) -> list[Float[np.ndarray, "n n"]]:
        return [self.white, self.robust] + ([] if self.clustered is None else [self.clustered])


def joint_covariance(
    *,
    sensitivity: Float[np.ndarray, "n n"],
    test: Float[np.ndarray, "rows n"],
    residual: Float[np.ndarray, " rows"],
    variance: float,
    scores: Float[np.ndarray, "samples n"],
    flight_of_row: Int[np.ndarray, " rows"],
) -> JointCovariance:
    """Covariances of the solution of ``test.T @ residual = 0``. Performs no checks.

    Parameters
    ----------
    sensitivity : ndarray, shape (n, n)
        M, minus the derivative of ``test.T @ residual`` by the estimates.
    test, residual : ndarray, shapes (rows, n) and (rows,)
        P and e; rows in the regression's order.
    variance : float
        Residual variance s^2 per row.
    scores : ndarray, shape (samples, n)
        Products p_t e_t in time order, adding up to ``test.T @ residual``.
    flight_of_row : ndarray of int, shape (rows,)
        For clustering.
    """
    M = sensitivity
    flights = np.unique(flight_of_row)
    clustered = None
    if flights.size >= CLUSTERED_FROM:
        sums = np.stack([test[flight_of_row == f].T @ residual[flight_of_row == f] for f in flights])
        sums -= sums.mean(axis=0)
        clustered = sandwich(M, sums.T @ sums * flights.size / (flights.size - 1))
    return JointCovariance(
        white=sandwich(M, variance * (test.T @ test)),
        robust=sandwich(M, long_run_sum_covariance(scores)),
        clustered=clustered,
        clusters=int(flights.size),
    )


def sandwich(M: Float[np.ndarray, "n n"], meat: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """M^-1 meat M^-T without an explicit inverse.

    A sensitivity that is singular but for rounding gives the huge variances that it deserves.

    Raises
    ------
    CollinearError
        When the sensitivity is singular altogether.
    """
    # units apart by many powers of ten (a gain per squared rotor speed) must not pass for collinearity
    diagonal = np.abs(np.diag(M))
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    both = np.outer(scale, scale)
    try:
        half = np.linalg.solve(both * M, both * meat)
        covariance: Float[np.ndarray, "n n"] = both * np.linalg.solve(both * M, half.T)
    except np.linalg.LinAlgError as error:
        raise CollinearError(
            "equations that tell every parameter from the others",
            "a singular sensitivity of the equations to the parameters",
            "Give data in which response and regressors move, each in its own way.",
        ) from error
    return 0.5 * (covariance + covariance.T)


def long_run_sum_covariance(
    scores: Float[np.ndarray, "samples n"], averages: int = COSINE_AVERAGES
) -> Float[np.ndarray, "n n"]:
    """Covariance of the sum of autocorrelated scores by equal-weighted cosines (EWC).

    L_j = sqrt(2/N) sum_t g_t cos(pi j (t - 1/2) / N), j = 1..B; (N/B) sum_j L_j L_j' (Lazarus, Lewis,
    Stock and Watson 2018). Performs no checks; O(N B).
    """
    count = scores.shape[0]
    time = (np.arange(count) + 0.5) / count
    cosines = np.cos(np.pi * np.outer(np.arange(1, averages + 1), time))
    L = np.sqrt(2.0 / count) * cosines @ scores
    covariance: Float[np.ndarray, "n n"] = (count / averages) * L.T @ L
    return covariance


def long_run_mean_variance(series: Float[np.ndarray, " samples"], averages: int = COSINE_AVERAGES) -> float:
    """Variance of the mean of an autocorrelated series, by the same cosine averages."""
    return float(long_run_sum_covariance(series[:, None], averages)[0, 0]) / series.size**2


def _variance(C: Float[np.ndarray, "n n"], direction: Float[np.ndarray, " n"]) -> float:
    return max(float(direction @ C @ direction), 0.0)
