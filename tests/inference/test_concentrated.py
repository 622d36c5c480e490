"""Values that a ratio of quadratic forms allows, against a search over all of them."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from eivor.inference.anderson_rubin import Allowed, allowed, least_ratio
from eivor.inference.confidence_set import ConfidenceSet

VALUES = np.linspace(-30.0, 30.0, 241)


def forms(seed: int, strength: float) -> tuple[np.ndarray, np.ndarray]:
    """N and D of thirty rows, five instruments that move two regressors so much, one more or less."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.standard_normal((30, 5)))[0]
    moved = strength * Q @ rng.standard_normal((5, 2)) + 0.3 * rng.standard_normal((30, 2))
    response = moved @ [0.5, -1.0] + 0.3 * rng.standard_normal(30)
    columns = np.column_stack([response, moved])
    seen = Q.T @ columns
    return seen.T @ seen, columns.T @ columns / 28.0


def searched(N: np.ndarray, D: np.ndarray, value: float) -> float:
    """Least ratio over the other parameter, by searching the angle that its tangent is."""

    def ratio(angle: float) -> float:
        x = np.array([np.cos(angle), -value * np.cos(angle), -np.sin(angle)])
        return float(x @ N @ x / (x @ D @ x))

    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 61)
    best = angles[np.argmin([ratio(angle) for angle in angles])]
    return float(minimize_scalar(ratio, bounds=(best - 0.06, best + 0.06), method="bounded").fun)


@pytest.mark.thorough
@pytest.mark.parametrize("strength", [3.0, 0.3, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_the_values_are_those_that_a_search_finds(seed, strength):
    N, D = forms(seed, strength)
    least = least_ratio(N[None], D[None])[0]
    ratios = np.array([searched(N, D, value) for value in VALUES])
    assert least <= ratios.min() + 1e-8
    for bound in (0.5 * least, least + 1.0, least + 4.0):
        union = ConfidenceSet.union(allowed(N[None], D[None], np.array([bound])).pieces())
        clear = np.abs(ratios - bound) > 1e-4
        inside = np.array([union.contains(float(value)) for value in VALUES])
        assert (inside == (ratios <= bound))[clear].all()


def test_kinds_of_sets_are_all_met():
    kinds = set()
    for seed in range(30):
        N, D = forms(seed, 0.05)
        for bound in (0.5, 2.0, 4.0, 8.0):
            pieces = allowed(N[None], D[None], np.array([bound])).pieces()
            kinds.add((len(pieces), bool(pieces and np.isinf(pieces[0][0]))))
    assert kinds == {(0, False), (1, False), (2, True), (1, True)}


def test_pairs_that_go_on_have_no_bound_where_they_move_to():
    def of(*ends: tuple[float, float], outside: bool = False) -> Allowed:
        low, high = np.array(ends).T
        return Allowed(low, high, np.array([False] * (len(ends) - 1) + [outside]))

    assert of((0.0, 1.0), (0.5, 2.0)).continued() == [(0.0, inf)]
    assert of((0.0, 1.0), (-1.0, 0.5)).continued() == [(-inf, 1.0)]
    assert of((0.0, 1.0), (0.2, 0.9)).continued() == [(0.0, inf)]
    assert of((0.0, 1.0), (0.1, 0.3)).continued() == [(-inf, 1.0)]
    assert of((np.nan, np.nan), (0.1, 0.3)).continued() == [(0.1, inf)]
    assert of((np.nan, np.nan)).continued() == []
    beyond = of((0.0, 1.0), (2.0, 3.0), outside=True)
    assert beyond.pieces() == [(0.0, 1.0), (-inf, 2.0), (3.0, inf)]
