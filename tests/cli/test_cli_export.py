"""`eivor export` as it is called."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from exports.documents import document, refused, written
from exports.identified import TRUE, px4_log
from exports.test_autopilots import qgc

Caller = Callable[..., Any]


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_parameters_are_written(eivor: Caller, tmp_path: Path) -> None:
    log, fit, file = (tmp_path / name for name in ("flight.ulg", "fit.json", "vehicle.params"))
    log.write_bytes(px4_log())
    fitted = ("--input", "actuator_output", "--input-map", "fit")
    assert eivor("identify", log, *fitted, "--json", fit).code == 0
    assert eivor("export", fit, "--to", "px4", "-o", file).code == 0
    assert qgc(file.read_text())["THR_MDL_FAC"] == pytest.approx(TRUE, abs=0.03)
    assert eivor("export", fit, "--to", "px4").out == file.read_text()
    log.write_bytes(px4_log(in_force=TRUE))
    assert eivor("identify", log, "--json", fit).code == 0
    partly = eivor("export", fit, "--to", "px4")
    assert partly.code == 3
    assert list(qgc(partly.out)) == ["MPC_THR_HOVER"]
    assert "THR_MDL_FAC is not written" in partly.err


def test_what_is_not_identified_leaves_with_code_3(eivor: Caller, tmp_path: Path) -> None:
    fit, file = written(refused(document(), "viscous_friction"), tmp_path), tmp_path / "model.json"
    run = eivor("export", fit, "--to", "statespace", "-o", file)
    assert run.code == 3
    assert "--prior viscous_friction=VALUE:STD" in run.err
    assert not file.exists()
    given = eivor("export", fit, "--to", "statespace", "--prior", "viscous_friction=0.3:0.1", "-o", file)
    assert given.code == 0
    assert json.loads(file.read_text())["numbers"]["viscous_friction"]["source"] == "given"


def test_draws_are_a_table(eivor: Caller, tmp_path: Path) -> None:
    fit, file = written(document(), tmp_path), tmp_path / "draws.parquet"
    assert eivor("export", fit, "--draws", 50, "--mass", "1.53:0.02", "-o", file).code == 0
    table = pl.read_parquet(file)
    assert table.columns == ["viscous_friction", "input_gain", "actuator_lag", "delay", "mass"]
    assert table.height == 50
    assert table["mass"].std() == pytest.approx(0.02, rel=0.3)
    assert eivor("export", fit, "--draws", 50, "--delays", "all", "-o", file).code == 0
    assert set(pl.read_parquet(file).columns) == {"viscous_friction", "input_gain", "actuator_lag", "delay"}
    partly = written(refused(document(), "viscous_friction"), tmp_path)
    run = eivor("export", partly, "--draws", 50, "-o", file)
    assert run.code == 3
    assert "viscous_friction" in run.err
    assert pl.read_parquet(file)["input_gain"].to_list() == table["input_gain"].to_list()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--to TARGET, --draws N or both"),
        (["--to", "px4", "--draws", "5"], "draws for rotorpy, mujoco, isaaclab"),
        (["--to", "rotorpy", "--draws", "5", "--delays", "all"], "Simulators have no delay"),
        (["--to", "isaaclab"], "It takes draws: --draws 1000"),
        (["--draws", "5", "--vehicle", "crazyflie-2x", "-o", "d.parquet"], "no vehicle for draws of a table"),
        (["--to", "px"], "a target out of px4"),
        (["--draws", "5"], "-o draws.parquet"),
        (["--draws", "0", "-o", "d.parquet"], "0 draws"),
        (["--to", "statespace", "--prior", "delay"], "a prior NAME=VALUE:STD"),
        (["--to", "statespace", "--prior", "delay=x"], "VALUE or VALUE:STD"),
        (["--to", "px4", "--mass", "-1"], "a mass above zero"),
        (["--to", "px4", "-o", "fit.json"], "which would replace"),
    ],
)
def test_wrong_usage(
    arguments: list[str], message: str, eivor: Caller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = eivor("export", written(document(), tmp_path), *arguments)
    assert run.code == 2
    assert message in " ".join(run.err.split())


def test_a_file_that_is_no_result(eivor: Caller, tmp_path: Path) -> None:
    assert eivor("export", tmp_path / "none.json", "--to", "px4").code == 1
