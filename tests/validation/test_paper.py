"""The numbers of the errata."""

from __future__ import annotations

import re

import numpy as np
import pytest

from validation.paper.page import INERTIA, errata


@pytest.fixture(scope="module")
def checks():
    return {item.where: item.check for item in errata(4)}


def numbers(sentence):
    return [float(word) for word in re.findall(r"[+-]?\d+\.?\d*(?:e[+-]?\d+)?", sentence)]


@pytest.mark.thorough
def test_what_is_used_errs_less_than_what_is_printed(checks):
    sign = numbers(checks["(6)-(10), (12), (15)-(17), (20), (23)-(27), (29)-(34)"].partition("LS")[2])
    assert sign[-1] > 100.0 * sign[0]
    right, printed_row, without_count, without_any = re.findall(r"([\d.]+) %", checks["(29)"])
    assert 3.0 * float(right) < min(float(printed_row), float(without_count))
    assert float(without_count) == pytest.approx(float(without_any), rel=0.01)
    for where in ("(13)", "W of (13), (29)"):
        right, wrong = re.findall(r"([\d.]+) %", checks[where])
        assert 3.0 * float(right) < float(wrong)


def test_euler_angles_are_no_body_rates(checks):
    """By hand: phi'' = p' + theta' psi' at zero tilt, and so on."""
    x, y, z = INERTIA
    printed = np.array([(y - z) / x, (z - x) / y, (x - y) / z])
    match = re.findall(r"([+-][\d.]+) \(printed ([+-][\d.]+)\)", checks["(1) rows 1 to 3"])
    np.testing.assert_allclose(np.array(match, dtype=float)[:, 1], printed, atol=0.005)
    turned = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(np.array(match, dtype=float)[:, 0], printed + turned, atol=0.005)


def test_the_error_of_the_variables_has_the_other_sign(checks):
    right, wrong = re.findall(r"to (\S+);.* by (\d+) %", checks["(12)"])[0]
    assert float(right) < 1e-12
    assert float(wrong) > 50.0


def test_least_squares_of_the_system_that_has_instruments(checks):
    right, wrong = re.findall(r"to (\S+);.* by (\d+) %", checks["(24)"])[0]
    assert float(right) < 1e-9
    assert float(wrong) > 10.0
    assert float(re.findall(r"to (\S+)\.$", checks["(25)"])[0]) < 1e-9
