"""Derived quantities: ratios whatever the denominator, functions however they bend."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import eivor as ev
import shape_checks
from eivor.errors import UsageError
from eivor.inference.confidence_set import profile_interval
from eivor.inference.regions import fieller_set

RUNS = 2000


def fit_of(noise, seed=1, count=400, truth=(0.3, 1.2)):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((count, 2))
    y = x @ truth + noise * rng.standard_normal(count)
    problem = ev.regression(response=y, regressors=x, names=["a", "b"])
    return ev.identify(problem, ev.methods.least_squares())


@given(
    p=st.floats(-3, 3),
    q=st.floats(-3, 3),
    corr=st.floats(-0.95, 0.95),
    unit=st.sampled_from([1e-6, 1.0, 1e6]),
)
def test_fieller_set_is_the_inverted_test(p, q, corr, unit):
    V = np.array([[1.0, 0.8 * corr], [0.8 * corr, 0.64]])
    scale = np.diag([1.0, unit])
    result = fieller_set(scale @ [p, q], scale @ V @ scale, 1.5)
    for r in np.concatenate([np.linspace(-40, 40, 161), [-1e6, 1e6]]):
        distance = (p - r * q) ** 2 - 1.5**2 * (V[0, 0] - 2 * r * V[0, 1] + r**2 * V[1, 1])
        if abs(distance) > 1e-6 * (1 + r**2):
            assert result.contains(r / unit) == (distance <= 0.0)


def test_time_constant_is_the_inverse_of_the_interval():
    fit = fit_of(0.5)
    low, high = fit.interval("a")
    assert ev.ratio(fit, 1.0, "a").hull == pytest.approx((1.0 / high, 1.0 / low))
    vague = fit_of(4.0)
    low, high = vague.interval("a")
    assert low < 0.0 < high
    assert ev.ratio(vague, 1.0, "a").intervals == (
        (-np.inf, pytest.approx(1.0 / low)),
        (pytest.approx(1.0 / high), np.inf),
    )


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_fieller_covers_where_the_delta_method_does_not(noise):
    """A ratio whose denominator is ten standard errors from zero, or one."""
    rng = np.random.default_rng(4)
    sd, t = noise / 10.0, stats.norm.ppf(0.975)
    pairs = np.array([1.2, 0.3]) + sd * rng.standard_normal((RUNS, 2))
    fieller = sum(fieller_set(pair, sd**2 * np.eye(2), t).contains(4.0) for pair in pairs)
    value = pairs[:, 0] / pairs[:, 1]
    half = t * sd * np.sqrt(1.0 + value**2) / np.abs(pairs[:, 1])
    delta = int((np.abs(value - 4.0) <= half).sum())
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], RUNS, 0.95)
    assert low <= fieller <= high
    assert (low <= delta <= high) == (noise < 1.0)


def test_profile_of_a_linear_function_is_the_delta_method():
    rng = np.random.default_rng(2)
    root = rng.standard_normal((3, 3))
    values, C, c = rng.standard_normal(3), root @ root.T, rng.standard_normal(3)
    half = 2.0 * np.sqrt(c @ C @ c)
    interval = profile_interval(lambda v: float(c @ v), values, C, 2.0)
    assert interval == pytest.approx((c @ values - half, c @ values + half), rel=1e-7)


@pytest.mark.thorough
def test_profile_does_not_depend_on_a_monotone_scale():
    rng = np.random.default_rng(3)
    root = 0.3 * rng.standard_normal((3, 3))
    values, C = np.array([1.0, 2.0, 0.5]), root @ root.T

    def bent(v):
        return float(v[0] + 0.4 * v[1] ** 2 + 0.3 * v[2] * v[0])

    low, high = profile_interval(bent, values, C, 1.96)
    logarithmic = profile_interval(lambda v: np.exp(bent(v)), values, C, 1.96)
    assert logarithmic == pytest.approx((np.exp(low), np.exp(high)), rel=1e-5)
    # No vector of the ellipsoid lies beyond.
    eigenvalues, vectors = np.linalg.eigh(C)
    w = rng.standard_normal((4000, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    around = values + 1.96 * w @ (vectors * np.sqrt(eigenvalues)).T
    reached = np.array([bent(v) for v in around])
    assert low <= reached.min() + 1e-9
    assert high >= reached.max() - 1e-9
    assert high - low == pytest.approx(np.ptp(reached), rel=0.01)


@pytest.mark.parametrize("noise", [0.05, 1.0])
def test_derived_quantity_is_profiled_when_it_bends(noise):
    fit = fit_of(noise)
    low, high = fit.interval("a")
    derived = ev.derived(fit, lambda p: float(np.exp(3.0 * p["a"])))
    assert derived.profiled == (noise == 1.0)
    assert derived.value == pytest.approx(np.exp(3.0 * fit.parameters["a"]))
    assert derived.std_error == pytest.approx(3.0 * derived.value * fit.std_error("a"), rel=1e-4)
    wanted = (np.exp(3.0 * low), np.exp(3.0 * high)) if derived.profiled else None
    if wanted:
        assert derived.interval == pytest.approx(wanted, rel=1e-6)
    else:
        half = derived.value * 1.5 * (high - low)
        assert derived.interval == pytest.approx((derived.value - half, derived.value + half), rel=1e-4)
    linear = ev.derived(fit, lambda p: p["a"] - 2.0 * p["b"])
    assert not linear.profiled
    assert linear.bend < 1e-9


def test_derived_quantities_follow_the_covariance_and_its_assumptions():
    fit = fit_of(0.5)
    cov = ev.covariances
    parts = (cov.Classical(), cov.EqualWeightedCosines())
    both = fit.with_covariance(cov.Widest(parts))
    hulls = [ev.ratio(fit.with_covariance(part), "b", "a").hull for part in parts]
    union = ev.ratio(both, "b", "a").hull
    assert union == (min(low for low, _ in hulls), max(high for _, high in hulls))
    ends = [ev.derived(fit.with_covariance(part), lambda p: p["a"] * p["b"]).interval for part in parts]
    interval = ev.derived(both, lambda p: p["a"] * p["b"]).interval
    assert interval == pytest.approx((min(low for low, _ in ends), max(high for _, high in ends)))


def test_what_cannot_be_derived_is_refused():
    fit = fit_of(4.0)
    with pytest.raises(UsageError, match="finite within the interval; received"):
        ev.derived(fit, lambda p: float("inf") if p["a"] < 0.0 else 1.0 / p["a"])
    with pytest.raises(UsageError, match="a parameter out of a, b; received 'c'"):
        ev.ratio(fit, "c", "a")
    for level in (0.0, 1.0):
        with pytest.raises(UsageError, match="level between 0 and 1"):
            ev.ratio(fit, "b", "a", level)
    with pytest.raises(UsageError, match="two parameters; received 'a' twice"):
        fit.ellipse("a", "a")


@pytest.mark.calibration
def test_ellipse_covers_jointly():
    """The truth lies in the joint region 95 times in 100, and in the box of the intervals less often."""
    with shape_checks.unchecked():
        rng, inside = np.random.default_rng(6), 0
        for _ in range(600):
            x = rng.standard_normal((300, 2)) @ np.array([[1.0, 0.8], [0.0, 0.6]])
            problem = ev.regression(response=x @ [1.0, -2.0] + rng.standard_normal(300), regressors=x)
            ellipse = ev.identify(problem, ev.methods.least_squares()).ellipse("theta_1", "theta_2")
            inside += bool(ellipse.contains(np.array([[1.0, -2.0]]))[0])
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], 600, 0.95)
    assert low <= inside <= high


@pytest.mark.thorough
def test_bends_across_the_slope_are_seen():
    """A valley: along its bottom the function is straight, across it is not."""
    values, C = np.array([1.0, 0.0]), np.diag([0.04**2, 0.04**2])

    def valley(v):
        return float(v[0] + 50.0 * v[1] ** 2)

    low, high = profile_interval(valley, values, C, 2.0)
    around = np.linspace(0.0, 2.0 * np.pi, 20001)
    reached = 1.0 + 0.08 * np.cos(around) + 50.0 * (0.08 * np.sin(around)) ** 2
    assert high == pytest.approx(reached.max(), rel=1e-4)
    assert low == pytest.approx(0.92, rel=1e-4)
    fit = fit_of(0.5)
    parameter = fit.parameters["b"]
    assert ev.derived(fit, lambda p: p["a"] + 500.0 * (p["b"] - parameter) ** 2).profiled
    flat = ev.derived(fit, lambda p: (p["b"] - parameter) ** 2)
    low, high = fit.interval("b")
    assert flat.profiled
    assert flat.interval == pytest.approx((0.0, (0.5 * (high - low)) ** 2), rel=1e-6)
