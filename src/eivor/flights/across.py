"""What of a motion is compared over the flights of a fleet, and by what."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Covariate:
    """What a quantity goes with.

    Parameters
    ----------
    name : str
        Column of a fleet's table; its logarithm counts.
    slope, uncertainty : float
        The power of it that the quantity goes with, as far as that is known beforehand (one standard
        deviation).
    """

    name: str
    slope: float = 0.0
    uncertainty: float = math.inf


@dataclass(frozen=True, slots=True)
class AcrossFlights:
    """A quantity that flights of one vehicle share but for chance.

    Parameters
    ----------
    name : str
        Of the quantity.
    logarithm : bool
        Compared as its logarithm: what changes it multiplies it, and it is positive.
    covariates : tuple of Covariate
        What it goes with.
    largest : float
        Bound of a quantity that is a share, such as 1: means and intervals are those of its logit,
        log(x / (largest - x)), so that they stay between zero and the bound. It needs `logarithm`. A type
        whose flights lie above it for the most part has another unit, and no bound.
    told_by : tuple of str
        Parameters by whose first-stage F a flight tells it: where its excitation cannot tell them it is left
        out, and nowhere else, since leaving out by the value itself would bias the mean.
    """

    name: str
    logarithm: bool = False
    largest: float = math.inf
    covariates: tuple[Covariate, ...] = ()
    told_by: tuple[str, ...] = ()
