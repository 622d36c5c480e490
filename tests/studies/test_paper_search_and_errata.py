"""The search through all combinations, and the errata's numbers."""

from __future__ import annotations

import re

import numpy as np
import pytest

from eivor.studies import paper_search
from eivor.studies.paper_errata import errata
from eivor.studies.paper_search import INSTRUMENTS, search_page, simulations, try_simulation


@pytest.fixture(scope="module")
def tried() -> list[paper_search.Tried]:
    return try_simulation(next(iter(simulations())), 3)


def test_every_combination_is_searched_once():
    combinations = list(simulations())
    assert len(combinations) == len(set(combinations)) == 2 * 8 * 2 * 2 * 2 * 4 * 2 * 2


def test_each_choice_of_instruments_is_tried_with_both_solvers_where_there_are_enough(tried):
    assert len(tried) == 2 * len(INSTRUMENTS) - 2  # n = 2 has no total least squares solution
    assert all(np.isfinite(one.means).all() for one in tried)


def test_distance_is_a_factor(tried):
    one = tried[0]
    printed, _ = paper_search.printed_table()
    twice = paper_search.Tried(one.reading, 2.0 * printed, one.spreads, one.total_least_squares)
    assert twice.off_by((0, 1, 2), spreads=False) == pytest.approx(2.0)
    assert twice.off_by((0, 2), spreads=False) == pytest.approx(2.0)


def test_the_page_shows_what_is_nearest(tried):
    page = search_page(tried, 3)
    assert "10 combinations" in page
    assert page.count("| **printed** | 6.43 ± 0.074 / 6.32 ± 0.075 |") == 4


@pytest.fixture(scope="module")
def checks() -> dict[str, str]:
    return {item.where: item.check for item in errata(4)}


def numbers(sentence: str) -> list[float]:
    return [float(word) for word in re.findall(r"[+-]?\d+\.?\d*(?:e[+-]?\d+)?", sentence)]


def test_what_is_used_errs_less_than_what_is_printed(checks):
    sign = numbers(checks["(6)-(9), (12)-(16), (23)-(34)"].partition("LS")[2])
    assert sign[-1] > 100.0 * sign[0]
    right, printed_row, without_count, without_any = re.findall(r"([\d.]+) %", checks["(29)"])
    assert 3.0 * float(right) < min(float(printed_row), float(without_count))
    assert float(without_count) == pytest.approx(float(without_any), rel=0.01)
    right, wrong = re.findall(r"([\d.]+) %", checks["(13)"])
    assert float(right) < float(wrong)


def test_the_first_unknown_is_the_residual_over_sigma(checks):
    agreement = re.search(r"residual to (\S+);", checks["(27), (33)"])
    assert agreement
    assert float(agreement[1]) < 1e-9


def test_table_2_is_not_half_normal_as_printed(checks):
    assert numbers(checks["table 2, GIV"])[0] == 2.13
