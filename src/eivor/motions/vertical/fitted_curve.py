"""A curve of thrust against command that was found out: its family of maps, its parameter, its neighbours."""

from __future__ import annotations

import math
from dataclasses import dataclass

from eivor.estimation.estimate import Estimate
from eivor.motions.vertical.curve_family import CurveFamily


@dataclass(frozen=True)
class FittedCurve:
    """A map that was found out, and estimates with maps to either side.

    Parameters
    ----------
    family : CurveFamily
        Of which maps.
    value : float
        Its parameter.
    bias_std : float
        Standard deviation of the accelerometer's bias that was assumed; infinite for none [m/s^2].
    below, above : tuple of (float, Estimate)
        Parameter and estimate to either side.
    curvature_error : float
        Standard error by curvature alone, where no bias is assumed; infinite where it cannot tell.
    """

    family: CurveFamily
    value: float
    bias_std: float
    below: tuple[float, Estimate]
    above: tuple[float, Estimate]
    curvature_error: float = math.inf
