"""The commands of the page on exports do what it says, on logs of autopilots."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from eivor.cli.main import app
from exports.identified import HOVER, TRUE, ardupilot_log, curve_told, identified, px4_log
from exports.simulated import vehicle_file
from exports.test_autopilots import ardupilot, qgc

PAGE = Path(__file__).parents[2] / "docs" / "exports.md"
COMMANDS = re.findall(r"^\$ eivor (.*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
#: Those of autopilots, which need the two logs alone.
OF_AUTOPILOTS = [
    item for item in COMMANDS if re.search(r"--json|--to (px4|ardupilot)", item) and "rigid" not in item
]


def called(command: str) -> int:
    with pytest.raises(SystemExit) as left:
        app(shlex.split(command), prog_name="eivor")
    return int(left.value.code or 0)


def written_to(command: str) -> Path:
    """The file that a command writes; the last word of each is one."""
    return Path(re.findall(r"(?:-o|--json|--out) (\S+)", command)[0])


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_what_a_simulated_flight_of_each_autopilot_tells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("flight.ulg").write_bytes(px4_log())
    Path("flight.bin").write_bytes(ardupilot_log())
    assert len(OF_AUTOPILOTS) == 5
    for command in OF_AUTOPILOTS:
        assert called(command) == 0, command
    for item in (qgc(Path("vehicle.params").read_text()), ardupilot(Path("vehicle.param").read_text())):
        assert sorted(item.values()) == [pytest.approx(HOVER, abs=0.005), pytest.approx(TRUE, abs=0.03)]


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("flight.ulg").write_bytes(px4_log())
    Path("flight.bin").write_bytes(ardupilot_log())
    vehicle_file(tmp_path).rename("mine.toml")
    assert len(COMMANDS) == 19
    for command in COMMANDS:
        assert called(command) == 0, command
        assert written_to(command).stat().st_size > 100


@pytest.mark.recordings
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.parametrize("log", ["battery_brownout", "log_123_2024-3-1-14-47-02"])
def test_real_flights(log: str, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """None of these flights tells its curve: nothing beyond a range is written, and it is said why."""
    monkeypatch.chdir(tmp_path)
    (ulog,) = recordings.rglob(f"{log}.ulg")
    (dataflash,) = recordings.rglob("*.bin")
    Path("flight.ulg").symlink_to(ulog)
    Path("flight.bin").symlink_to(dataflash)
    for command in OF_AUTOPILOTS:
        assert called(command) in {0, 3}, command
    px4, of_ardupilot = Path("vehicle.params").read_text(), Path("vehicle.param").read_text()
    assert "THR_MDL_FAC is not written: " in px4
    assert "Command: actuator_output, before the autopilot's thrust curve" in px4
    assert list(qgc(px4)) == (["MPC_THR_HOVER"] if log == "battery_brownout" else [])
    assert "MOT_THST_EXPO is not written: " in of_ardupilot
    assert "Command: actuator_output, behind the autopilot's thrust curve" in of_ardupilot
    assert ardupilot(of_ardupilot) == {}


@pytest.mark.recordings
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_real_flight_whose_curve_is_below_the_range(recordings: Path) -> None:
    log = (recordings / "px4" / "battery_brownout.ulg").read_bytes()
    reported = identified(log, input="actuator_output", input_map="fit")
    assert reported["parameters"]["thrust_curve"]["value"] < 0.0
    assert curve_told(reported).startswith(
        "No THR_MDL_FAC is proposed: what was found lies below the range of 0 to 1"
    )
    assert not re.search(r"-\d", curve_told(reported))
