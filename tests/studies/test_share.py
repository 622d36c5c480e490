"""Shares of trials, and the interval that their number allows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from eivor.lab.study import Share


@pytest.mark.parametrize("level", [0.95, 0.99])
@pytest.mark.parametrize(
    ("hits", "count"), [(0, 5), (3, 7), (95, 100), (400, 400), (0, 10), (7, 10), (200, 200)]
)
def test_interval_is_that_of_scipy(hits, count, level):
    """Another implementation of Wilson's interval."""
    theirs = binomtest(hits, count).proportion_ci(level, method="wilson")
    np.testing.assert_allclose(Share(hits, count, level).interval, (theirs.low, theirs.high), atol=1e-12)


def test_share_of_nothing_says_nothing():
    assert np.isnan(Share(0, 0).value)
    assert Share(0, 0).interval == (0.0, 1.0)
