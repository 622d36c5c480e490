"""A search of few lags and delays, for tests of what is done with a result.

The full search takes most of the time of a flight. It finds the same minimum if the delay is one of the few.
"""

from __future__ import annotations

import hashlib
import inspect
import pickle
from contextlib import contextmanager

import numpy as np
import pytest

#: Lags [s] between the ends of the full grid, and delays [s]: an eighth of its points.
LAGS_S, DELAYS_S = np.geomspace(0.002, 0.3, 12), (0.0, 0.020)
#: Accuracy of lag and delay of a rigid body [s]: a fiftieth of a standard error, for two thirds of the time.
BODY_TOLERANCE_S = 1e-5


@contextmanager
def coarse():
    """Flights are searched on the coarse grids."""
    from eivor.motions.rigid_body import regression

    with searched_on((LAGS_S, DELAYS_S)), pytest.MonkeyPatch.context() as patch:
        patch.setattr(regression, "TOLERANCE_S", BODY_TOLERANCE_S)
        yield


@contextmanager
def searched_on(grids):
    """Flights are searched on these grids."""
    from eivor.models.lagged_runs import lag_and_delay

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inspect.unwrap(lag_and_delay), "__defaults__", grids)
        yield


#: Results by logs, options, grids and motions, with the stages of their progress; the last so many are kept.
RESULTS, MOST_RESULTS = {}, 16


@contextmanager
def identified_once():
    """The same logs with the same options are identified once; not for tests that change how that is done."""
    from eivor.models.lagged_runs import lag_and_delay
    from eivor.motions import identify
    from eivor.motions.rigid_body import regression

    work, search = identify.identified, inspect.unwrap(lag_and_delay)

    def known(logs, motion, options, windows, others, lag_measurements, progress, begun):
        given = logs, options, windows, lag_measurements, search.__defaults__, regression.TOLERANCE_S
        key = (hashlib.sha256(pickle.dumps(given)).digest(), id(motion), *map(id, others))
        if key not in RESULTS:
            stages = []

            def noted(stage):
                stages.append(stage)
                progress(stage)

            result = work(logs, motion, options, windows, others, lag_measurements, noted, begun)
            while len(RESULTS) >= MOST_RESULTS:
                del RESULTS[next(iter(RESULTS))]
            RESULTS[key] = result, stages, motion, others
            return result
        result, stages, *_ = RESULTS[key]
        for stage in stages:
            progress(stage)
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identify, "identified", known)
        yield


@contextmanager
def full():
    """Flights are searched as a user's are."""
    from eivor.models.lagged_runs import DELAYS_S, LAG_GRID_S

    with searched_on((LAG_GRID_S, DELAYS_S)):
        yield
