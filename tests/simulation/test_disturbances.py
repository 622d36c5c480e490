"""Each disturbance against a property that theory gives, with bounds from Monte Carlo's standard error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from eivor.errors import ParameterError
from eivor.lab.disturbances import (
    Arma,
    BoundedAdversary,
    CoefficientCourse,
    Garch,
    GivenCourse,
    GivenDisturbance,
    OrnsteinUhlenbeck,
    RandomCoefficientMovingAverage,
    Sinusoids,
    SumOfCourses,
    SumOfDisturbances,
    ThresholdMovingAverage,
    TimeVaryingArma,
    Trend,
    VarianceSwitch,
    bilinear,
    paper_disturbance,
)
from eivor.simulation.excitation import DrydenGust, WhiteDisturbance

STEP_S = 0.2
#: Standard errors within which a mean must lie.
WITHIN = 4.5


def rng(seed=1):
    return np.random.default_rng(seed)


def realisations(disturbance, count, runs):
    """Independent ones, shape (runs, count)."""
    return np.array([disturbance.sample(count, STEP_S, stream) for stream in rng(7).spawn(runs)])


def assert_mean(values, expected):
    """The mean of independent values is that one, within its standard error."""
    error = values.std() / np.sqrt(values.size)
    assert abs(values.mean() - expected) < WITHIN * error, (values.mean(), expected, error)


def assert_autocovariance(disturbance, expected, runs=400):
    """Averages over time of each realisation have these means."""
    series = realisations(disturbance, 300, runs)
    for lag, value in expected.items():
        products = series[:, : 300 - lag] * series[:, lag:]
        assert_mean(products.mean(axis=1), value)


#: Stationary disturbances with their variance.
STATIONARY = [
    (WhiteDisturbance(0.7), 0.49),
    (Arma(0.5, (0.9,), (0.4,)), 0.25 * 1.88 / 0.19),
    (Arma(1.0, (1.2, -0.5), ()), 1.5 / (0.5 * 0.81)),
    (Arma(1.0, (), (0.5, 0.3)), 1.34),
    (RandomCoefficientMovingAverage((0.0, 3.0), (1.0, 1.0), 0.4), 0.16 * 11.0),
    (bilinear(0.6, 3, 1, 1.1), 1.21 / (1.0 - 0.66**2)),
    (Garch(0.1, (0.3,), (0.5,)), 0.5),
    (DrydenGust(0.8, 5.0, 4.0), 0.64),
    (OrnsteinUhlenbeck(0.8, 0.7), 0.64),
    (SumOfDisturbances((WhiteDisturbance(0.3), Arma(1.0, (0.5,)))), 0.09 + 1.0 / 0.75),
]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("disturbance", "variance"), STATIONARY, ids=[type(item).__name__ for item, _ in STATIONARY]
)
def test_variance_is_that_of_the_first_and_of_the_last_sample(disturbance, variance):
    series = realisations(disturbance, 60, 1500)
    for k in (0, 1, 59):
        assert_mean(series[:, k], 0.0)
        assert_mean(series[:, k] ** 2, variance)


EVERY = [
    *(item for item, _ in STATIONARY),
    TimeVaryingArma(1.0, (CoefficientCourse(amplitude=0.8, cycles=3.0),), (CoefficientCourse(0.5),)),
    ThresholdMovingAverage((0.0,), ((0.2,), (0.9,))),
    VarianceSwitch(WhiteDisturbance(1.0)),
    Garch(0.1, (0.85,), largest_square=1e4),
    Trend((0.0, 3.0)),
    Sinusoids((2.0,), (0.05,)),
    BoundedAdversary(1.0, 20.0, 1.0),
    paper_disturbance(),
]


@pytest.mark.parametrize("disturbance", EVERY, ids=lambda item: type(item).__name__)
@pytest.mark.parametrize("count", [1, 2, 3, 500])
def test_same_generator_same_series(disturbance, count):
    series = disturbance.sample(count, STEP_S, rng(5))
    assert series.shape == (count,)
    assert np.isfinite(series).all()
    np.testing.assert_array_equal(series, disturbance.sample(count, STEP_S, rng(5)))


def test_arma_is_the_filter_of_scipy_after_its_start():
    series = Arma(1.0, (1.2, -0.5), (0.3,)).sample(400, STEP_S, rng())
    stream = rng()
    stream.standard_normal(2)  # the state before the record
    shocks = stream.standard_normal(400)
    filtered = lfilter([1.0, 0.3], [1.0, -1.2, 0.5], shocks)
    np.testing.assert_allclose(series[150:], filtered[150:], atol=1e-9)


def test_time_varying_arma_is_its_recursion():
    """The method's: x_k = .8 sin(6 pi k/N) x_{k-1} + w_k + .9 cos(10 pi k/N) w_{k-1}."""
    count = 200
    disturbance = TimeVaryingArma(
        2.0,
        (CoefficientCourse(amplitude=0.8, cycles=3.0),),
        (CoefficientCourse(amplitude=0.9, cycles=5.0, phase=np.pi / 2.0),),
    )
    w = 2.0 * rng().standard_normal(count)
    expected = np.zeros(count)
    for k in range(count):
        expected[k] = w[k]
        if k:
            expected[k] += 0.8 * np.sin(6 * np.pi * k / count) * expected[k - 1]
            expected[k] += 0.9 * np.cos(10 * np.pi * k / count) * w[k - 1]
    np.testing.assert_allclose(disturbance.sample(count, STEP_S, rng()), expected, atol=1e-12)


def test_threshold_is_its_recursion():
    process = ThresholdMovingAverage((-0.5, 0.5), ((0.9,), (0.0,), (-0.9,)), delay=1)
    shocks = rng().standard_normal(1 + 10 + 50)
    series = [0.0]
    for k in range(1, shocks.size):
        x = series[-1]
        b = 0.9 if x <= -0.5 else 0.0 if x <= 0.5 else -0.9
        series.append(shocks[k] + b * shocks[k - 1])
    np.testing.assert_allclose(process.sample(50, STEP_S, rng()), series[11:], atol=1e-14)


def test_bilinear_is_uncorrelated_with_heavy_tails():
    """E x^4 = 3 s^4 (1 + 2 b^2 E x^2) / (1 - 3 b^4 s^4), and no autocovariance at all."""
    b, s = 0.5, 1.0
    process = bilinear(b, 2, 1, s)
    variance = s**2 / (1 - (b * s) ** 2)
    fourth = 3 * s**4 * (1 + 2 * b**2 * variance) / (1 - 3 * b**4 * s**4)
    series = realisations(process, 300, 800)
    assert_mean((series**4).mean(axis=1), fourth)
    assert fourth / variance**2 > 3.4
    assert_autocovariance(process, {1: 0.0, 2: 0.0, 3: 0.0})
    # Not independent: x[k] follows the product that drives it.
    bispectral = series[:, 3:] * series[:, 1:-2] * series[:, 2:-1]
    assert_mean(bispectral.mean(axis=1), b * variance * s**2)


def test_a_series_of_ones_own_is_taken_as_it_is():
    values = tuple(rng().standard_normal(20).tolist())
    np.testing.assert_array_equal(GivenDisturbance(values).sample(15, STEP_S, rng()), values[:15])
    with pytest.raises(ParameterError, match="a series of 21 values or more"):
        GivenDisturbance(values).sample(21, STEP_S, rng())


def test_coefficients_of_ones_own_make_the_recursion():
    """The same coefficients by a sinusoid, by its values, and as a sum of its halves."""
    trend = CoefficientCourse(mean=0.2, amplitude=0.6, cycles=3.0)
    given = GivenCourse(tuple(trend.values(200).tolist()))
    half = CoefficientCourse(mean=0.1, amplitude=0.3, cycles=3.0)
    series = [
        TimeVaryingArma(1.0, (item,), (item,)).sample(200, STEP_S, rng())
        for item in (trend, given, SumOfCourses((half, half)))
    ]
    np.testing.assert_allclose(series[1], series[0], rtol=1e-12)
    np.testing.assert_allclose(series[2], series[0], rtol=1e-10)
    with pytest.raises(ParameterError, match="a series of 201 values or more"):
        TimeVaryingArma(1.0, (given,)).sample(201, STEP_S, rng())


def test_arch_has_the_kurtosis_of_engle():
    """ARCH(1): kurtosis 3 (1 - a^2)/(1 - 3 a^2), autocorrelation of squares a^l, none of the series."""
    floor, a = 0.2, 0.3
    process = Garch(floor, (a,))
    variance = floor / (1 - a)
    kurtosis = 3 * (1 - a**2) / (1 - 3 * a**2)
    series = realisations(process, 400, 800)[:, 50:]
    assert_mean((series**4).mean(axis=1), kurtosis * variance**2)
    assert_mean((series[:, 1:] * series[:, :-1]).mean(axis=1), 0.0)
    squares = series**2 - variance
    spread = (kurtosis - 1.0) * variance**2
    assert_mean((squares[:, 2:] * squares[:, :-2]).mean(axis=1), a**2 * spread)


@pytest.mark.parametrize("shocks", [(0.3,), (0.2, 0.1)])
@pytest.mark.parametrize("persistence", [(), (0.4,), (0.2, 0.1, 0.2)])
def test_garch_is_its_recursion_limited_or_not(shocks, persistence):
    series = Garch(0.2, shocks, persistence).sample(300, STEP_S, rng())
    far = Garch(0.2, shocks, persistence, largest_square=1e9).sample(300, STEP_S, rng())
    np.testing.assert_array_equal(series, far)
    limit = 0.9 * float(np.max(series**2))
    near = Garch(0.2, shocks, persistence, largest_square=limit).sample(300, STEP_S, rng())
    first = int(np.argmax(series**2 > limit)) + 1
    np.testing.assert_allclose(near[:first], series[:first], rtol=1e-10)
    assert not np.allclose(near[first:], series[first:], rtol=1e-6)


def test_variance_switches_where_it_is_told():
    process = VarianceSwitch(WhiteDisturbance(0.5), factor=10.0, at=0.25)
    series = realisations(process, 80, 2000)
    assert_mean((series[:, :20] ** 2).mean(axis=1), 0.25)
    assert_mean((series[:, 20:] ** 2).mean(axis=1), 2.5)


def test_trend_and_sinusoids_are_what_they_say():
    t = STEP_S * np.arange(50)
    method = SumOfDisturbances((Trend((0.0, 3.0)), Sinusoids((2.0,), (0.05,))))
    expected = 3.0 * np.linspace(-1.0, 1.0, 50) + 2.0 * np.sin(0.05 * t)
    np.testing.assert_allclose(method.sample(50, STEP_S, rng()), expected, atol=1e-13)
    np.testing.assert_allclose(Trend((1.0, 0.0, 2.0)).sample(3, STEP_S, rng()), [3.0, 1.0, 3.0])
    cosine = Sinusoids((1.0,), (2.0,), (np.pi / 2.0,)).sample(50, STEP_S, rng())
    np.testing.assert_allclose(cosine, np.cos(2.0 * t), atol=1e-13)


@pytest.mark.thorough
def test_paper_disturbance_is_the_papers():
    """Mean over realisations: the sinusoids; variance about it: 1 + (9 + 1)."""
    series = realisations(paper_disturbance(), 40, 4000)
    t = STEP_S * np.arange(40)
    mean = np.sin(0.01 * t) + np.sin(10.0 * t)
    for k in (0, 17, 39):
        assert_mean(series[:, k], mean[k])
        assert_mean((series[:, k] - mean[k]) ** 2, 11.0)


@pytest.mark.thorough
def test_papers_first_coefficient_has_mean_zero_and_its_second_mean_three():
    """Exchanged, they would be this series read backward, which third moments of its squares tell apart.

    E x_k^2 x_{k+1}^4 = 7089 and E x_k^4 x_{k+1}^2 = 6873 follow from E c_1^2, c_1^4 = 1, 3, E c_2^2, c_2^4
    = 10, 138 and E w^2, w^4, w^6 = 1, 3, 15, as w[k-1] alone is in both.
    """
    moving, sinusoids = paper_disturbance().parts
    assert sinusoids == Sinusoids((1.0, 1.0), (0.01, 10.0))
    squares = realisations(moving, 40_000, 200) ** 2
    now, then = squares[:, :-1], squares[:, 1:]
    assert_mean((now * then * (then - now)).mean(axis=1), 7089.0 - 6873.0)
    assert (now * then * (then - now)).mean() > 100.0


def test_adversary_is_at_its_bounds_and_in_every_band():
    series = BoundedAdversary(0.7, 50.0, 1.0, high_share=0.5).sample(4000, STEP_S, rng())
    assert set(np.unique(series)) == {-0.7, 0.7}
    assert abs(series.mean()) < 0.05
    switches = np.flatnonzero(np.diff(series)) * STEP_S
    # Half a period more at each switch, where a period lasts longest * exp(-rate t).
    rate = np.log(50.0) / 800.0
    expected = np.log1p(rate * 25.0 * np.arange(1, switches.size + 1)) / rate
    np.testing.assert_allclose(switches, expected, atol=STEP_S)
    assert np.diff(switches)[-20:].mean() == pytest.approx(0.5, rel=0.1)  # half of the shortest
    leaning = BoundedAdversary(1.0, 50.0, 5.0, high_share=0.8).sample(4000, STEP_S, rng())
    assert leaning.mean() == pytest.approx(0.6, abs=0.05)
    constant = BoundedAdversary(1.0, 5.0, 5.0, high_share=1.0).sample(50, STEP_S, rng())
    np.testing.assert_array_equal(constant, 1.0)


def test_dryden_has_its_correlation():
    """exp(-t/tau) (1 - t / (2 tau)), tau = length / airspeed: negative beyond twice tau."""
    process = DrydenGust(0.8, 2.0, 4.0)
    lags = {lag: lag * STEP_S / 0.5 for lag in (0, 1, 3, 8)}
    expected = {lag: 0.64 * np.exp(-x) * (1.0 - x / 2.0) for lag, x in lags.items()}
    assert expected[8] < 0.0
    assert_autocovariance(process, expected, runs=1000)


def test_ornstein_uhlenbeck_forgets_exponentially():
    expected = {lag: 0.64 * np.exp(-lag * STEP_S / 0.5) for lag in (0, 1, 3)}
    assert_autocovariance(OrnsteinUhlenbeck(0.8, 0.5), expected, runs=1000)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: WhiteDisturbance(-1.0), "a finite std of zero or more; received std=-1.0"),
        (lambda: Arma(1.0, (1.0,)), r"stationary autoregression.*multiplied by 1 each step"),
        (lambda: Arma(1.0, (0.5, 0.6)), "stationary autoregression"),
        (lambda: Arma(float("nan")), "a finite std of zero or more; received std=nan"),
        (lambda: TimeVaryingArma(1.0, (CoefficientCourse(0.5, 0.6),)), "stationary at every time"),
        (lambda: RandomCoefficientMovingAverage((1.0,), (-1.0,)), "a finite std of a coefficient of zero"),
        (lambda: ThresholdMovingAverage((0.0,), ((0.1,), (0.2,)), delay=0), "delay of 1 or more"),
        (lambda: TimeVaryingArma(1.0, (GivenCourse((0.5, 1.5, 0.5)),)), "stationary at every time"),
        (lambda: SumOfCourses(()), "one or more parts"),
        (lambda: GivenDisturbance((1.0, float("nan"))), "a finite value"),
        (lambda: bilinear(1.0, std=1.0), "below one, so that the series is stationary; received 1"),
        (lambda: Garch(0.1, (0.5,), (0.5,)), "add up to less than one.*received 1"),
        (lambda: Garch(0.1, (0.5,), largest_square=0.0), "a finite largest_square above zero"),
        (lambda: VarianceSwitch(WhiteDisturbance(1.0), at=1.5), "a share of the record from 0 to 1"),
        (lambda: Trend(()), "one or more coefficients"),
        (lambda: Sinusoids((1.0,), (-1.0,)), "a finite frequency of zero or more"),
        (lambda: BoundedAdversary(1.0, 2.0, 1.0, 1.1), "a high_share from 0 to 1"),
        (lambda: SumOfDisturbances(()), "one or more parts"),
        (lambda: DrydenGust(1.0, 0.0, 1.0), "a finite length_m above zero"),
    ],
)
def test_impossible_disturbances_are_refused(make, said):
    with pytest.raises(ParameterError, match=f"Expected .*{said}"):
        make()
