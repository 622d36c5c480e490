"""Estimators of an estimate's covariance: one axis, one final class for each assumption on the scores.

| class | the scores may be | critical values |
|---|---|---|
| `Classical` | white, of one variance | normal |
| `HeteroskedasticityRobust` | white, of any variance | normal |
| `KernelRobust` | autocorrelated with short memory | normal, or fixed-b |
| `EqualWeightedCosines` | autocorrelated | t on the number of averages |
| `ClusteredByFlight` | anything within a flight | t on flights - 1 |
| `Widest` | what the widest of several allows | each its own |

Each reads the rows in blocks, in their order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.inference.covariances.covariance import CovariancePart, JointCovariance, sandwich
from eivor.inference.covariances.equal_weighted_cosines import COSINE_AVERAGES, cosine_covariance
from eivor.inference.estimating_equation import EstimatingEquation
from eivor.shapes import Float

#: Pools of at least so many flights have their covariance clustered by flight as well.
CLUSTERED_FROM = 10


class CovarianceEstimator(ABC):
    """A way to estimate the covariance of a sum of scores."""

    @abstractmethod
    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """Covariances of the estimates, the leading one first; none when the rows cannot tell.

        Raises
        ------
        CollinearError
            When the sensitivity is singular.
        """

    def joint(self, equation: EstimatingEquation) -> JointCovariance:
        """Covariance of the joint vector.

        Raises
        ------
        UsageError
            When the rows cannot tell, as a single flight cannot be clustered.
        """
        parts = self.parts(equation)
        if not parts:
            raise UsageError(
                f"rows that {type(self).__name__} can use", "too few flights", "Choose another covariance."
            )
        found = JointCovariance(parts)
        return found if equation.move is None else found.beside(equation.move)


def check_covariance_estimator(estimator: object) -> None:
    """Refuse what is no estimator of covariances.

    Raises
    ------
    UsageError
        With what came instead.
    """
    checks.kind(
        "covariance",
        estimator,
        CovarianceEstimator,
        "one of eivor.covariances",
        "Make one: ev.covariances.Classical().",
    )


@dataclass(frozen=True, slots=True)
class Classical(CovarianceEstimator):
    """V = s^2 P'P: residuals are white, all of one variance, and independent of the test functions.

    Those of compensated equations are not: there the instruments share noise with the residual, and this
    covariance is too small.
    """

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """One part; O(rows n^2)."""
        unknowns = equation.unknowns
        power, count, products = 0.0, 0, np.zeros((unknowns, unknowns))
        for rows in equation.blocks():
            products += rows.test_functions.T @ rows.test_functions
            power += float(rows.residual @ rows.residual)
            count += rows.residual.size
        variance = power / max(count - unknowns, 1)
        return (
            CovariancePart(
                "classical", sandwich(equation.slope, variance * products + equation.prior_covariance)
            ),
        )


@dataclass(frozen=True, slots=True)
class HeteroskedasticityRobust(CovarianceEstimator):
    """V = sum s_t s_t' (White 1980): scores are uncorrelated, their variance may change."""

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """One part; O(rows n^2)."""
        unknowns = equation.unknowns
        products: Float[np.ndarray, "n n"] = np.zeros((unknowns, unknowns))
        for rows in equation.blocks():
            products += rows.scores.T @ rows.scores
        return (
            CovariancePart(
                "heteroskedasticity_robust", sandwich(equation.slope, products + equation.prior_covariance)
            ),
        )


@dataclass(frozen=True, slots=True)
class EqualWeightedCosines(CovarianceEstimator):
    """V from equal-weighted cosine averages of the scores (Lazarus, Lewis, Stock and Watson 2018).

    Parameters
    ----------
    averages : int
        B, number of averages and degrees of freedom. The default of 8 sees correlation up to about an
        eighth of the record's length; more give shorter intervals that see less. A record has no more of
        them than scores beyond its unknowns; without any of those, intervals have no bound.

    Raises
    ------
    UsageError
        When there is less than one average.
    """

    averages: int = COSINE_AVERAGES

    def __post_init__(self) -> None:
        checks.whole("averages", self.averages)
        if self.averages < 1:
            raise UsageError("one cosine average or more", f"{self.averages}", "Eight are the default.")

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """One part; O(rows n B)."""
        scores = (rows.scores for rows in equation.blocks())
        count, unknowns = equation.sample_count, equation.unknowns
        averages = max(min(self.averages, count - unknowns), 1)
        meat = cosine_covariance(scores, count, averages)
        matrix = sandwich(equation.slope, meat + equation.prior_covariance)
        degrees = float(averages) if count > unknowns else 0.0
        return (CovariancePart("equal_weighted_cosines", matrix, degrees),)


@dataclass(frozen=True, slots=True)
class ClusteredByFlight(CovarianceEstimator):
    """V from the sums of each flight: any dependence within a flight, none between flights.

    Parameters
    ----------
    least_flights : int
        With fewer flights there is no part.
    """

    least_flights: int = CLUSTERED_FROM

    def __post_init__(self) -> None:
        checks.whole("least_flights", self.least_flights)

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """One part, with t on flights - 1 degrees of freedom, or none."""
        sums: dict[int, Float[np.ndarray, " n"]] = {}
        for rows in equation.blocks():
            for flight in np.unique(rows.flight_of_row):
                here = rows.flight_of_row == flight
                total = rows.test_functions[here].T @ rows.residual[here]
                if rows.constant is not None:
                    total = total + int(here.sum()) * rows.constant
                sums[int(flight)] = sums.get(int(flight), 0.0) + total
        flights = len(sums)
        if flights < max(self.least_flights, 2):
            return ()
        stacked = np.stack(list(sums.values()))
        stacked -= stacked.mean(axis=0)
        meat = stacked.T @ stacked * flights / (flights - 1)
        return (
            CovariancePart(
                "clustered", sandwich(equation.slope, meat + equation.prior_covariance), float(flights - 1)
            ),
        )


@dataclass(frozen=True, slots=True)
class Widest(CovarianceEstimator):
    """Several covariances; an interval is the widest that one of them asks for.

    Parameters
    ----------
    estimators : tuple of CovarianceEstimator
        The leading one first: correlations are its.
    """

    estimators: tuple[CovarianceEstimator, ...]

    def __post_init__(self) -> None:
        checks.items("estimators", self.estimators, CovarianceEstimator, "covariances")
        if not self.estimators:
            raise UsageError("one covariance or more", "none", "Name those that are to be compared.")

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """Parts of all."""
        return tuple(part for estimator in self.estimators for part in estimator.parts(equation))


#: Default: what covers in autocorrelated and heteroskedastic errors alike.
DEFAULT = EqualWeightedCosines()
#: Of a flight: as the default, never narrower than white residuals ask for, and clustered in large pools.
FLIGHT_DEFAULT = Widest((EqualWeightedCosines(), Classical(), ClusteredByFlight()))
