"""Confidence sets: every shape a quadratic inequality can give, roots to rounding, and how they read."""

from __future__ import annotations

from math import inf

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eivor.errors import ParameterError
from eivor.inference.confidence_set import ConfidenceSet

COEFFICIENT = st.floats(min_value=-1e6, max_value=1e6, allow_subnormal=False)


@pytest.mark.parametrize(
    ("coefficients", "wanted", "text"),
    [
        ((1.0, -3.0, 2.0), ((1.0, 2.0),), "[1, 2]"),
        ((-1.0, 3.0, -2.0), ((-inf, 1.0), (2.0, inf)), "(-inf, 1] or [2, inf)"),
        ((1.0, 0.0, 1.0), (), "empty"),
        ((-1.0, 0.0, -1.0), ((-inf, inf),), "the whole line"),
        ((1.0, -2.0, 1.0), ((1.0, 1.0),), "{1}"),
        ((-1.0, 2.0, -1.0), ((-inf, inf),), "the whole line"),
        ((1.0, 0.0, 0.0), ((0.0, 0.0),), "{0}"),
        ((0.0, 2.0, -1.0), ((-inf, 0.5),), "(-inf, 0.5]"),
        ((0.0, -2.0, 1.0), ((0.5, inf),), "[0.5, inf)"),
        ((0.0, 0.0, 1.0), (), "empty"),
        ((0.0, 0.0, 0.0), ((-inf, inf),), "the whole line"),
        ((0.0, 1e-300, 1e300), (), "empty"),
    ],
)
def test_quadratic_inequalities_of_every_kind(coefficients, wanted, text):
    from_quadratic = ConfidenceSet.from_quadratic(*coefficients)
    assert from_quadratic.intervals == wanted
    assert str(from_quadratic) == text


@pytest.mark.parametrize(
    "coefficients",
    [
        (1.0, -1e8, 1.0),
        (1e-200, -1e100, 1e-3),
        (1e300, -3e300, 2e300),
        (1.0, -2.0000000000000004, 1.0),
        (94906265.625, -2 * 94906267.0, 94906268.375),  # Kahan's: the discriminant is lost in doubles
        (5e-324, -1.0, 1.0),
    ],
)
def test_roots_are_right_to_rounding(coefficients):
    with mpmath.workdps(700):
        a, b, c = map(mpmath.mpf, coefficients)
        root = mpmath.sqrt(b * b - 4 * a * c)
        low, high = (-b - root) / (2 * a), (-b + root) / (2 * a)
        from_quadratic = ConfidenceSet.from_quadratic(*coefficients)
        assert from_quadratic.hull == pytest.approx((float(low), float(high)), rel=3e-16)


def test_whether_there_are_roots_is_decided_exactly():
    assert ConfidenceSet.from_quadratic(1.0, 2.0, 1.0 + 2.0**-52).is_empty
    assert not ConfidenceSet.from_quadratic(1.0, 2.0, 1.0).is_empty


@given(COEFFICIENT, COEFFICIENT, COEFFICIENT, st.floats(-1e3, 1e3))
def test_membership_is_the_inequality(a, b, c, x):
    value = a * x * x + b * x + c
    if abs(value) > 1e-9 * (abs(a * x * x) + abs(b * x) + abs(c)):
        assert ConfidenceSet.from_quadratic(a, b, c).contains(x) == (value <= 0.0)


def test_membership_between_roots():
    outside = ConfidenceSet.from_membership(lambda x: (x <= 1.0) | (x >= 2.0), [2.0, 1.0, inf])
    assert outside.intervals == ((-inf, 1.0), (2.0, inf))
    assert ConfidenceSet.from_membership(lambda x: x == 1.0, [1.0, 3.0]).intervals == ((1.0, 1.0),)
    assert ConfidenceSet.from_membership(np.isfinite, []).is_whole_line
    assert ConfidenceSet.from_membership(np.isnan, []).is_empty
    assert ConfidenceSet.from_membership(lambda x: x >= 0.0, [0.0]).intervals == ((0.0, inf),)


def test_what_a_set_says_of_itself():
    outside = ConfidenceSet.union([(3.0, inf), (-inf, 1.0), (-2.0, 0.5)])
    assert outside.intervals == ((-inf, 1.0), (3.0, inf))
    assert outside.contains(1.0)
    assert not outside.contains(2.0)
    assert not outside.is_bounded
    assert outside.hull == (-inf, inf)
    assert outside.length == inf
    assert outside.scaled(-2.0).intervals == ((-inf, -6.0), (-2.0, inf))
    empty = ConfidenceSet.empty()
    assert empty.is_empty
    assert empty.is_bounded
    assert empty.length == 0.0
    assert empty.hull != empty.hull
    assert ConfidenceSet(((0.0, 1.0),)).is_bounded


def test_sets_that_are_none_are_refused():
    for intervals in [((1.0, 0.0),), ((0.0, 1.0), (1.0, 2.0)), ((float("nan"), 1.0),), ((inf, inf),)]:
        with pytest.raises(ParameterError, match="ascending order"):
            ConfidenceSet(intervals)
    with pytest.raises(ParameterError, match="finite coefficients"):
        ConfidenceSet.from_quadratic(inf, 0.0, 0.0)
    with pytest.raises(ParameterError, match="other than zero"):
        ConfidenceSet.whole_line().scaled(0.0)
