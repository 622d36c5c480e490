"""Problems that are linear but for a few nuisance parameters that move columns.

For every value of the actuator's lag and delay there is one regression; the linear parameters are solved
inside and the nuisance is searched outside (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float

from eivor.models.parameter import Parameter
from eivor.models.regression import Regression
from eivor.models.spectral import SpectralRegression

#: The nuisance parameters' names, as in every result.
ACTUATOR_LAG = Parameter("actuator_lag", "s")
DELAY = Parameter("delay", "s")


class SeparableProblem(ABC):
    """A regression for each lag and delay of the actuator."""

    @property
    @abstractmethod
    def lag_grid_s(self) -> Float[np.ndarray, " lags"]:
        """Lags to search [s], increasing; a single one when the lag is known."""

    @property
    @abstractmethod
    def delays_s(self) -> tuple[float, ...]:
        """Delays to try [s]."""

    @abstractmethod
    def samples(self, lag_s: float, delay_s: float) -> Regression:
        """Rows in time."""

    @abstractmethod
    def bins(self, lag_s: float, delay_s: float) -> SpectralRegression:
        """Rows in frequency, one block for each run."""
