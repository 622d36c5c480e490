"""The difference equation: its recursion by another route, its regression, and published figures."""

from __future__ import annotations

import numpy as np
import pytest

import eivor
from eivor.errors import ParameterError
from eivor.lab.experiments import DifferenceEquation
from eivor.signals.noise import FractionalNoise, WhiteNoise
from eivor.simulation.excitation import WhiteDisturbance, autoregression, constant
from studies.study_parts import Coin


def test_recursion_is_that_of_the_equation():
    rng = np.random.default_rng(1)
    a, driven = (1.2, -0.6, 0.1), rng.standard_normal(50)
    y = np.zeros(53)
    for k in range(50):
        y[k + 3] = a[0] * y[k + 2] + a[1] * y[k + 1] + a[2] * y[k] + driven[k]
    np.testing.assert_allclose(autoregression(driven, constant(a, driven.size)), y[3:], rtol=1e-12)
    np.testing.assert_array_equal(autoregression(driven, constant((), driven.size)), driven)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_exact_without_noise(delay):
    """Every coefficient comes back, so regressors, lags and names belong together."""
    equation = DifferenceEquation((0.9, -0.4), (2.0, -1.0, 0.5), Coin(), delay=delay, samples=100)
    signals = equation.record(np.random.default_rng(2))
    fit = eivor.identify(equation.problem(signals, ()), eivor.methods.least_squares())
    assert fit.parameters == pytest.approx(dict(equation.truth), rel=1e-10)
    assert list(equation.truth)[:2] == ["output_lag_1", "output_lag_2"]
    assert list(equation.truth)[2:] == [f"input_lag_{delay + j}" for j in range(3)]


def test_noise_is_declared_as_added():
    equation = DifferenceEquation(
        (0.5,), (2.0,), Coin(), noise={"output": FractionalNoise(1.0, -0.4)}, noise_to_signal={"output": 0.1}
    )
    quiet = DifferenceEquation((0.5,), (2.0,), Coin())
    noisy, true = (item.record(np.random.default_rng(3)) for item in (equation, quiet))
    declared = noisy.noise["output"]
    assert isinstance(declared, FractionalNoise)
    assert declared.order == -0.4
    assert declared.std == pytest.approx(0.1 * true.channel("output").std())
    assert noisy.noise["input"] == WhiteNoise(0.0)
    np.testing.assert_array_equal(noisy.channel("input"), true.channel("input"))
    assert not np.array_equal(noisy.channel("output"), true.channel("output"))


def test_a_disturbance_moves_the_machine():
    """Its effect on the output is the recursion of the disturbance itself."""
    parts = ((0.8,), (1.0,), Coin())
    disturbed = DifferenceEquation(*parts, disturbance=WhiteDisturbance(1.0)).record(np.random.default_rng(4))
    free = DifferenceEquation(*parts).record(np.random.default_rng(4))
    effect = disturbed.channel("output") - free.channel("output")
    series = effect - 0.8 * np.concatenate([[0.0], effect[:-1]])
    assert series.std() == pytest.approx(1.0, rel=0.1)
    assert abs(np.corrcoef(series[1:], series[:-1])[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"output_coefficients": (1.0,)}, r"stable equation; received \[1.0\], with a root of modulus 1"),
        ({"input_coefficients": ()}, "at least one input coefficient; received none"),
        ({"input_coefficients": (float("nan"),)}, "finite coefficients; received nan"),
        ({"delay": -1}, "a delay of zero or more samples; received -1"),
        ({"samples": 2}, "samples of 3 or more for 2 unknowns; received 2"),
        ({"rate_hz": 0.0}, "rate_hz above zero; received 0.0"),
        ({"noise_to_signal": {"input": -0.1}}, "noise_to_signal of zero or more for input; received -0.1"),
        (
            {"noise": {"velocity_z": WhiteNoise(1.0)}},
            "noise of output, input; received noise of 'velocity_z'",
        ),
    ],
)
def test_what_is_refused(changes, message):
    parts = {"output_coefficients": (0.5,), "input_coefficients": (2.0,), "excitation": Coin()}
    with pytest.raises(ParameterError, match=message):
        DifferenceEquation(**(parts | changes))
