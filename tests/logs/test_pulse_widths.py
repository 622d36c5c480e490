"""Motor outputs in microseconds become shares of the range that the log's parameters give."""

from __future__ import annotations

import numpy as np

from eivor.logs.ulog.channels import are_pulses, as_shares, motor_outputs, pulse_range
from eivor.motions.vertical.select import INPUTS
from logs.test_ulog import read
from logs.ulog_writer import UlogWriter

RISING = np.linspace(1100.0, 1900.0, 5)


def test_the_range_in_force_is_the_outputs_own_or_else_that_of_all():
    selected = {"PWM_MAIN_MIN2": 1100.0, "PWM_MAIN_MAX2": 1900.0, "PWM_MIN": 1000.0, "PWM_MAX": 2000.0}
    result = pulse_range("PWM_MAIN", 1, selected)
    assert result is not None
    assert (result.low, result.high, result.names) == (1100.0, 1900.0, ("PWM_MAIN_MIN2", "PWM_MAIN_MAX2"))
    np.testing.assert_allclose(
        result.share(np.array([900.0, 1100.0, 1500.0, 2000.0, np.nan])), [0, 0, 0.5, 1, np.nan]
    )
    general = pulse_range("PWM_MAIN", 0, {**selected, "PWM_MAIN_MIN1": -1.0, "PWM_MAIN_MAX1": -1.0})
    assert general is not None
    assert general.names == ("PWM_MIN", "PWM_MAX")
    assert pulse_range("PWM_MAIN", 0, {}) is None
    assert pulse_range("PWM_MAIN", 0, {"PWM_MIN": 2000.0, "PWM_MAX": 1000.0}) is None


def test_what_is_no_pulse_width_stays():
    assert are_pulses([RISING, 0.0 * RISING], {})
    assert not are_pulses([RISING / 2000.0], {})
    assert not are_pulses([RISING - 900.0], {})
    assert not are_pulses([], {})
    assert not are_pulses([RISING], {"PWM_MAIN_TIM0": -3.0})
    assert not are_pulses([RISING], {"DSHOT_CONFIG": 600.0})
    assert are_pulses([RISING], {"PWM_MAIN_TIM0": 400.0, "DSHOT_CONFIG": 0.0})


def test_outputs_are_told_by_their_motors():
    functions = {"PWM_AUX_FUNC1": 102.0, "PWM_AUX_FUNC2": 101.0, "PWM_AUX_FUNC3": 201.0}
    assert motor_outputs([0, 1, 2], functions) == ("PWM_AUX", {1: 1, 0: 2})
    assert motor_outputs([0, 2], {}) == ("PWM_MAIN", {0: 1, 2: 2})


def test_a_range_that_no_parameter_tells_is_said():
    values, finding = as_shares({0: RISING}, {})
    assert values[0] is RISING
    assert finding.name == "pulse_range_unknown"
    assert "no parameter gives their range (PWM_MAIN_MIN1 and PWM_MAIN_MAX1" in finding.message


def test_a_log_of_pulses_has_shares_for_an_input(tmp_path):
    t = np.arange(100) * 0.1
    widths = np.stack([1100 + t * 10, 1200 + t * 10, 1500 + t], 1)
    writer = UlogWriter(flags=False).topic("actuator_outputs", t, output=widths)
    for name, value in (
        ("PWM_MAIN_FUNC1", 102),
        ("PWM_MAIN_FUNC2", 101),
        ("PWM_MAIN_FUNC3", 201),
        *((f"PWM_MAIN_{end}{n}", width) for end, width in (("MIN", 1100), ("MAX", 1900)) for n in (1, 2)),
    ):
        writer = writer.parameter(name, value)
    r = read(tmp_path, writer)
    assert [channel.source for channel in r.family("actuator_output")] == [
        "actuator_outputs.output[1]",
        "actuator_outputs.output[0]",
    ]
    np.testing.assert_allclose(r.channels["actuator_output_1"].values, (100 + t * 10) / 800)
    (finding,) = [item for item in r.findings if item.name == "pulse_widths"]
    assert finding.message.endswith("shares of the range 1100 to 1900 (PWM_MAIN_MIN2 and PWM_MAIN_MAX2).")
    assert INPUTS[-1].name == "actuator_output"
    assert not INPUTS[-1].measured
