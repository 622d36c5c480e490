"""Simulated records against an integrator, against the model's own equation, and against each other."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from eivor.errors import ParameterError
from eivor.lab.disturbances import Arma
from eivor.lab.records import (
    ALWAYS_MEASURED,
    DisturbanceRoute,
    Intersample,
    Scenario,
    VelocityControl,
    simulate,
)
from eivor.motions.vertical.model import VerticalMotion
from eivor.signals.noise import FractionalNoise, WhiteNoise
from eivor.simulation.excitation import (
    GivenSeries,
    PaperInput,
    PseudoRandomBinary,
    SteppedExcitation,
    WhiteDisturbance,
    WhiteExcitation,
)

NOISY = {
    "velocity_z": FractionalNoise(1.0, -0.4),
    "acceleration_z": FractionalNoise(1.0, -0.5),
    "input": WhiteNoise(1.0),
}
RATIOS = {"velocity_z": 0.1, "acceleration_z": 0.045, "input": 0.045}
OPEN = Scenario(0.293, 0.021, samples=200)
FULL = replace(
    OPEN,
    noise=NOISY,
    noise_to_signal=RATIOS,
    disturbance=WhiteDisturbance(1.0),
    disturbance_to_signal=0.3,
)
CONTROL = {"control": VelocityControl(15.0, 4.0)}


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def integrated(scenario: Scenario, u: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Velocity at the samples by an adaptive integrator, interval by interval."""
    K, K_u, T = scenario.viscous_friction, scenario.input_gain, scenario.step_s
    linear = scenario.intersample is Intersample.LINEAR
    velocity = [0.0]
    for (u0, u1), e0 in zip(pairwise(u), e[:-1], strict=True):
        slope = (u1 - u0) / T if linear else 0.0
        solved = solve_ivp(
            lambda t, v, u0=u0, slope=slope, e0=e0: -K * v + K_u * (u0 + slope * t) + e0,
            (0.0, T),
            [velocity[-1]],
            rtol=1e-11,
            atol=1e-13,
        )
        velocity.append(float(solved.y[0, -1]))
    return np.array(velocity)


@pytest.mark.parametrize("intersample", list(Intersample))
@pytest.mark.parametrize("friction", [0.0, 1e-3, 0.293, 12.0])
def test_velocity_is_the_integrators(friction, intersample):
    scenario = replace(
        OPEN,
        viscous_friction=friction,
        samples=40,
        intersample=intersample,
        excitation=WhiteExcitation(1.0),
        disturbance=WhiteDisturbance(0.02),
        route=DisturbanceRoute.DYNAMICS,
    )
    truth = simulate(scenario, rng()).truth
    expected = integrated(scenario, truth.channel("input"), truth.channel("disturbance"))
    np.testing.assert_allclose(truth.channel("velocity_z"), expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("friction", [1e-6, 0.0499, 0.0501])
def test_series_and_closed_form_of_the_step_agree(friction):
    """At K T = 0.01 the one takes over from the other; a ramp shows both of its parts."""
    ramp = GivenSeries(tuple(np.arange(50.0)))
    scenario = replace(
        OPEN, viscous_friction=friction, samples=50, excitation=ramp, intersample=Intersample.LINEAR
    )
    channel = simulate(scenario, rng()).truth.channel("velocity_z")
    t, K = 0.2 * np.arange(50), friction
    with np.errstate(all="ignore"):
        exact = 0.021 * 5.0 * (t / K - (1.0 - np.exp(-K * t)) / K**2)
    close = 0.021 * 5.0 * (t**2 / 2 - K * t**3 / 6 + K**2 * t**4 / 24 - K**3 * t**5 / 120)
    np.testing.assert_allclose(channel, close if friction < 1e-3 else exact, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    "scenario", [FULL, replace(FULL, route=DisturbanceRoute.DYNAMICS), replace(FULL, **CONTROL)]
)
def test_truth_obeys_the_equation(scenario):
    truth = simulate(scenario, rng()).truth
    v, u, e = (truth.channel(name) for name in ("velocity_z", "input", "disturbance"))
    np.testing.assert_allclose(truth.channel("acceleration_z"), 0.021 * u - 0.293 * v + e, atol=1e-13)


def test_constant_input_ends_in_steady_state():
    """Work in equals work lost: z'' = 0 and z' = K_u u / K."""
    truth = simulate(replace(OPEN, excitation=SteppedExcitation((2.0,), 1e6), samples=600), rng()).truth
    assert truth.channel("velocity_z")[-1] == pytest.approx(0.021 * 2.0 / 0.293, rel=1e-9)
    assert abs(truth.channel("acceleration_z")[-1]) < 1e-9
    assert truth.channel("velocity_z")[0] == 0.0


def test_energy_is_conserved():
    """Kinetic energy at the end is the work of the input less that of friction, both in closed form."""
    scenario = replace(OPEN, excitation=PseudoRandomBinary(1.0, 7), samples=120)
    truth = simulate(scenario, rng()).truth
    v, u = truth.channel("velocity_z"), 0.021 * truth.channel("input")
    K, T = 0.293, 0.2
    # Within a step v = s + (v_k - s) exp(-K t), s = u / K.
    s, d = u[:-1] / K, v[:-1] - u[:-1] / K
    E1, E2 = (1 - np.exp(-K * T)) / K, (1 - np.exp(-2 * K * T)) / (2 * K)
    travelled = s * T + d * E1
    squared = s**2 * T + 2 * s * d * E1 + d**2 * E2
    assert np.sum(u[:-1] * travelled) - K * np.sum(squared) == pytest.approx(0.5 * v[-1] ** 2, rel=1e-10)


def test_routes_differ_as_they_should():
    """In the equation e shifts the response only; in the dynamics the velocity responds as to an input."""
    calm = simulate(replace(FULL, disturbance=None, disturbance_to_signal=None), rng()).truth
    shifted = simulate(FULL, rng()).truth
    pushed = simulate(replace(FULL, route=DisturbanceRoute.DYNAMICS), rng()).truth
    e = shifted.channel("disturbance")
    np.testing.assert_array_equal(pushed.channel("disturbance"), e)
    np.testing.assert_array_equal(shifted.channel("velocity_z"), calm.channel("velocity_z"))
    np.testing.assert_allclose(
        shifted.channel("acceleration_z") - calm.channel("acceleration_z"), e, atol=1e-15
    )
    moved = pushed.channel("velocity_z") - calm.channel("velocity_z")
    as_input = replace(OPEN, input_gain=1.0, excitation=GivenSeries(tuple(e.tolist())))
    np.testing.assert_allclose(moved, simulate(as_input, rng()).truth.channel("velocity_z"), atol=1e-14)
    assert np.std(moved) > 0.01 * np.std(calm.channel("velocity_z"))


@pytest.mark.parametrize("route", list(DisturbanceRoute))
@pytest.mark.parametrize("control", [{}, CONTROL])
def test_ratios_are_of_the_motion_without_noise(route, control):
    scenario = replace(FULL, route=route, **control)
    result = simulate(scenario, rng())
    noiseless = simulate(replace(scenario, noise_to_signal=dict.fromkeys(RATIOS, 0.0)), rng()).truth
    undisturbed = simulate(
        replace(scenario, noise_to_signal={}, noise={}, disturbance=None, disturbance_to_signal=None), rng()
    ).truth
    response = undisturbed.channel("acceleration_z")
    assert result.truth.channel("disturbance").std() == pytest.approx(0.3 * response.std(), rel=1e-12)
    for name, ratio in RATIOS.items():
        expected = NOISY[name].with_std(ratio * float(noiseless.channel(name).std()))
        assert result.signals.noise[name].std == pytest.approx(expected.std, rel=1e-12)
        assert type(result.signals.noise[name]) is type(expected)


@pytest.mark.parametrize("control", [{}, CONTROL])
def test_measured_is_true_plus_declared(control):
    """Each error, divided by its declared std, is the unit noise of its own stream."""
    result = simulate(replace(FULL, **control), rng())
    streams = rng().spawn(5)
    for name, stream in zip(ALWAYS_MEASURED, streams[2:], strict=True):
        error = result.signals.channel(name) - result.truth.channel(name)
        declared = result.signals.noise[name]
        np.testing.assert_allclose(error, declared.sample(200, stream), atol=1e-12)
    assert result.parameters == {"viscous_friction": 0.293, "input_gain": 0.021}


def test_absolute_std_is_kept_and_silence_declared():
    scenario = replace(OPEN, noise={"input": WhiteNoise(0.05)})
    signals = simulate(scenario, rng()).signals
    assert signals.noise == {
        "velocity_z": WhiteNoise(0.0),
        "acceleration_z": WhiteNoise(0.0),
        "input": WhiteNoise(0.05),
    }


def test_noise_by_ratio_alone_is_white():
    scenario = replace(OPEN, noise_to_signal={"input": 0.1})
    result = simulate(scenario, rng())
    std = 0.1 * float(result.truth.channel("input").std())
    assert isinstance(result.signals.noise["input"], WhiteNoise)
    assert result.signals.noise["input"].std == pytest.approx(std)


CHANGES = [
    ("excitation", {"excitation": WhiteExcitation(1.0)}),
    ("disturbance", {"disturbance": Arma(1.0, (0.5,))}),
    ("velocity_z", {"noise": NOISY | {"velocity_z": WhiteNoise(1.0)}}),
    ("acceleration_z", {"noise": NOISY | {"acceleration_z": FractionalNoise(1.0, 0.2)}}),
    ("input", {"noise": NOISY | {"input": FractionalNoise(1.0, -0.1)}}),
]


@pytest.mark.parametrize(("changed", "change"), CHANGES, ids=[name for name, _ in CHANGES])
def test_changing_one_source_leaves_the_others(changed, change):
    """Realisations in units of their own std, since ratios make sizes depend on each other."""

    def sources(scenario: Scenario) -> dict[str, np.ndarray]:
        result = simulate(scenario, rng())
        errors = {name: result.signals.channel(name) - result.truth.channel(name) for name in ALWAYS_MEASURED}
        errors |= {
            "excitation": result.truth.channel("input"),
            "disturbance": result.truth.channel("disturbance"),
        }
        return {name: values / values.std() for name, values in errors.items()}

    before, after = sources(FULL), sources(replace(FULL, **change))
    for name, values in before.items():
        same = np.allclose(values, after[name], atol=1e-9)
        assert same == (name != changed), name


def test_same_generator_same_record_and_the_next_another():
    signals, other = simulate(FULL, rng()).signals, simulate(FULL, rng()).signals
    stream = rng()
    simulate(FULL, stream)
    following = simulate(FULL, stream).signals
    for name in ALWAYS_MEASURED:
        np.testing.assert_array_equal(signals.channel(name), other.channel(name))
        assert not np.array_equal(signals.channel(name), following.channel(name))


@pytest.mark.parametrize("route", list(DisturbanceRoute))
def test_control_is_its_recursion(route):
    """Sample by sample: u = P d + I T sum(d), d = r - measured velocity."""
    result = simulate(replace(FULL, route=route, **CONTROL), rng())
    truth, signals = result.truth, result.signals
    r, e = truth.channel("reference_velocity_z"), truth.channel("disturbance")
    error = signals.channel("velocity_z") - truth.channel("velocity_z")
    a = np.exp(-0.293 * 0.2)
    H = (1.0 - a) / 0.293
    v, total = 0.0, 0.0
    for k in range(200):
        assert truth.channel("velocity_z")[k] == pytest.approx(v, abs=1e-12)
        d = r[k] - v - error[k]
        total += d
        u = 15.0 * d + 4.0 * 0.2 * total
        assert truth.channel("input")[k] == pytest.approx(u, abs=1e-10)
        v = a * v + H * (0.021 * u + (e[k] if route is DisturbanceRoute.DYNAMICS else 0.0))


def test_control_follows_its_reference():
    scenario = replace(OPEN, excitation=SteppedExcitation((1.0,), 1e6), samples=400, **CONTROL)
    result = simulate(scenario, rng())
    assert result.truth.channel("velocity_z")[-1] == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_array_equal(result.signals.channel("reference_velocity_z"), 1.0)
    assert result.signals.noise["reference_velocity_z"] == WhiteNoise(0.0)


def test_record_without_noise_gives_its_parameters_back():
    signals = simulate(replace(OPEN, excitation=PaperInput()), rng()).signals
    rows = VerticalMotion(intercept=False).regression(signals).rows()
    solution = np.linalg.lstsq(rows.regressors, rows.response, rcond=None)[0]
    np.testing.assert_allclose(solution, [0.293, 0.021], rtol=1e-10)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"viscous_friction": -0.1}, "viscous_friction of zero or more; received -0.1"),
        ({"viscous_friction": float("nan")}, "viscous_friction of zero or more; received nan"),
        ({"input_gain": float("inf")}, "a finite input_gain"),
        ({"rate_hz": 0.0}, "rate_hz above zero; received 0.0"),
        ({"samples": 1}, "samples of 2 or more; received 1"),
        ({"noise": {"altitude": WhiteNoise(1.0)}}, "noise of velocity_z.*received noise of 'altitude'"),
        ({"noise_to_signal": {"input": -1.0}}, "noise_to_signal of zero or more for input; received -1.0"),
        ({"noise_to_signal": {"u": 0.1}}, "received noise of 'u'"),
        ({"disturbance_to_signal": 0.1}, "a disturbance to scale; received disturbance_to_signal alone"),
        (
            {"disturbance_to_signal": -0.1, "disturbance": WhiteDisturbance(1.0)},
            "disturbance_to_signal of zero or more; received -0.1",
        ),
        (
            {"noise": {"position_z": WhiteNoise(1.0)}},
            "noise of velocity_z, acceleration_z, input; received noise of 'position_z'.*control only",
        ),
        (
            {"noise_to_signal": {"specific_force_z": 0.1}},
            "received noise of 'specific_force_z'. A scenario moves about hover.*is acceleration_z",
        ),
        (CONTROL | {"intersample": Intersample.LINEAR}, "held between samples.*'linear'"),
    ],
)
def test_impossible_scenarios_are_refused(change, said):
    with pytest.raises(ParameterError, match=f"Expected .*{said}"):
        replace(OPEN, **change)


def test_disturbance_without_variation_cannot_be_scaled():
    scenario = replace(OPEN, disturbance=WhiteDisturbance(0.0), disturbance_to_signal=0.1)
    with pytest.raises(ParameterError, match="a disturbance that varies"):
        simulate(scenario, rng())
