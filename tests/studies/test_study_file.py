"""Study files: what they may say, and what is said about those that may not."""

from __future__ import annotations

import pytest

from eivor.errors import InputError
from eivor.lab.experiments import DifferenceEquation
from eivor.lab.scenario_files import read_study
from eivor.lab.study import MethodChoice
from eivor.signals.noise import FractionalNoise, WhiteNoise
from eivor.simulation.excitation import PseudoRandomBinary, WhiteDisturbance

VERTICAL = """
viscous_friction = 0.3
input_gain = 0.02
samples = 300
"""
STUDY = f"""
runs = 5
seed = 3
[scenario]
{VERTICAL}
[[methods]]
name = "least_squares"
"""
HUGE, ENORMOUS, HEXADECIMAL = "1" + 400 * "0", "1" + 5000 * "0", "0x" + 5000 * "f"
#: Key, what it is in `STUDY`, numbers that no float or array holds, and what is said.
EXTREMES = [
    ("runs", "5", HUGE, "Expected whole numbers of 64 bits at runs of mine.toml; received one of 1330"),
    ("runs", "5", ENORMOUS, "Expected a study in TOML; received .*mine.toml', which is not"),
    ("runs", "5", HEXADECIMAL, "64 bits at runs of mine.toml; received one of 20001"),
    ("seed", "3", "9223372036854775808", "64 bits at seed of mine.toml; received one of 65"),
    ("seed", "3", f"3\nlevel = {HUGE}", "64 bits at level of mine.toml"),
    ("seed", "3", f"3\nx = [1, {{ y = {HUGE} }}]", r"64 bits at x\[2\].y of mine.toml"),
    (
        "viscous_friction",
        "0.3",
        "1e308",
        "numbers of 1e-30 to 1e.30 in size, at scenario.viscous_friction of mine",
    ),
    ("viscous_friction", "0.3", "1e155", "received 1e.155"),
    ("viscous_friction", "0.3", HUGE, "64 bits at scenario.viscous_friction of mine.toml"),
    ("input_gain", "0.02", "-1e308", "received -1e.308"),
    ("samples", "300", "300\nrate_hz = 1e-308", "at scenario.rate_hz of mine.toml; received 1e-308"),
]


def read(folder, text):
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return read_study(path)


def test_everything_that_a_study_may_say(tmp_path):
    study = read(
        tmp_path,
        """
        name = "all"
        runs = 5
        seed = 3
        intervals = true
        level = 0.9
        [scenario]
        kind = "difference_equation"
        output_coefficients = [0.5, -0.1]
        input_coefficients = [2]
        delay = 2
        samples = 100
        rate_hz = 10
        excitation = { kind = "pseudo_random_binary", amplitude = 1.0, register = 5 }
        disturbance = { kind = "white", std = 0.1 }
        noise.output = { kind = "fractional", order = -0.4, std = 0.2 }
        noise.input = { kind = "white", ratio_to_signal = 0.1 }
        [[methods]]
        name = "extended_iv"
        lags = [1, 4]
        channel = "output"
        weighting = "two_stage"
        known_noise = []
        label = "odd"
        """,
    )
    assert (study.name, study.intervals, study.level) == ("all", True, 0.9)
    assert study.experiment == DifferenceEquation(
        (0.5, -0.1),
        (2.0,),
        PseudoRandomBinary(1.0, 5),
        delay=2,
        samples=100,
        rate_hz=10.0,
        noise={"output": FractionalNoise(0.2, -0.4), "input": WhiteNoise(1.0)},
        noise_to_signal={"input": 0.1},
        disturbance=WhiteDisturbance(0.1),
    )
    assert study.methods == (MethodChoice("extended_iv", (1, 4), "output", "two_stage", (), "odd"),)


def test_a_scenario_of_its_own_file(tmp_path):
    (tmp_path / "flight.toml").write_text(VERTICAL, encoding="utf-8")
    text = STUDY.replace(f"[scenario]\n{VERTICAL}", 'scenario = "flight.toml"')
    assert read(tmp_path, text).identity == read(tmp_path, STUDY).identity
    (tmp_path / "flight.toml").unlink()
    with pytest.raises(
        InputError, match=r"Expected a scenario in TOML; received .*flight.toml', unreadable: No such"
    ):
        read(tmp_path, text)


EQUATION = """
kind = "difference_equation"
output_coefficients = [0.5]
input_coefficients = [2.0]
excitation = { kind = "white" }
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("runs = 5", "", "Expected a whole number at runs of mine.toml; received nothing. Add it."),
        ("runs = 5", "rnus = 5", "Is 'rnus' meant to be it"),
        ("runs = 5", "runs = -5", r"Expected runs from 1 to 10000000 at the top of mine.toml; received -5"),
        ("runs = 5", "runs = true", "Expected a whole number at runs of mine.toml; received True"),
        ("seed = 3", "seed = 3\nsede = 4", r"received the unknown key 'sede'\. Did you mean 'seed'"),
        ("seed = 3", "seed = 3\nlevel = inf", "Expected a finite number at level of mine.toml; received inf"),
        ("seed = 3", "seed = 3 3", "Expected a study in TOML; received .*mine.toml', which is not"),
        ("[[methods]]", "[methods]", "Expected a list of tables at methods of mine.toml"),
        (
            '"least_squares"',
            '"least_square"',
            r"at methods\[1\] of mine.toml; received 'least_square'.*'least_squares'",
        ),
        (
            '"least_squares"',
            '"extended_iv"\nlag = [1, 2]',
            r"received the unknown key 'lag'\. Did you mean 'lags'",
        ),
        ('"least_squares"', '"extended_iv"\nlags = [2, 1]', r"Expected \[first, last\].* received \[2, 1\]"),
        (
            '"least_squares"',
            '"extended_iv"\nlags = [0.5, 1]',
            r"Expected a whole number at methods\[1\].lags\[1\] of mine.toml; received 0.5",
        ),
        (
            '"least_squares"',
            '"least_squares"\nknown_noise = "input"',
            r"Expected a list of texts at methods\[1\].known_noise of mine.toml; received 'input'",
        ),
        (
            "input_gain",
            "input_gian",
            r"at scenario of mine.toml; received the unknown key 'input_gian'. Did you mean 'input_gain'",
        ),
        ("samples = 300", 'samples = "x"', "Expected a whole number at scenario.samples"),
        (VERTICAL, 'kind = "vertcal"', "Did you mean 'vertical'"),
        (VERTICAL, EQUATION.replace("0.5", "1.5"), "a stable equation at scenario of mine.toml"),
        (
            VERTICAL,
            EQUATION.replace("[0.5]", '["a"]'),
            r"Expected a finite number at scenario.output_coefficients\[1\] of mine.toml; received 'a'",
        ),
        (VERTICAL, EQUATION + "noise.outptu.kind = 'white'", "unknown key 'outptu'.* Did you mean 'output'"),
        (
            VERTICAL,
            EQUATION + "noise.input = { kind = 'white', std = -1.0 }",
            "at scenario.noise.input of mine.toml; received std=-1",
        ),
        *((f"{key} = {value}", f"{key} = {number}", message) for key, value, number, message in EXTREMES),
        (
            '"least_squares"',
            '"extended_iv"\nlags = [0, 99999999999]',
            "10000 lags or fewer at methods.1. of mine",
        ),
        (VERTICAL, EQUATION + "samples = 99999999999", "50000000 samples or fewer at scenario.samples"),
    ],
)
def test_what_is_refused(tmp_path, old, new, message):
    assert old in STUDY
    with pytest.raises(InputError, match=message):
        read(tmp_path, STUDY.replace(old, new))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="unreadable: No such file"):
        read_study(tmp_path / "absent.toml")
    with pytest.raises(InputError, match="unreadable: Is a directory"):
        read_study(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="unreadable: "):
        read_study(tmp_path / "binary.toml")
    (tmp_path / "deep.toml").write_text(f"x = {'[' * 100_000}", encoding="utf-8")
    with pytest.raises(InputError, match=r"deep.toml', which is not"):
        read_study(tmp_path / "deep.toml")
    (tmp_path / "large.toml").write_bytes(b"#" * 1_000_001)
    with pytest.raises(InputError, match="larger than 1000000 bytes"):
        read_study(tmp_path / "large.toml")
