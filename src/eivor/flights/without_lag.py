"""The simplest rival of an estimate: least squares of the same flights that knows of no lag."""

from __future__ import annotations

import numpy as np

from eivor.flights.predicted import SimpleModel
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, LaggedRuns
from eivor.models.separable import Values

#: Its name among simple models, and what it is.
NAME, WORDS = "least_squares", "no-lag least squares"


def least_squares_without_lag(problem: LaggedRuns, at: Values) -> SimpleModel:
    """Least squares of all rows in frequency with neither lag nor delay.

    Parameters
    ----------
    problem : LaggedRuns
        Of the flights.
    at : mapping of str to float
        Values of all nuisances, of which lag and delay count as zero.
    """
    without = {**at, ACTUATOR_LAG.name: 0.0, DELAY.name: 0.0}
    bins = problem.bins(without)
    rows = np.concatenate([bins.regressors.real, bins.regressors.imag])
    response = np.concatenate([bins.responses[:, 0].real, bins.responses[:, 0].imag])
    sizes = np.sqrt((rows * rows).sum(axis=0))
    sizes[sizes == 0.0] = 1.0
    fitted = np.linalg.lstsq(rows / sizes, response)[0] / sizes
    names = (parameter.name for parameter in problem.parameters)
    return SimpleModel(WORDS, {**without, **dict(zip(names, fitted.tolist(), strict=True))})
