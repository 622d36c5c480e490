"""Each disturbance against a property that theory gives, with bounds from Monte Carlo's standard error."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter

import eivor as ev
from eivor.errors import ParameterError
from eivor.lab.disturbances import (
    Arma,
    Bilinear,
    BilinearTerm,
    BoundedAdversary,
    CoefficientCourse,
    Garch,
    GivenDisturbance,
    OrnsteinUhlenbeck,
    RandomCoefficientMovingAverage,
    Sinusoids,
    SumOfDisturbances,
    ThresholdMovingAverage,
    TimeVaryingArma,
    Trend,
    VarianceSwitch,
    paper_disturbance,
)
from eivor.lab.records import Control, DisturbanceRoute, respond
from eivor.signals.recording import GRAVITY
from eivor.simulation.excitation import (
    DrydenGust,
    FilteredWhite,
    GivenSeries,
    Multisine,
    PaperInput,
    SteppedExcitation,
    WhiteDisturbance,
    WhiteExcitation,
    maximal_sequence,
)
from eivor.simulation.vertical import (
    THRUST_RANGE,
    AltitudeController,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)

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
    (Bilinear((BilinearTerm(0.6, 3, 1),), 1.1), 1.21 / (1.0 - 0.66**2)),
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
    moving = CoefficientCourse(amplitude=0.9, cycles=5.0, phase=np.pi / 2.0)
    disturbance = TimeVaryingArma(2.0, (CoefficientCourse(amplitude=0.8, cycles=3.0),), (moving,))
    w = 2.0 * rng().standard_normal(count)
    expected = w.copy()
    for k in range(1, count):
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
    process = Bilinear((BilinearTerm(b, 2, 1),), s)
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
    for kind in (GivenDisturbance, GivenSeries):
        np.testing.assert_array_equal(kind(values).sample(15, STEP_S, rng()), values[:15])


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


@pytest.mark.parametrize(
    ("process", "expected"),
    [
        # exp(-t/tau) (1 - t / (2 tau)), tau = length / airspeed: negative beyond twice tau
        (DrydenGust(0.8, 2.0, 4.0), {k: np.exp(-0.4 * k) * (1.0 - 0.2 * k) for k in (0, 1, 3, 8)}),
        (OrnsteinUhlenbeck(0.8, 0.5), {k: np.exp(-0.4 * k) for k in (0, 1, 3)}),
    ],
    ids=["Dryden", "Ornstein-Uhlenbeck"],
)
def test_gusts_have_their_correlation(process, expected):
    assert_autocovariance(process, {lag: 0.64 * share for lag, share in expected.items()}, runs=1000)


def sampled(excitation, count=4000, seed=1):
    return excitation.sample(count, STEP_S, rng(seed))


def power_outside(series, low_hz, high_hz):
    """Share of the power outside a band."""
    power = np.abs(np.fft.rfft(series)) ** 2
    frequencies = np.fft.rfftfreq(series.size, STEP_S)
    inside = (frequencies > low_hz - 1e-9) & (frequencies < high_hz + 1e-9)
    return float(power[~inside].sum() / power.sum())


def test_paper_input_is_its_equation():
    count = 30
    w = np.sqrt(0.02) * rng().standard_normal(count + 2)
    t = STEP_S * np.arange(count)
    expected = [0.7 * w[k + 1] + 0.49 * w[k] + np.sin(0.1 * t[k] ** 1.1) for k in range(count)]
    np.testing.assert_allclose(sampled(PaperInput(), count), expected, atol=1e-14)


def test_filtered_white_keeps_to_its_band():
    series = sampled(FilteredWhite(0.5, 0.1, 1.5))
    assert power_outside(series, 0.1, 1.5) < 1e-25
    variances = [sampled(FilteredWhite(0.5, 0.1, 1.5), 500, seed).var() for seed in range(400)]
    assert np.mean(variances) == pytest.approx(0.25, rel=4.5 * np.std(variances) / 0.25 / 20)


def test_multisine_is_flat_in_its_band_and_low_in_its_peak():
    series = sampled(Multisine(0.5, 0.05, 1.0))
    assert series.std() == pytest.approx(0.5, rel=1e-12)
    assert power_outside(series, 0.05, 1.0) < 1e-25
    power = np.abs(np.fft.rfft(series))
    frequencies = np.fft.rfftfreq(4000, STEP_S)
    inside = (frequencies > 0.05 - 1e-9) & (frequencies < 1.0 + 1e-9)
    np.testing.assert_allclose(power[inside], power[inside].mean(), rtol=1e-9)
    assert np.abs(series).max() / series.std() < 1.9
    random_phases = np.fft.irfft(np.where(inside, np.exp(2j * np.pi * rng().random(inside.size)), 0.0))
    assert np.abs(random_phases).max() / random_phases.std() > 3.0


@pytest.mark.parametrize("register", range(2, 17))
def test_binary_sequence_is_maximal(register):
    """Autocorrelation: the period at shift zero and -1 at every other one."""
    period = maximal_sequence(register)
    assert period.size == 2**register - 1
    correlation = np.fft.irfft(np.abs(np.fft.rfft(period)) ** 2, period.size)
    assert correlation[0] == pytest.approx(period.size)
    np.testing.assert_allclose(correlation[1:], -1.0, atol=1e-6)


# Controlled vehicles against plain loops, a matrix exponential, an integrator, and each other.

K, K_U, T = 0.293, 0.021, 0.2
VELOCITY, ALTITUDE = Control(15.0, 4.0), Control(30.0, 5.0, 0.4)
CONTROLS = [VELOCITY, Control(15.0), ALTITUDE, Control(30.0, altitude_gain=0.4)]
QUIET = ev.Scenario(K, K_U, samples=150, excitation=WhiteExcitation(1.0), control=ALTITUDE)
NOISE = {"velocity_z": ev.FractionalNoise(0.02, -0.4), "position_z": ev.FractionalNoise(0.05, -0.2)}
NOISE |= {"acceleration_z": ev.WhiteNoise(0.1), "input": ev.WhiteNoise(0.5)}


@pytest.mark.parametrize("control", CONTROLS, ids=str)
@pytest.mark.parametrize("route", list(DisturbanceRoute))
@pytest.mark.parametrize("friction", [0.0, K])
def test_loop_is_that_of_a_flight_controller(control, route, friction):
    """Sample by sample, in the order in which a controller computes; motion between samples by expm."""
    names = ("velocity_z", "input", "position_z")[: 2 + bool(control.altitude_gain)]
    noise, pushed = {name: NOISE[name] for name in names}, WhiteDisturbance(0.05)
    made = {"viscous_friction": friction, "control": control, "noise": noise, "route": route}
    scenario = replace(QUIET, disturbance=pushed, **made)
    result = ev.simulate(scenario, rng())
    truth, signals = result.truth.channels, result.signals.channels
    errors = {name: signals[name] - truth[name] for name in noise}
    flow = expm(T * np.array([[-friction, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    velocity, altitude, total = 0.0, 0.0, 0.0
    reference, disturbance = truth[control.reference], truth["disturbance"]
    for k in range(scenario.samples):
        setpoint = reference[k]
        if control.altitude_gain:
            assert truth["position_z"][k] == pytest.approx(altitude, abs=1e-11)
            setpoint = control.altitude_gain * (reference[k] - altitude - errors["position_z"][k])
        missing = setpoint - velocity - errors["velocity_z"][k]
        total += missing
        u = control.velocity_gain * missing + control.velocity_integral_gain * T * total
        assert truth["velocity_z"][k] == pytest.approx(velocity, abs=1e-11)
        assert truth["input"][k] == pytest.approx(u, abs=1e-9)
        force = K_U * u + disturbance[k]
        assert truth["acceleration_z"][k] == pytest.approx(force - friction * velocity, abs=1e-11)
        push = K_U * u + (disturbance[k] if route is DisturbanceRoute.DYNAMICS else 0.0)
        velocity, altitude, _ = flow @ [velocity, altitude, push]


def test_altitude_follows_its_reference():
    """Without steady error, also against a constant push, since the velocity's errors are summed."""
    steps = replace(QUIET, excitation=SteppedExcitation((1.0,), 1e6), samples=1500)
    result = ev.simulate(steps, rng())
    assert result.truth.channel("position_z")[-1] == pytest.approx(1.0, abs=1e-8)
    assert result.truth.channel("position_z")[0] == 0.0
    np.testing.assert_array_equal(result.signals.channel("reference_position_z"), 1.0)
    pushed, _, altitude = respond(steps, np.zeros(1500), np.full(1500, 0.3))
    assert altitude[-1] == pytest.approx(0.0, abs=1e-7)
    assert pushed[-1] == pytest.approx(-0.3 / K_U, rel=1e-6)


def loop_by_columns(control):
    """Matrix of the loop, each column by letting the controller and the vehicle make one step."""
    altitude_gain = control.altitude_gain
    a, held = np.exp(-K * T), (1.0 - np.exp(-K * T)) / K
    columns = []
    for velocity, altitude, total in np.eye(3):
        missing = -altitude_gain * altitude - velocity
        u = control.velocity_gain * missing + control.velocity_integral_gain * T * (total + missing)
        pushed = K_U * u
        climbed = altitude + held * velocity + (T - held) / K * pushed
        columns.append([a * velocity + held * pushed, climbed, total + missing])
    used = [True, altitude_gain != 0.0, control.velocity_integral_gain != 0.0]
    return np.array(columns).T[np.ix_(used, used)]


@pytest.mark.parametrize("altitude", [0.0, 0.3, 3.0, 40.0])
@pytest.mark.parametrize("gain", np.geomspace(1.0, 900.0, 8).tolist())
@pytest.mark.parametrize("integral", [0.0, 0.4, 40.0, 1500.0])
def test_loops_called_stable_are(altitude, gain, integral):
    control = Control(gain, integral, altitude)
    stable = bool(np.abs(np.linalg.eigvals(loop_by_columns(control))).max() < 1.0)
    with nullcontext() if stable else pytest.raises(ParameterError):
        replace(QUIET, control=control)


FLIGHT_STEP_S = 0.01
VEHICLES = VerticalVehicles(
    viscous_friction=np.array([0.18, 0.87, 0.4, 0.5]),
    input_gain=np.array([40.0, 25.0, 9.0, 1.5e-5]),
    lag_s=np.array([0.005, 0.12, 0.03, 0.06]),
    delay_s=np.array([0.02, 0.0, 0.014, 0.006]),
)
CONTROLLER = AltitudeController(
    position_gain=np.array([1.2, 0.8, 1.0, 0.9]),
    velocity_gain=np.array([4.0, 2.2, 3.0, 2.5]),
    integral_gain=np.array([1.0, 0.3, 0.5, 0.4]),
)


def environment(count=150):
    """Everything at once: trajectory, wind, tilt and noise, different for each flight."""
    rng = np.random.default_rng(5)
    time = FLIGHT_STEP_S * np.arange(count)[:, None]
    pulsation = np.array([1.0, 2.0, 3.0, 5.0])
    gust = np.cumsum(0.1 * rng.standard_normal((count, 4)), axis=0)
    return VerticalEnvironment(
        reference_position=np.sin(pulsation * time),
        reference_velocity=pulsation * np.cos(pulsation * time),
        reference_acceleration=-(pulsation**2) * np.sin(pulsation * time),
        gust=gust,
        cos_tilt=np.cos(0.1 * np.sin(2.0 * time + pulsation)),
        position_noise=0.01 * rng.standard_normal((count, 4)),
        velocity_noise=0.05 * rng.standard_normal((count, 4)),
        acceleration_noise=np.zeros((count, 4)),
    )


@pytest.mark.parametrize("index", range(4))
def test_flight_is_that_of_an_independent_integration(index):
    """The closed loop once more: one flight, the equations as they are written, a general integrator."""
    vehicle, met, gains = (
        {f.name: getattr(part, f.name)[..., index] for f in fields(part)}
        for part in (VEHICLES, environment(), CONTROLLER)
    )
    motion = simulate_vertical(VEHICLES, environment(), step_s=FLIGHT_STEP_S, controller=CONTROLLER)
    K, K_u, lag = vehicle["viscous_friction"], vehicle["input_gain"], vehicle["lag_s"]
    hover = np.sqrt(GRAVITY / K_u)
    state = np.array([hover, met["reference_position"][0], met["reference_velocity"][0]])
    integral, issued = 0.0, []

    def received(time):
        period = int(np.floor((time - vehicle["delay_s"]) / FLIGHT_STEP_S + 1e-6))
        return issued[period] if period >= 0 else hover

    for k in range(met["gust"].size):
        w, z, v = state
        force = K_u * met["cos_tilt"][k] * w**2 - K * (v - met["gust"][k])
        columns = (motion.rotor_state, motion.position, motion.velocity, motion.specific_force)
        ours = [column[k, index] for column in columns]
        np.testing.assert_allclose(ours, [w, z, v, force], rtol=1e-9, atol=1e-8)
        wanted = met["reference_velocity"][k]
        wanted += gains["position_gain"] * (met["reference_position"][k] - z - met["position_noise"][k])
        error = wanted - v - met["velocity_noise"][k]
        integral += error * FLIGHT_STEP_S
        pull = GRAVITY + met["reference_acceleration"][k]
        pull += gains["velocity_gain"] * error + gains["integral_gain"] * integral
        thrust = np.clip(pull / met["cos_tilt"][k] / GRAVITY, *THRUST_RANGE[:, 0])
        issued.append(hover * np.sqrt(thrust))
        assert motion.command[k, index] == pytest.approx(issued[-1], rel=1e-9)

        def derivative(_, y, command, k=k):
            lift = K_u * met["cos_tilt"][k] * y[0] ** 2
            return [(command - y[0]) / lag, y[2], lift - K * (y[2] - met["gust"][k]) - GRAVITY]

        # A command that comes late arrives inside a control period: integrate up to there, then on.
        start = k * FLIGHT_STEP_S
        arrival = start + vehicle["delay_s"] % FLIGHT_STEP_S
        for begin, end in ((start, arrival), (arrival, start + FLIGHT_STEP_S)):
            if end - begin > 1e-9:
                command = received(0.5 * (begin + end))
                state = solve_ivp(
                    derivative, (begin, end), state, "DOP853", rtol=1e-11, atol=1e-12, args=(command,)
                ).y[:, -1]


def test_thrust_stays_in_its_range():
    wild = environment()
    hard = replace(wild, reference_acceleration=300.0 * wild.reference_acceleration)
    command = simulate_vertical(VEHICLES, hard, step_s=FLIGHT_STEP_S, controller=CONTROLLER).command
    share = command**2 * VEHICLES.input_gain / GRAVITY
    assert share.min() == pytest.approx(THRUST_RANGE[0, 0])
    assert share.max() == pytest.approx(THRUST_RANGE[1, 0])
