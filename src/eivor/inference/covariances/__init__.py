"""Covariances by name: how the uncertainty of an estimate is estimated.

``estimate.with_covariance(eivor.covariances.KernelRobust(eivor.covariances.Parzen()))`` gives the same
estimates with other intervals. The default of a plain problem is `EqualWeightedCosines`, that of a flight
never narrower than what white residuals ask for as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from eivor.inference.covariances.bandwidth import (
    AndrewsRule,
    Bandwidth,
    FixedBandwidth,
    NeweyWestRule,
    SquareRootRule,
)
from eivor.inference.covariances.estimators import (
    DEFAULT,
    FLIGHT_DEFAULT,
    Classical,
    ClusteredByFlight,
    CovarianceEstimator,
    EqualWeightedCosines,
    HeteroskedasticityRobust,
    Widest,
)
from eivor.inference.covariances.kernel import Bartlett, Kernel, Parzen, QuadraticSpectral
from eivor.inference.covariances.kernel_covariance import KernelRobust

__all__ = [
    "AndrewsRule",
    "Bandwidth",
    "Bartlett",
    "Classical",
    "ClusteredByFlight",
    "CovarianceEstimator",
    "EqualWeightedCosines",
    "FixedBandwidth",
    "HeteroskedasticityRobust",
    "Kernel",
    "KernelRobust",
    "NeweyWestRule",
    "Parzen",
    "QuadraticSpectral",
    "SquareRootRule",
    "Widest",
]

#: Covariances that a study file may name.
TABLE: Mapping[str, Callable[[], CovarianceEstimator]] = {
    "equal_weighted_cosines": lambda: DEFAULT,
    "classical": Classical,
    "heteroskedasticity_robust": HeteroskedasticityRobust,
    "newey_west": lambda: KernelRobust(Bartlett(), NeweyWestRule(), fixed_b=False),
    "andrews": lambda: KernelRobust(QuadraticSpectral(), AndrewsRule(), fixed_b=False),
    "bartlett_fixed_b": lambda: KernelRobust(Bartlett(), SquareRootRule()),
    "widest": lambda: FLIGHT_DEFAULT,
}


def __dir__() -> list[str]:
    """Names that the module offers, and not those that it uses."""
    return __all__
