"""Lengths of which transforms are quick."""

from __future__ import annotations

import pytest

from eivor.signals.filters import FACTORS, fast_length


@pytest.mark.parametrize(
    ("count", "length"), [(1, 1), (28, 28), (29, 28), (31, 30), (11_994, 11_979), (12_000, 12_000)]
)
def test_the_largest_length_of_small_factors(count: int, length: int) -> None:
    assert fast_length(count) == length


def test_little_is_left_out() -> None:
    omitted = [count - fast_length(count) for count in range(9_000, 11_000)]
    assert 29 not in FACTORS
    assert 1 < max(omitted) <= 70
