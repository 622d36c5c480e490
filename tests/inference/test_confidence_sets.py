"""Anderson-Rubin regions: closed forms, outside truth, coverage whatever the strength, and their shapes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from math import inf

import numpy as np
import pytest
from scipy import stats
from threadpoolctl import threadpool_limits

import eivor as ev
from eivor.errors import CollinearError, ParameterError, TooFewSamplesError, UsageError
from eivor.inference.anderson_rubin import (
    LinearScores,
    averages_for,
    concentrated,
    excluded_sums,
    robust_region,
    sign_perturbed_region,
)
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.covariance import cosine_averages, cosine_covariance
from eivor.inference.distributions import chi_square_quantile, conditional_ratio_quantile
from eivor.inference.regions import ConfidenceRegion, Ellipse, RegionShape
from inference import test_covariances as products
from refusal_rows import calls, rows, table

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


@dataclass(frozen=True)
class Quadric(RegionShape):
    """Region of a quadratic inequality, the test of white errors, whose shadows have a closed form."""

    explained: np.ndarray
    bound: np.ndarray  # The critical ratio times what is not explained

    def excess(self, points):
        return np.einsum("ka,ab,kb->k", points, self.explained, points) / (
            np.einsum("ka,ab,kb->k", points, self.bound, points)
        )

    def along(self, base, step):
        Q = self.explained - self.bound
        return ConfidenceSet.from_quadratic(step @ Q @ step, 2.0 * (base @ Q @ step), base @ Q @ base)

    def closed(self, axis: int) -> ConfidenceSet:
        S, free = concentrated(self.explained - self.bound, [0, axis])
        if free:
            return ConfidenceSet.whole_line()
        return ConfidenceSet.from_quadratic(S[1, 1], 2.0 * S[0, 1], S[0, 0])


def classical(psi: np.ndarray, columns: np.ndarray) -> Quadric:
    """Shape about the two-stage estimate, in its standard errors."""
    (rows, p), Q = psi.shape, np.linalg.qr(psi)[0]
    theta = np.linalg.lstsq(Q.T @ columns[:, 1:], Q.T @ columns[:, 0], rcond=None)[0]
    error = columns @ [1.0, *-theta]
    scale = error.std() * np.sqrt(np.diag(np.linalg.inv((Q.T @ columns[:, 1:]).T @ (Q.T @ columns[:, 1:]))))
    change = np.diag([1.0, *-scale])
    change[1:, 0] = -theta
    moved = columns @ change / error.std()
    inside = Q.T @ moved
    critical = p / (rows - p) * stats.f(p, rows - p).ppf(LEVEL)
    return Quadric(inside.T @ inside, critical * (moved.T @ moved - inside.T @ inside))


def sign_perturbed(psi: np.ndarray, columns: np.ndarray) -> ConfidenceRegion:
    return sign_perturbed_region(("a",), psi, columns, np.random.default_rng(0), level=LEVEL, sums=100)


def record(rng: np.random.Generator, strength: float) -> tuple[np.ndarray, np.ndarray]:
    """White errors, one regressor that shares most of them; the truth is 1."""
    psi, e = rng.standard_normal((200, 4)), rng.standard_normal(200)
    x = strength * psi.sum(axis=1) + 0.95 * e + 0.3 * rng.standard_normal(200)
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


def test_closed_form_equals_the_general_inversion():
    """The region of white errors, scanned as if nothing were known of it."""
    for seed, second in ((1, 0.5), (2, 0.05), (3, 0.0)):
        psi, columns = two_columns(np.random.default_rng(seed), second)
        shape = classical(psi, columns)
        for axis in (1, 2):
            closed, scanned = (
                np.array(set_.intervals) for set_ in (shape.closed(axis), shape.shadow(axis, 3))
            )
            assert closed.shape == scanned.shape
            np.testing.assert_allclose(closed, scanned, rtol=1e-5, atol=1e-6)


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


@pytest.mark.thorough
def test_three_parameters_by_search_agree_with_the_closed_form():
    rng = np.random.default_rng(9)
    psi = rng.standard_normal((400, 6))
    e = rng.standard_normal(400)
    Phi = psi[:, :3] + 0.4 * psi[:, 3:] + 0.8 * e[:, None] + rng.standard_normal((400, 3))
    shape = classical(psi, np.column_stack([Phi @ [1.0, 2.0, 3.0] + e, Phi]))
    assert shape.shadow(2, 4).hull == pytest.approx(shape.closed(2).hull, rel=1e-4)


@pytest.mark.calibration
@pytest.mark.parametrize("strength", [0.3, 0.01])
def test_coverage_whatever_the_strength(strength):
    """Within 3.5 binomial errors of the level; Wald's interval fails when instruments are weak."""
    runs, rng = 800, np.random.default_rng([11, int(100 * strength)])
    error = np.sqrt(LEVEL * (1.0 - LEVEL) / runs)
    covered, bounded = np.zeros(2), 0
    for _ in range(runs):
        psi, columns = record(rng, strength)
        region = robust(psi, columns)
        bounded += region.interval("a").is_bounded
        covered += region.contains(np.ones(1)), wald_covers(psi, columns)
    hotelling, wald = covered / runs
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


def test_empty_when_the_instruments_contradict_each_other():
    """Two instruments that each say something else of the parameter, both loudly."""
    rng = np.random.default_rng(13)
    psi = rng.standard_normal((500, 2))
    x = psi.sum(axis=1) + 0.1 * rng.standard_normal(500)
    columns = np.column_stack([psi @ [1.0, 3.0] + 0.1 * rng.standard_normal(500), x])
    assert robust(psi, columns).interval("a").is_empty


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


def test_what_a_set_says_of_itself():
    outside = ConfidenceSet.union([(3.0, inf), (-inf, 1.0), (-2.0, 0.5)])
    assert outside.intervals == ((-inf, 1.0), (3.0, inf))
    assert outside.contains(1.0)
    assert not outside.contains(2.0)
    assert not outside.is_bounded
    assert (outside.hull, outside.length) == ((-inf, inf), inf)
    assert outside.scaled(-2.0).intervals == ((-inf, -6.0), (-2.0, inf))
    empty = ConfidenceSet.empty()
    assert empty.is_empty
    assert empty.is_bounded
    assert empty.length == 0.0
    assert empty.hull != empty.hull
    assert ConfidenceSet(((0.0, 1.0),)).is_bounded


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


def record_sign(error: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Instruments (an AR(1) input and a constant), and [y Phi] with a regressor that answers the error."""
    reference = np.convolve(rng.standard_normal(error.size + 20), 0.8 ** np.arange(20))[20 : 20 + error.size]
    regressor = reference + 0.7 * error + rng.standard_normal(error.size)
    ones = np.ones(error.size)
    columns = np.column_stack([2.0 * regressor - 1.0 + error, regressor, ones])
    return np.column_stack([reference, ones]), columns


@pytest.mark.calibration
@pytest.mark.parametrize("kind", ERRORS)
def test_coverage_is_exact_at_fifty_rows(kind):
    """Within 3.5 binomial errors of the level, at two levels: one of them where a shortfall shows best."""
    for level, sums in ((0.95, 100), (0.5, 10)):
        rng = np.random.default_rng([5, list(ERRORS).index(kind), sums])
        covered = 0
        for _ in range(RUNS):
            psi, columns = record_sign(ERRORS[kind](rng, ROWS), rng)
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
    psi, columns = record_sign(rng.standard_t(3, ROWS), rng)
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


def test_a_useless_instrument_gives_the_whole_line():
    rng = np.random.default_rng(2)
    e = rng.standard_normal(200)
    columns = np.column_stack([e, e + rng.standard_normal(200)])
    assert not sign_perturbed(rng.standard_normal((200, 1)), columns).interval("a").is_bounded


def test_excluded_sums_are_the_share_of_the_level():
    assert (excluded_sums(0.95, 100), excluded_sums(0.99, 200)) == (5, 2)


COVARIANCE = np.array([[0.04, -0.9 * 0.2 * 30.0], [-0.9 * 0.2 * 30.0, 900.0]])
CENTRE = np.array([0.4, 1.2e3])


@pytest.mark.parametrize(("degrees", "strength"), [(2.0, 3.0), (4.0, 9.0), (8.0, 20.0)])
def test_quantile_of_a_conditional_ratio_is_that_of_its_draws(degrees, strength):
    """The ratio of Moreira (2003) by chi-squares of one degree and of the rest."""
    draws = np.random.default_rng(3).chisquare([1.0, degrees - 1.0], (200_000, 2))
    both = draws.sum(axis=1)
    root = np.sqrt((both + strength) ** 2 - 4.0 * strength * draws[:, 1])
    drawn = np.quantile(0.5 * (both - strength + root), 0.95)
    assert conditional_ratio_quantile(0.95, degrees, strength) == pytest.approx(drawn, rel=0.02)
    of_one = chi_square_quantile(0.95, 1)
    assert conditional_ratio_quantile(0.95, 1.018, 750.0) == pytest.approx(of_one, rel=0.03)
    for size, left in ((0.0, degrees), (1e5, 1.0), (np.inf, 1.0)):
        ends = conditional_ratio_quantile(0.95, degrees, size)
        assert ends == pytest.approx(chi_square_quantile(0.95, left), rel=0.002)


def test_area_agrees_with_the_outline() -> None:
    ellipse = Ellipse(CENTRE, COVARIANCE)
    outline = ellipse.outline(20_001)
    x, y = (outline - CENTRE).T
    polygon = 0.5 * abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])))
    assert ellipse.area == pytest.approx(polygon, rel=1e-6)


PSI, COLUMNS = record(np.random.default_rng(15), 1.0)
cov = ev.covariances
TWICE, TRIPLED = np.column_stack([COLUMNS[:, 1], COLUMNS[:, 1]]), np.column_stack([PSI, PSI[:, 0]])
REGION, ENTRIES = robust(PSI, COLUMNS), np.ones((20, 2))
SMALL = products.table()
DIRECT = ev.identify(ev.regression(np.arange(9.0) ** 2, np.arange(9.0)), ev.methods.least_squares())
test_refused = table(
    rows("ellipse", UsageError, lambda *given: Ellipse(CENTRE, COVARIANCE, *given).squared_radius,
        *((*given, "Expected") for given in ((0.0, 8.0), (1.0, 8.0), (0.95, 1.0), (0.95, math.nan))),
    ),
    rows("set", ParameterError, ConfidenceSet, *((given, "ascending order") for given in (
        ((1.0, 0.0),), ((0.0, 1.0), (1.0, 2.0)), ((math.nan, 1.0),), ((inf, inf),)))),
    rows("sums", ParameterError, excluded_sums, *((*given, "whole number") for given in (
        (0.975, 100), (1.0, 100), (0.95, 10)))),
    calls("call", None,
        (partial(robust, TRIPLED, COLUMNS), CollinearError, "errors that vary"),
        (partial(averages_for, 20, 4), TooFewSamplesError, "at least 32 samples for 4 moment"),
        (partial(REGION.interval, "z"), UsageError, "out of a; received 'z'"),
        (partial(sign_perturbed, ENTRIES, ENTRIES), CollinearError, "independent instruments"),
        (partial(ConfidenceSet.from_quadratic, inf, 0.0, 0.0), ParameterError, "finite coefficients"),
        (partial(ConfidenceSet.whole_line().scaled, 0.0), ParameterError, "other than zero"),
        (lambda: SMALL + replace(SMALL, sums=SMALL.sums[:, :2]), UsageError, "Add the products of one"),
        (lambda: SMALL + replace(SMALL, tested=2), UsageError, "received products of 2 instruments"),
        (lambda: DIRECT.with_covariance(cov.ClusteredByFlight()).interval("theta_1"), UsageError,
            "ClusteredByFlight can use; received too few flights"),
        (lambda: cov.EqualWeightedCosines(0), UsageError, "one cosine average or more; received 0"),
        (lambda: cov.FixedBandwidth(-1.0), UsageError, "zero lags or more; received -1"),
    ),
)  # fmt: skip
