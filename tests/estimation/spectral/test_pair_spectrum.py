"""Pairs of residuals, bin by bin, against matrices of two rows and two columns."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.estimation.sampled_motion import PairSpectrum, inner

BINS = 5


@pytest.fixture
def dense() -> np.ndarray:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((BINS, 2, 2)) + 1j * rng.standard_normal((BINS, 2, 2))
    return root @ root.conj().swapaxes(1, 2) + 0.1 * np.eye(2)


@pytest.fixture
def other() -> np.ndarray:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((BINS, 2, 2)) + 1j * rng.standard_normal((BINS, 2, 2))
    return root @ root.conj().swapaxes(1, 2)


@pytest.fixture
def pair() -> np.ndarray:
    rng = np.random.default_rng(2)
    return rng.standard_normal((2, BINS)) + 1j * rng.standard_normal((2, BINS))


def as_pair(dense: np.ndarray) -> PairSpectrum:
    return PairSpectrum(dense[:, 0, 0].real, dense[:, 1, 1].real, dense[:, 0, 1])


def as_dense(C: PairSpectrum) -> np.ndarray:
    rows = [np.stack([C.first + 0j, C.cross], axis=-1), np.stack([C.cross.conj(), C.second + 0j], axis=-1)]
    return np.stack(rows, axis=-2)


def test_solutions_are_those_of_the_matrices(dense: np.ndarray, pair: np.ndarray) -> None:
    expected = np.linalg.solve(dense, pair.T[:, :, None])[:, :, 0].T
    np.testing.assert_allclose(as_pair(dense).solved(pair), expected, rtol=1e-12)


def test_whitened_pairs_have_the_weighted_length(dense: np.ndarray, pair: np.ndarray) -> None:
    C = as_pair(dense)
    white = C.whitened(pair)
    np.testing.assert_allclose(inner(white, white), inner(pair, C.solved(pair)), rtol=1e-12)
    L = np.linalg.cholesky(dense)
    np.testing.assert_allclose(white, np.linalg.solve(L, pair.T[:, :, None])[:, :, 0].T, rtol=1e-12)


def test_products_are_those_of_the_matrices(dense: np.ndarray, other: np.ndarray) -> None:
    C, P = as_pair(dense), as_pair(other)
    inverse = np.linalg.inv(dense)
    np.testing.assert_allclose(as_dense(P.between(C)), inverse @ other @ inverse, rtol=1e-10)
    np.testing.assert_allclose(as_dense(C + P * 2.0), dense + 2.0 * other, rtol=1e-14)
    np.testing.assert_allclose(C.determinant, np.linalg.det(dense).real, rtol=1e-11)
