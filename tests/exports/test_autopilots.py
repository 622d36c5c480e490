"""Parameters of autopilots: read back by strict parsers, refused where not told, harmless in any name."""

from __future__ import annotations

import copy
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eivor as ev
from exports.documents import refused, vehicle_file, written
from exports.identified import HOVER, TRUE, ardupilot_log, curve_told, identified, px4_log

Document = dict[str, Any]

HEADER = "# Vehicle-Id Component-Id Name Value Type"
HOSTILE = "a\n1\t1\tMPC_THR_HOVER\t0.9\t9\r\u2028b\x1b[2J\udcff.ulg"
FITTED = {"input": "actuator_output", "input_map": "fit"}


def qgc(text):
    """Parameters of a file of QGroundControl, which is refused for anything out of the ordinary."""
    assert text.isascii()
    assert text.endswith("\n")
    assert HEADER in text.split("\n")
    nuisances: dict[str, float] = {}
    for line in text[:-1].split("\n"):
        assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", line)
        if line.startswith("#"):
            assert "\t" not in line
            continue
        vehicle, component, name, value, kind = line.split("\t")
        assert (vehicle, component, kind) == ("1", "1", "9")
        assert re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", name)
        assert re.fullmatch(r"-?\d+\.\d+", value)
        assert name not in nuisances
        assert float(np.float32(value)) == pytest.approx(float(value), rel=1e-7)
        nuisances[name] = float(np.float32(value))
    return nuisances


def ardupilot(text):
    """Parameters of a file of ArduPilot."""
    assert text.isascii()
    rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", name) for name, _ in rows)
    return {name: float(value) for name, value in rows}


def exported(record, folder, to="px4"):
    return ev.load_fit(written(record, folder)).export(to)


def interval(text, name):
    (low, high) = re.findall(rf"# {name}: .* interval \[([^,]+), ([^\]]+)\]", text)[0]
    return float(low), float(high)


@pytest.fixture(scope="module")
def setpoint():
    """A result of PX4's thrust setpoint, with the map as it is."""
    reported = identified(px4_log(in_force=TRUE))
    return lambda: copy.deepcopy(reported)


@pytest.fixture(scope="module")
def motors():
    """A result of PX4's `actuator_motors` with a curve that was fitted; another one is in force."""
    reported = identified(px4_log(in_force=0.3), **FITTED)
    return lambda: copy.deepcopy(reported)


@pytest.fixture(scope="module")
def outputs():
    """A result of PX4's `actuator_outputs`, which are behind the curve."""
    reported = identified(px4_log(in_force=0.3, outputs="actuator_outputs"), **FITTED)
    return lambda: copy.deepcopy(reported)


@pytest.mark.parametrize(
    ("log", "choices", "side"),
    [
        (px4_log, FITTED, "before"),
        pytest.param(
            lambda: px4_log(outputs="actuator_outputs"), FITTED, "behind", marks=pytest.mark.thorough
        ),
        pytest.param(ardupilot_log, {"input_map": "fit"}, "before", marks=pytest.mark.thorough),
        pytest.param(ardupilot_log, FITTED, "behind", marks=pytest.mark.thorough),
        pytest.param(lambda: ardupilot_log(in_force=0.9), FITTED, "behind", marks=pytest.mark.thorough),
        pytest.param(
            lambda: px4_log(in_force=0.0), {"input_map": "fit"}, "before", marks=pytest.mark.thorough
        ),
    ],
)
def test_the_curve_of_the_motors_is_written_on_either_side(log, choices, side, tmp_path):
    content = log()
    of_px4 = content.startswith(b"ULog")
    curve, hover = ("THR_MDL_FAC", "MPC_THR_HOVER") if of_px4 else ("MOT_THST_EXPO", "MOT_THST_HOVER")
    reported = identified(content, **choices)
    assert reported["model"]["autopilot_curve"]["side"] == side
    text = exported(reported, tmp_path, "px4" if of_px4 else "ardupilot")
    result = qgc(text) if of_px4 else ardupilot(text)
    assert result == {curve: pytest.approx(TRUE, abs=0.03), hover: pytest.approx(HOVER, abs=0.005)}
    reported["model"]["autopilot_curve"]["logged"] = {hover: 0.5}
    assert f"# {hover}: 0.5 -> " in exported(reported, tmp_path, "px4" if of_px4 else "ardupilot")
    for name, truth in ((curve, TRUE), (hover, HOVER)):
        low, high = interval(text, name)
        assert low < truth < high
    assert f"would be set to {result[curve]:.2f} [" in curve_told(reported)


def test_the_key_figure_of_a_setpoint_is_the_curve_of_the_motors(setpoint):
    (figure,) = [item for item in setpoint()["figures"] if item["name"] == "THR_MDL_FAC"]
    low, high = figure["interval"]
    assert low < TRUE < high
    assert figure["words"] == "THR_MDL_FAC, which is 0.65"


@pytest.mark.parametrize("in_force", [1.0, pytest.param(0.65, marks=pytest.mark.thorough)])
def test_a_curve_is_not_applied_again_to_signals_behind_it(in_force, tmp_path):
    """Thrust that is the square of what `RCOU` holds is a share of one, whatever is in force."""
    reported = identified(ardupilot_log(in_force=in_force, true=1.0), **FITTED)
    assert reported["parameters"]["thrust_curve"]["value"] == pytest.approx(1.0, abs=0.02)
    curve = curve_told(reported)
    assert "MOT_THST_EXPO" in curve
    numbers = [
        float(item) for item in re.findall(r"would be set to (\S+) \[(\S+), (\S+)\]", curve) for item in item
    ]
    assert all(0.9 < number <= 1.0 for number in numbers)
    assert not re.search(r"1\.[1-9]", curve)
    result = ardupilot(exported(reported, tmp_path, "ardupilot"))
    assert result.get("MOT_THST_EXPO", 1.0) == pytest.approx(1.0, abs=0.02)


def test_a_value_in_force_that_is_too_large_is_said(tmp_path):
    reported = identified(px4_log(in_force=0.9), **FITTED)
    assert "THR_MDL_FAC 0.9, which is in force, is too large for this vehicle" in curve_told(reported)
    assert "THR_MDL_FAC" not in qgc(exported(reported, tmp_path))


@pytest.mark.parametrize(
    ("curve", "hover"),
    [
        ((-0.2, 0.03), None),
        ((1.2, 0.05), None),
        ((1.2, 0.15), None),
        (None, (0.95, 0.001)),
        (None, (0.05, 0.001)),
    ],
)
def test_what_px4_does_not_take_is_a_comment(curve, hover, outputs, tmp_path):
    """Of signals behind the curve, hover and curve are both left out."""
    reported = outputs()
    for quantity, given in (
        (reported["parameters"]["thrust_curve"], curve),
        (reported["derived"]["hover_input"], hover),
    ):
        if given is not None:
            value, std = given
            quantity |= {"value": value, "std_error": std, "interval": [value - 2 * std, value + 2 * std]}
    text = exported(reported, tmp_path)
    assert qgc(text) == {}
    assert text.count("is not written") == 2
    assert "that PX4 takes" in text
    assert all(f"{given[0]:g}" not in text for given in (curve, hover) if given)


def test_without_the_value_in_force_a_setpoint_tells_no_curve(motors, tmp_path):
    reported = motors()
    reported["model"]["autopilot_curve"]["in_force"] = {}
    text = exported(reported, tmp_path)
    assert list(qgc(text)) == ["MPC_THR_HOVER"]
    assert "is before the curve, and the result has no value of it that is in force" in text


@pytest.mark.parametrize("missing", ["key", "side"])
def test_a_result_that_does_not_know_the_side_is_read_and_says_so(missing, motors, tmp_path):
    reported = motors()
    if missing == "key":  # as older versions wrote it
        del reported["model"]["autopilot_curve"]
    else:
        reported["model"]["autopilot_curve"]["side"] = None
    text = exported(reported, tmp_path)
    assert qgc(text) == {}
    assert (
        text.count("does not say whether 'actuator_output' is before or behind the autopilot's thrust") == 2
    )
    assert "Identify the log again." in text
    assert "actuator" in exported(reported, tmp_path, "statespace")


@pytest.mark.parametrize(("to", "format_name"), [("px4", "ulog"), ("ardupilot", "dataflash")])
def test_no_name_of_a_log_becomes_a_parameter(to, format_name, setpoint, tmp_path):
    reported = refused(setpoint(), "viscous_friction", HOSTILE)
    reported["logs"][0] |= {"name": HOSTILE, "format": format_name}
    reported["provenance"]["logs"][0]["name"] = HOSTILE
    reported["model"]["autopilot_curve"]["in_force"] = {}
    reported["parameters"]["delay"]["reasons"] = [HOSTILE]
    text = exported(reported, tmp_path, to)
    read = qgc if to == "px4" else ardupilot
    assert list(read(text).values()) == [pytest.approx(HOVER, rel=0.01)]
    hostile = exported(refused(reported, "hover_input", HOSTILE), tmp_path, to)
    assert read(hostile) == {}


PAGE = Path(__file__).parents[2] / "docs" / "exports.md"
COMMANDS = re.findall(r"^\$ eivor (.*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)

#: Those of autopilots, which need the two logs alone.
OF_AUTOPILOTS = [
    item for item in COMMANDS if re.search(r"--json|--to (px4|ardupilot)", item) and "rigid" not in item
]


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_commands_run(tmp_path, monkeypatch, command_line):
    monkeypatch.chdir(tmp_path)
    Path("flight.ulg").write_bytes(px4_log())
    Path("flight.bin").write_bytes(ardupilot_log())
    vehicle_file(tmp_path).rename("mine.toml")
    assert len(COMMANDS) == 21
    for command in COMMANDS:
        assert command_line(*shlex.split(command)).code == 0, command
        written = re.findall(r"(?:-o|--json|--out|--residuals) (\S+)", command)[0]
        assert Path(written).stat().st_size > 100
    for item in (qgc(Path("vehicle.params").read_text()), ardupilot(Path("vehicle.param").read_text())):
        assert sorted(item.values()) == [pytest.approx(HOVER, abs=0.005), pytest.approx(TRUE, abs=0.03)]


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.parametrize(
    ("log", "stands", "written", "term"),
    [
        ("battery_brownout.ulg", "before", {"MPC_THR_HOVER"}, "THR_MDL_FAC"),
        ("log_123_2024-3-1-14-47-02.ulg", "before", {"MPC_THR_HOVER"}, "THR_MDL_FAC"),
        ("log_0036_mechanical_failure.bin", "behind", set(), "MOT_THST_EXPO"),
    ],
)
def test_real_flights(log, stands, written, term, recordings, tmp_path, monkeypatch, command_line):
    """None of these flights tells its curve: nothing beyond a range is written, and it is said why."""
    monkeypatch.chdir(tmp_path)
    (source,) = recordings.rglob(log)
    Path("flight").with_suffix(source.suffix).symlink_to(source)
    of_log = re.compile("ardupilot|bin" if source.suffix == ".bin" else "px4|ulg")
    for command in filter(of_log.search, OF_AUTOPILOTS):
        assert command_line(*shlex.split(command)).code in {0, 3}, command
    (file,) = tmp_path.glob("vehicle.param*")
    assert f"{term} is not written: " in file.read_text()
    assert f"Command: actuator_output, {stands} the autopilot's thrust curve" in file.read_text()
    assert set((ardupilot if source.suffix == ".bin" else qgc)(file.read_text())) == written


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_curve_that_is_refused_proposes_nothing(recordings):
    log = (recordings / "px4" / "battery_brownout.ulg").read_bytes()
    reported = identified(log, input="actuator_output", input_map="fit")
    curve = reported["parameters"]["thrust_curve"]
    assert curve["verdict"] == "refused"
    assert curve["interval"][0] < 0.0
    assert curve_told(reported) == ""
