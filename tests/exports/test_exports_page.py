"""The commands of the page on exports do what it says."""

from __future__ import annotations

import re
import shlex
from dataclasses import asdict
from pathlib import Path

import pytest

from eivor.cli.main import app
from eivor.motions.rigid_body.vehicle_file import load_vehicle
from exports.documents import document, of_motors, of_rigid_body, written
from exports.simulated import vehicle_file

PAGE = Path(__file__).parents[2] / "docs" / "exports.md"
COMMANDS = re.findall(r"^\$ eivor (export .*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.thorough
def test_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    told = of_motors(document())
    told["logs"][0]["format"] = "dataflash"
    written(told, tmp_path).rename("ardupilot.json")
    written(document(), tmp_path).rename("px4.json")
    vehicle = vehicle_file(tmp_path).rename("mine.toml")
    written(of_rigid_body(asdict(load_vehicle(vehicle))), tmp_path).rename("rigid.json")
    written(of_motors(document()), tmp_path)
    assert len(COMMANDS) == 14
    for command in COMMANDS:
        with pytest.raises(SystemExit) as left:
            app(shlex.split(command), prog_name="eivor")
        assert left.value.code == 0, command
        assert Path(shlex.split(command)[-1]).stat().st_size > 100
