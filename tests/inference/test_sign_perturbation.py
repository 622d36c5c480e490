"""Sign perturbation: exact coverage for errors without moments and of changing size, and its geometry."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from eivor.errors import CollinearError, ParameterError
from eivor.inference.anderson_rubin import excluded_sums, sign_perturbed_region

ROWS, RUNS = 50, 1000


def switching(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Uniform errors whose size grows tenfold at a third of the record and falls again at two thirds."""
    size = np.where((np.arange(rows) >= rows // 3) & (np.arange(rows) < 2 * rows // 3), 10.0, 1.0)
    return size * rng.uniform(-1.0, 1.0, rows)


ERRORS = {
    "Student t on 2": lambda rng, rows: rng.standard_t(2, rows),
    "Student t on 3": lambda rng, rows: rng.standard_t(3, rows),
    "Cauchy": lambda rng, rows: rng.standard_cauchy(rows),
    "variance switch": switching,
    "two values": lambda rng, rows: rng.choice([-1.0, 1.0], rows),
}


def record(error: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Instruments (an AR(1) input and a constant), and [y Phi] with a regressor that answers the error."""
    reference = np.convolve(rng.standard_normal(error.size + 20), 0.8 ** np.arange(20))[20 : 20 + error.size]
    regressor = reference + 0.7 * error + rng.standard_normal(error.size)
    entries = np.ones(error.size)
    return np.column_stack([reference, entries]), np.column_stack(
        [2.0 * regressor - 1.0 + error, regressor, entries]
    )


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Thousands of tiny problems: threads would only wait for each other."""
    with threadpool_limits(1):
        yield


@pytest.mark.calibration
@pytest.mark.parametrize("kind", ERRORS)
def test_coverage_is_exact_at_fifty_rows(kind):
    """Within 3.5 binomial errors of the level, at two levels: one of them where a shortfall shows best."""
    for level, sums in ((0.95, 100), (0.5, 10)):
        rng = np.random.default_rng([5, list(ERRORS).index(kind), sums])
        covered = 0
        for _ in range(RUNS):
            psi, columns = record(ERRORS[kind](rng, ROWS), rng)
            region = sign_perturbed_region(("a", "b"), psi, columns, rng, level=level, sums=sums)
            covered += region.contains(np.array([2.0, -1.0]))
        assert abs(covered / RUNS - level) < 3.5 * np.sqrt(level * (1.0 - level) / RUNS), covered / RUNS


@pytest.mark.calibration
def test_ties_are_broken_so_that_coverage_stays_exact():
    """Five rows of errors +-1: most sums are as long as another, and the rank still has to be uniform."""
    rng, covered, runs, level = np.random.default_rng(8), 0, 2000, 0.5
    for _ in range(runs):
        psi = np.ones((5, 1))
        columns = np.column_stack([rng.choice([-1.0, 1.0], 5), np.ones(5)])
        region = sign_perturbed_region(("mean",), psi, columns, rng, level=level, sums=4)
        covered += region.contains(np.zeros(1))
    assert abs(covered / runs - level) < 3.5 * np.sqrt(level * (1.0 - level) / runs), covered / runs


def test_region_is_the_rank_of_explicit_sums():
    """Second route: signs drawn again from the seed, sums and ranks written out."""
    rng = np.random.default_rng(3)
    psi, columns = record(rng.standard_t(3, ROWS), rng)
    region = sign_perturbed_region(("a", "b"), psi, columns, np.random.default_rng(4), level=0.9, sums=20)
    again = np.random.default_rng(4)
    order = again.permutation(20)
    signs = np.vstack([np.ones(ROWS), 1 - 2.0 * again.integers(0, 2, size=(19, ROWS), dtype=np.int8)])
    weight = np.linalg.inv(psi.T @ psi)
    members = 0
    for theta in np.array([2.0, -1.0]) + rng.uniform(-0.6, 0.6, (300, 2)):
        residual = columns[:, 0] - columns[:, 1:] @ theta
        S = (signs * residual) @ psi
        lengths = np.einsum("ia,ab,ib->i", S, weight, S)
        inside = (lengths[1:] < lengths[0]).sum() <= 20 - 2 - 1
        members += inside
        assert region.contains(theta) == inside
    assert 30 < members < 270
    assert order.size == 20


@pytest.mark.thorough
def test_lines_and_shadows_agree_with_membership():
    rng = np.random.default_rng(3)
    psi, columns = record(rng.standard_t(3, ROWS), rng)
    region = sign_perturbed_region(("a", "b"), psi, columns, rng, level=0.9, sums=20)
    low, high = region.interval("a").hull
    grid = np.column_stack([np.ones(20001), np.zeros(20001), np.linspace(-50.0, 50.0, 20001)])
    for a, inside in ((low + 1e-4, True), (low - 1e-4, False), (high - 1e-4, True), (high + 1e-4, False)):
        grid[:, 1] = (a - region.frame.pivot[0]) / region.frame.scale[0]
        line = region.shape.along(grid[0] * [1, 1, 0], np.array([0.0, 0.0, 1.0]))
        assert line.is_empty != inside
        assert (region.shape.excess(grid).min() <= 1.0) <= inside
    (outline,) = region.outline()
    assert outline[:, 0].min() == pytest.approx(low)
    middle = outline.mean(axis=0)
    assert all(region.contains(middle + 0.999 * (corner - middle)) for corner in outline[::20])
    assert not any(region.contains(middle + 1.01 * (corner - middle)) for corner in outline[::20])


@pytest.mark.thorough
def test_region_does_not_depend_on_units_or_on_the_mixture_of_instruments():
    rng = np.random.default_rng(9)
    psi, columns = record(rng.standard_t(2, ROWS), rng)
    mixed, units = psi @ rng.standard_normal((2, 2)), np.array([1e3, 1e-3, 7.0])
    region = sign_perturbed_region(("a", "b"), psi, columns, np.random.default_rng(1), level=0.95, sums=100)
    other = sign_perturbed_region(
        ("a", "b"), mixed, columns * units, np.random.default_rng(1), level=0.95, sums=100
    )
    assert region.interval("a").hull == pytest.approx(other.interval("a").scaled(1e-6).hull, rel=1e-7)


def test_a_useless_instrument_gives_the_whole_line():
    rng = np.random.default_rng(2)
    e = rng.standard_normal(200)
    columns = np.column_stack([e, e + rng.standard_normal(200)])
    region = sign_perturbed_region(("a",), rng.standard_normal((200, 1)), columns, rng, level=0.95, sums=100)
    assert not region.interval("a").is_bounded


def test_levels_and_instruments_that_do_not_fit_are_refused():
    assert excluded_sums(0.95, 100) == 5
    assert excluded_sums(0.99, 200) == 2
    for level, sums in ((0.975, 100), (1.0, 100), (0.95, 10)):
        with pytest.raises(ParameterError, match="whole number"):
            excluded_sums(level, sums)
    entries = np.ones((20, 2))
    with pytest.raises(CollinearError, match="independent instruments"):
        sign_perturbed_region(("a",), entries, entries, np.random.default_rng(0), level=0.95, sums=100)
