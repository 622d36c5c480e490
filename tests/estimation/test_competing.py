"""Which candidates are held against which."""

from __future__ import annotations

import numpy as np

from eivor.estimation.variable_projection import bounded_sums, least_comparable_criteria
from eivor.models.regression import Parameter
from eivor.models.separable import Bounds, Nuisance

GRID = np.array([0.0, 0.01, 0.02])
POINTS = [{"lag": lag, "delay": delay} for lag in (0.05, 0.06) for delay in (0.0, 0.01)]
CRITERIA = [4.0, 3.0, 2.0, 1.0]


def test_without_bounds_every_candidate_competes_with_every_other() -> None:
    free = Nuisance(Parameter("lag", "s"), GRID, discrete=True)
    assert bounded_sums([free]) == ()
    assert least_comparable_criteria((), POINTS, CRITERIA) == [1.0, 1.0, 1.0, 1.0]


def test_candidates_of_one_bounded_sum_compete() -> None:
    lag = Nuisance(
        Parameter("lag", "s"), GRID, discrete=True, bounds=Bounds(0.05, 0.07), known_with=("delay",)
    )
    bounded = bounded_sums([Nuisance(Parameter("delay", "s"), GRID, discrete=True), lag])
    assert bounded == (("lag", "delay"),)
    # .05 and .07 stand alone; .05 + .01 and .06 + 0 are one sum, but for rounding
    assert least_comparable_criteria(bounded, POINTS, CRITERIA) == [4.0, 2.0, 2.0, 1.0]
