"""A search of few lags and delays, for tests of what is done with a result.

The full search takes most of the time of a flight. It finds the same minimum if the delay is one of the few.
"""

from __future__ import annotations

import inspect
from contextlib import contextmanager

import numpy as np
import pytest

#: Lags [s] between the ends of the full grid, and delays [s]: an eighth of its points.
LAGS_S, DELAYS_S = np.geomspace(0.002, 0.3, 12), (0.0, 0.020)


@contextmanager
def coarse():
    """Flights are searched on the coarse grids."""
    with searched_on((LAGS_S, DELAYS_S)):
        yield


@contextmanager
def searched_on(grids):
    """Flights are searched on these grids."""
    from eivor.models.lagged_runs import lag_and_delay

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inspect.unwrap(lag_and_delay), "__defaults__", grids)
        yield


@contextmanager
def full():
    """Flights are searched as a user's are."""
    from eivor.models.lagged_runs import DELAYS_S, LAG_GRID_S

    with searched_on((LAG_GRID_S, DELAYS_S)):
        yield
