"""Strength of instruments against the algebra of two-stage least squares; J's distribution; verdicts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from eivor.inference.diagnostics.record import conditional_first_stage, orthonormal_basis, over_identification
from eivor.inference.verdict import Reason, Status, verdict


def problem(seed: int, rows: int = 200, count: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    Z = rng.standard_normal((rows, count))
    G = Z @ rng.standard_normal((count, 3)) + 2.0 * rng.standard_normal((rows, 3))
    return Z, G


@given(seed=st.integers(0, 999))
def test_conditional_strength_is_that_of_two_stage_residuals(seed):
    """Sanderson and Windmeijer: regress G_j on the others by 2SLS, then its residual on the instruments."""
    Z, G = problem(seed)
    stage = conditional_first_stage(orthonormal_basis(Z), G)
    for j in range(3):
        others = np.delete(G, j, axis=1)
        fitted = Z @ np.linalg.lstsq(Z, others)[0]
        delta = np.linalg.solve(fitted.T @ others, fitted.T @ G[:, j])
        residual = G[:, j] - others @ delta
        explained = Z @ np.linalg.lstsq(Z, residual)[0]
        wanted = (np.sum(explained**2) / (5 - 2)) / (np.sum((residual - explained) ** 2) / (200 - 5))
        assert stage[j] == pytest.approx(wanted, rel=1e-8)


def test_one_regressors_strength_is_the_ordinary_first_stage_f():
    Z, G = problem(1)
    fitted = Z @ np.linalg.lstsq(Z, G[:, 0])[0]
    wanted = (np.sum(fitted**2) / 5) / (np.sum((G[:, 0] - fitted) ** 2) / 195)
    assert conditional_first_stage(orthonormal_basis(Z), G[:, :1])[0] == pytest.approx(wanted)


@given(seed=st.integers(0, 99), scale=st.floats(1e-6, 1e6))
def test_strength_does_not_depend_on_units(seed, scale):
    Z, G = problem(seed)
    units = np.array([1.0, scale, 1.0])
    plain = conditional_first_stage(orthonormal_basis(Z), G)
    np.testing.assert_allclose(
        conditional_first_stage(orthonormal_basis(Z * scale), G * units), plain, rtol=1e-5
    )


def test_strength_of_too_few_or_perfect_instruments():
    Z, G = problem(2)
    basis = orthonormal_basis(Z[:, :2])
    np.testing.assert_array_equal(conditional_first_stage(basis, G), np.zeros(3))
    np.testing.assert_array_equal(conditional_first_stage(orthonormal_basis(Z[:5]), G[:5]), np.zeros(3))
    inside = orthonormal_basis(np.column_stack([Z, G]))
    assert np.all(conditional_first_stage(inside, G) > 1e12)


def test_basis_is_orthonormal_and_drops_what_is_no_direction():
    Z, _ = problem(3)
    columns = np.column_stack([1e9 * Z[:, 0], 1e-9 * Z[:, 1], np.zeros(200), Z[:, 0] + 1e-7 * Z[:, 1]])
    basis = orthonormal_basis(columns)
    assert basis.shape == (200, 2)
    np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-12)
    assert orthonormal_basis(np.zeros((10, 3))).shape == (10, 0)
    assert orthonormal_basis(np.empty((10, 0))).shape == (10, 0)


def test_over_identification_is_chi_square_when_the_model_holds():
    runs, rows = 1500, 300
    rng = np.random.default_rng(4)
    Z = rng.standard_normal((rows, 6))
    basis = orthonormal_basis(Z)
    G = Z @ rng.standard_normal((6, 2)) + rng.standard_normal((rows, 2))
    p_values = []
    for _ in range(runs):
        y = G @ [1.0, 2.0] + rng.standard_normal(rows)
        theta = np.linalg.lstsq(basis.T @ G, basis.T @ y)[0]
        p_values.append(over_identification(basis, y - G @ theta, 1.0, 2)[1])
    assert stats.kstest(p_values, "uniform").pvalue > 1e-4
    # Exactly identified, or without residuals, it has nothing to say.
    assert over_identification(basis[:, :2], y, 1.0, 2)[1] == 1.0
    assert over_identification(basis, np.zeros(rows), 0.0, 2) == (0.0, 1.0)


@pytest.mark.parametrize("order", list(itertools.permutations(Status)))
def test_the_worst_ground_decides_and_stands_first(order):
    reasons = [Reason(status, f"{status.value} because.", "Do.") for status in order]
    made = verdict(reasons)
    assert made.status is Status.REFUSED
    assert [reason.status for reason in made.reasons] == list(reversed(Status))
    assert made.sentences[0] == "refused because. Do."
    for worst, best in itertools.combinations(range(4), 2):
        kept = [reason for reason in reasons if list(Status).index(reason.status) in {worst, best}]
        assert list(Status).index(verdict(kept).status) == best


def test_no_ground_against_is_identified_and_equals_keep_their_order():
    assert verdict([]).status is Status.IDENTIFIED
    assert verdict([]).sentences == ()
    both = [Reason(Status.WEAK, "First."), Reason(Status.WEAK, "Second.")]
    assert verdict(both).sentences == ("First.", "Second.")
