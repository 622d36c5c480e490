"""Covariances by name: how the uncertainty of an estimate is estimated.

``estimate.with_covariance(eivor.covariances.KernelRobust(eivor.covariances.Parzen()))`` gives the same
estimates with other intervals. The default of a plain problem is `EqualWeightedCosines`, that of a flight
never narrower than what white residuals ask for as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

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
from eivor.late import late_names

if TYPE_CHECKING:
    from eivor.inference.covariances.bandwidth import (
        AndrewsRule,
        Bandwidth,
        FixedBandwidth,
        NeweyWestRule,
        SquareRootRule,
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

__getattr__ = late_names(
    __name__,
    {
        "AndrewsRule": "eivor.inference.covariances.bandwidth",
        "Bandwidth": "eivor.inference.covariances.bandwidth",
        "Bartlett": "eivor.inference.covariances.kernel",
        "FixedBandwidth": "eivor.inference.covariances.bandwidth",
        "Kernel": "eivor.inference.covariances.kernel",
        "KernelRobust": "eivor.inference.covariances.kernel_covariance",
        "NeweyWestRule": "eivor.inference.covariances.bandwidth",
        "Parzen": "eivor.inference.covariances.kernel",
        "QuadraticSpectral": "eivor.inference.covariances.kernel",
        "SquareRootRule": "eivor.inference.covariances.bandwidth",
    },
)


def _newey_west() -> CovarianceEstimator:
    from eivor.inference.covariances.bandwidth import NeweyWestRule
    from eivor.inference.covariances.kernel import Bartlett
    from eivor.inference.covariances.kernel_covariance import KernelRobust

    return KernelRobust(Bartlett(), NeweyWestRule(), fixed_b=False)


def _andrews() -> CovarianceEstimator:
    from eivor.inference.covariances.bandwidth import AndrewsRule
    from eivor.inference.covariances.kernel import QuadraticSpectral
    from eivor.inference.covariances.kernel_covariance import KernelRobust

    return KernelRobust(QuadraticSpectral(), AndrewsRule(), fixed_b=False)


def _bartlett_fixed_b() -> CovarianceEstimator:
    from eivor.inference.covariances.bandwidth import SquareRootRule
    from eivor.inference.covariances.kernel import Bartlett
    from eivor.inference.covariances.kernel_covariance import KernelRobust

    return KernelRobust(Bartlett(), SquareRootRule())


#: Covariances that a study file may name.
TABLE: Mapping[str, Callable[[], CovarianceEstimator]] = {
    "equal_weighted_cosines": lambda: DEFAULT,
    "classical": Classical,
    "heteroskedasticity_robust": HeteroskedasticityRobust,
    "newey_west": _newey_west,
    "andrews": _andrews,
    "bartlett_fixed_b": _bartlett_fixed_b,
    "widest": lambda: FLIGHT_DEFAULT,
}


def __dir__() -> list[str]:
    """Names that the module offers, and not those that it uses."""
    return __all__
