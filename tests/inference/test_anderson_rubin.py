"""Anderson-Rubin regions: closed forms, outside truth, coverage whatever the strength, and their shapes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy import stats
from threadpoolctl import threadpool_limits

from eivor.errors import CollinearError, TooFewSamplesError, UsageError
from eivor.inference.anderson_rubin import LinearScores, averages_for, homoskedastic_region, robust_region
from eivor.inference.covariance import cosine_averages, cosine_covariance
from eivor.inference.regions import ConfidenceRegion, scanned_shadow

LEVEL = 0.95


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Thousands of tiny problems: threads would only wait for each other."""
    with threadpool_limits(1):
        yield


def scores_of(psi: np.ndarray, columns: np.ndarray, averages: int) -> LinearScores:
    parts = [cosine_averages(psi * column[:, None], averages) for column in columns.T]
    return LinearScores(psi.T @ columns, np.stack(parts, axis=2))


def robust(psi: np.ndarray, columns: np.ndarray, averages: int | None = None) -> ConfidenceRegion:
    names = tuple("abcd"[: columns.shape[1] - 1])
    count = averages or averages_for(*psi.shape)
    return robust_region(names, scores_of(psi, columns, count), LEVEL)


def classical(psi: np.ndarray, columns: np.ndarray) -> ConfidenceRegion:
    return homoskedastic_region(tuple("abcd"[: columns.shape[1] - 1]), psi, columns, LEVEL)


def record(
    rng: np.random.Generator, strength: float, rows: int = 200, p: int = 4
) -> tuple[np.ndarray, np.ndarray]:
    """White errors, one regressor that shares most of them; the truth is 1."""
    psi = rng.standard_normal((rows, p))
    e = rng.standard_normal(rows)
    x = strength * psi.sum(axis=1) + 0.95 * e + 0.3 * rng.standard_normal(rows)
    return psi, np.column_stack([x + e, x])


def two_columns(rng: np.random.Generator, second: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    psi = rng.standard_normal((400, 5))
    e = rng.standard_normal(400)
    x = psi[:, 0] + 0.5 * psi[:, 1] + e + rng.standard_normal(400)
    z = second * (psi[:, 1] + psi[:, 2]) - e + rng.standard_normal(400)
    return psi, np.column_stack([x + 2.0 * z + e, x, z])


def test_statistics_are_their_formulas():
    rng = np.random.default_rng(0)
    psi, columns = two_columns(rng)
    B = averages_for(400, 5)
    bound = 5 * B / (B - 4) * stats.f(5, B - 4).ppf(LEVEL)
    theta = np.array([1.1, 1.8])
    e = columns @ np.array([1.0, -1.1, -1.8])
    g, V = psi.T @ e, cosine_covariance([psi * e[:, None]], e.size, B)
    assert robust(psi, columns).excess(theta) == pytest.approx(g @ np.linalg.solve(V, g) / bound, rel=1e-9)
    fitted = psi @ np.linalg.lstsq(psi, e, rcond=None)[0]
    F = (fitted @ fitted / 5) / ((e - fitted) @ (e - fitted) / 395)
    assert classical(psi, columns).excess(theta) == pytest.approx(F / stats.f(5, 395).ppf(LEVEL), rel=1e-9)


def test_closed_form_equals_the_general_inversion():
    """The classical region scanned as if nothing were known of it, the joint critical value in both."""
    for seed, second in ((1, 0.5), (2, 0.05), (3, 0.0)):
        psi, columns = two_columns(np.random.default_rng(seed), second)
        shape = classical(psi, columns).shape
        same = type(shape)(shape.explained, shape.unexplained, shape.critical, shape.critical)
        for axis in (1, 2):
            closed, scanned = same.shadow(axis), scanned_shadow(same, axis)
            assert len(closed.intervals) == len(scanned.intervals)
            np.testing.assert_allclose(
                np.ravel(closed.intervals), np.ravel(scanned.intervals), rtol=1e-5, atol=1e-6
            )


def test_one_regressor_is_a_quadratic_inequality():
    """a^2 x'Dx - ... with D = P - k (I - P), written out."""
    psi, columns = record(np.random.default_rng(4), 0.2)
    y, x = columns.T
    P = psi @ np.linalg.solve(psi.T @ psi, psi.T)
    D = P - 4 / 196 * stats.f(4, 196).ppf(LEVEL) * (np.eye(200) - P)
    roots = np.sort(np.roots([x @ D @ x, -2.0 * x @ D @ y, y @ D @ y]).real)
    assert classical(psi, columns).interval("a").hull == pytest.approx(tuple(roots), rel=1e-10)


def test_robust_ends_are_roots_and_membership_agrees_along_the_line():
    for seed, strength in ((5, 0.3), (6, 0.1), (7, 0.02)):
        psi, columns = record(np.random.default_rng(seed), strength)
        region = robust(psi, columns)
        interval = region.interval("a")
        for end in (end for piece in interval.intervals for end in piece if np.isfinite(end)):
            assert region.excess(np.array([end])) == pytest.approx(1.0, abs=1e-7)
        for value in np.tan(np.linspace(-1.57, 1.57, 501)):
            assert region.contains(np.array([value])) == interval.contains(value)


@pytest.mark.thorough
def test_shadow_of_two_parameters_is_the_least_over_the_other():
    psi, columns = two_columns(np.random.default_rng(8))
    region = robust(psi, columns)
    low, high = region.interval("a").hull
    other = region.frame.pivot[1] + region.frame.scale[1] * np.linspace(-8.0, 8.0, 4001)
    for value, inside in ((low + 1e-4, True), (low - 1e-4, False), (high - 1e-4, True), (high + 1e-4, False)):
        points = np.column_stack([np.full(4001, value), other])
        scaled = (points - region.frame.pivot) / region.frame.scale
        assert (region.shape.excess(np.column_stack([np.ones(4001), scaled])).min() <= 1.0) == inside
    (outline,) = region.outline()
    assert (outline[:, 0].min(), outline[:, 0].max()) == pytest.approx((low, high), rel=1e-9)
    assert outline[:, 1].max() == pytest.approx(region.interval("b").hull[1], rel=1e-3)
    inner = outline[5:-5:20]
    assert [region.excess(corner) for corner in inner] == pytest.approx([1.0] * len(inner), abs=1e-5)


@pytest.mark.thorough
def test_three_parameters_by_search_agree_with_the_closed_form():
    rng = np.random.default_rng(9)
    psi = rng.standard_normal((400, 6))
    e = rng.standard_normal(400)
    Phi = psi[:, :3] + 0.4 * psi[:, 3:] + 0.8 * e[:, None] + rng.standard_normal((400, 3))
    shape = classical(psi, np.column_stack([Phi @ [1.0, 2.0, 3.0] + e, Phi])).shape
    same = type(shape)(shape.explained, shape.unexplained, shape.critical, shape.critical)
    assert scanned_shadow(same, 2).hull == pytest.approx(same.shadow(2).hull, rel=1e-4)


def test_units_and_mixtures_of_instruments_change_nothing():
    rng = np.random.default_rng(10)
    psi, columns = two_columns(rng)
    mixed, units = psi @ rng.standard_normal((5, 5)), np.array([1e3, 1e-4, 30.0])
    for make in (robust, classical):
        item, other = make(psi, columns), make(mixed, columns * units)
        assert item.interval("a").hull == pytest.approx(other.interval("a").scaled(1e-7).hull, rel=1e-6)
        assert item.excess(np.array([1.0, 2.0])) == pytest.approx(
            other.excess(np.array([1e7, 2e3 / 30.0])), rel=1e-7
        )


@pytest.mark.calibration
@pytest.mark.parametrize("strength", [0.3, 0.01])
def test_coverage_whatever_the_strength(strength):
    """Both tests within 3.5 binomial errors of the level; Wald's interval fails when instruments are weak."""
    runs, rng = 800, np.random.default_rng([11, int(100 * strength)])
    error = np.sqrt(LEVEL * (1.0 - LEVEL) / runs)
    covered, bounded = np.zeros(3), 0
    for _ in range(runs):
        psi, columns = record(rng, strength)
        classic = classical(psi, columns)
        bounded += classic.interval("a").is_bounded
        truth = np.ones(1)
        covered += classic.contains(truth), robust(psi, columns).contains(truth), wald_covers(psi, columns)
    exact, hotelling, wald = covered / runs
    assert abs(exact - LEVEL) < 3.5 * error, exact
    assert abs(hotelling - LEVEL) < 3.5 * error, hotelling
    if strength < 0.1:
        assert wald < LEVEL - 20.0 * error, wald
        # A set that covers so must be unbounded at least so often (Dufour 1997), up to the little there is.
        assert bounded < 0.2 * runs, bounded
    else:
        assert bounded == runs


def wald_covers(psi: np.ndarray, columns: np.ndarray) -> bool:
    """Two-stage least squares plus and minus 1.96 standard errors."""
    y, x = columns.T
    fitted = psi @ np.linalg.lstsq(psi, x, rcond=None)[0]
    estimate = (fitted @ y) / (fitted @ x)
    residual = y - estimate * x
    return bool(abs(estimate - 1.0) <= 1.96 * np.sqrt(residual @ residual / y.size / (fitted @ fitted)))


def ar1(rng: np.random.Generator, shape: tuple[int, ...], rho: float) -> np.ndarray:
    from scipy.signal import lfilter

    return lfilter([1.0], [1.0, -rho], rng.standard_normal((100 + shape[0], *shape[1:])), axis=0)[100:]


@pytest.mark.calibration
def test_autocorrelated_errors_need_the_robust_test():
    runs, rng = 600, np.random.default_rng(12)
    error = np.sqrt(LEVEL * (1.0 - LEVEL) / runs)
    covered = np.zeros(2)
    for _ in range(runs):
        psi, e = ar1(rng, (500, 3), 0.7), ar1(rng, (500,), 0.7)
        x = 0.1 * psi.sum(axis=1) + e + rng.standard_normal(500)
        columns = np.column_stack([x + e, x])
        covered += robust(psi, columns).contains(np.ones(1)), classical(psi, columns).contains(np.ones(1))
    hotelling, exact = covered / runs
    assert hotelling > LEVEL - 3.5 * error, hotelling
    assert exact < LEVEL - 10.0 * error, exact


def test_empty_when_the_instruments_contradict_each_other():
    """Two instruments that each say something else of the parameter, both loudly."""
    rng = np.random.default_rng(13)
    psi = rng.standard_normal((500, 2))
    x = psi.sum(axis=1) + 0.1 * rng.standard_normal(500)
    columns = np.column_stack([psi @ [1.0, 3.0] + 0.1 * rng.standard_normal(500), x])
    for make in (robust, classical):
        assert make(psi, columns).interval("a").is_empty


def test_every_shape_is_reached():
    """Bounded, two rays, and the whole line, as the strength falls; alike for both tests' limits."""
    kinds = set()
    for seed in range(40):
        psi, columns = record(np.random.default_rng([14, seed]), 0.02 if seed % 2 else 0.3)
        for make in (robust, classical):
            interval = make(psi, columns).interval("a")
            rays = not interval.is_bounded and len(interval.intervals) == 2
            kinds.add(
                "whole"
                if interval.is_whole_line
                else "rays"
                if rays
                else "bounded"
                if interval.is_bounded
                else ""
            )
    assert {"whole", "rays", "bounded"} <= kinds


def test_what_cannot_be_tested_is_refused():
    psi, columns = record(np.random.default_rng(15), 1.0)
    with pytest.raises(CollinearError, match="errors that vary"):
        classical(psi, np.column_stack([columns[:, 1], columns[:, 1]]))
    with pytest.raises(CollinearError, match="errors that vary"):
        robust(np.column_stack([psi, psi[:, 0]]), columns)
    with pytest.raises(TooFewSamplesError, match="at least 32 samples for 4 moment"):
        averages_for(20, 4)
    with pytest.raises(UsageError, match="two parameters"):
        robust(psi, columns).outline()
    with pytest.raises(UsageError, match="out of a; received 'z'"):
        robust(psi, columns).interval("z")
