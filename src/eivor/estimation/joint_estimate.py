"""A vector of estimates with its covariance: all that is left of an estimate in a document of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.inference.covariances.covariance import JointCovariance
from eivor.shapes import Float


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """A vector of estimates with its covariance.

    Parameters
    ----------
    values : ndarray, shape (n,)
        The vector.
    covariance : JointCovariance
        Of it.
    """

    values: Float[np.ndarray, " n"]
    covariance: JointCovariance
