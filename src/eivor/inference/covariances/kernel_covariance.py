"""Covariance of an estimate by a kernel over the autocovariances of its scores."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from eivor import checks
from eivor.inference.covariances.bandwidth import Bandwidth, NeweyWestRule
from eivor.inference.covariances.covariance import CovariancePart, sandwich
from eivor.inference.covariances.estimators import CovarianceEstimator
from eivor.inference.covariances.fixed_b import FixedBReference, fixed_b_reference
from eivor.inference.covariances.kernel import Bartlett, Kernel, kernel_sum_covariance
from eivor.inference.estimating_equation import EstimatingEquation
from eivor.shapes import Float


@dataclass(frozen=True, slots=True)
class KernelRobust(CovarianceEstimator):
    """V = sum_l k(l/S) sum_t s_t s_{t-l}' (Newey and West 1987; Andrews 1991).

    Parameters
    ----------
    kernel : Kernel
        Weights of the lags.
    bandwidth : Bandwidth
        How many lags.
    fixed_b : bool
        Take critical values that allow for the bandwidth (Kiefer and Vogelsang 2005); normal ones, which
        are too short unless the bandwidth is a small share of the record, when False.
    """

    kernel: Kernel = field(default_factory=Bartlett)
    bandwidth: Bandwidth = field(default_factory=NeweyWestRule)
    fixed_b: bool = True

    def __post_init__(self) -> None:
        checks.kind("kernel", self.kernel, Kernel, "a kernel", "Make one: ev.covariances.Bartlett().")
        checks.kind(
            "bandwidth",
            self.bandwidth,
            Bandwidth,
            "a bandwidth",
            "Make one: ev.covariances.FixedBandwidth(9).",
        )
        checks.flag("fixed_b", self.fixed_b)

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """One part; see `kernel_sum_covariance` for its cost."""

        def blocks() -> Iterator[Float[np.ndarray, "_ n"]]:
            return (rows.scores for rows in equation.blocks())

        def own() -> Iterator[Float[np.ndarray, "_ n"]]:
            return (scores @ equation.root for scores in blocks())

        count = equation.sample_count
        # Beyond the record's length there is no lag to count, and a longer span would only shrink the sum.
        lags = min(self.bandwidth.lags(own, count, self.kernel), count - 1.0)
        meat = kernel_sum_covariance(blocks(), count, self.kernel, lags)
        matrix = sandwich(equation.slope, meat + equation.prior_covariance)
        reference = FixedBReference(math.inf, 1.0)
        span = self.kernel.span(lags)
        if self.fixed_b and lags > 0.0:
            reference = fixed_b_reference(self.kernel, span / count)
        return (CovariancePart(self.kernel.name, matrix, reference.degrees, reference.share),)
