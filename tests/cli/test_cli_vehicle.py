"""`eivor vehicle` as a user meets it."""

from __future__ import annotations

import pytest

from eivor.motions.rigid_body.vehicle import load_vehicle, shipped_vehicles, vehicle_template


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_new_writes_a_file_that_show_accepts(eivor, tmp_path):
    run = eivor("vehicle", "new", "mine.toml")
    assert (run.code, run.out, run.err) == (0, "mine.toml: fill in what you know\n", "")
    assert load_vehicle(tmp_path / "mine.toml").name == "My quadrotor"
    run = eivor("vehicle", "show", "mine.toml")
    assert (run.code, run.out, run.err) == (0, vehicle_template(), "")


def test_new_prints_where_there_is_no_file(eivor):
    assert eivor("vehicle", "new").out == vehicle_template()


def test_new_takes_nobodys_file(eivor, tmp_path):
    (tmp_path / "mine.toml").write_text("name = 'kept'", encoding="utf-8")
    run = eivor("vehicle", "new", "mine.toml")
    assert run.code == 2
    assert "which would be lost" in run.err
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == "name = 'kept'"


@pytest.mark.parametrize(
    ("file", "code", "told"),
    [("mine.txt", 2, "ends in .toml"), ("none/mine.toml", 1, "does not exist"), (".", 2, "the folder")],
)
def test_new_needs_a_place(eivor, file, code, told):
    run = eivor("vehicle", "new", file)
    assert run.code == code
    assert told in run.err


def test_list_names_what_show_shows(eivor):
    listed = eivor("vehicle", "list").out
    for name in shipped_vehicles():
        assert name in listed
        run = eivor("vehicle", "show", name)
        assert run.code == 0
        assert "[rotors]" in run.out


def test_show_tells_what_is_wrong(eivor, tmp_path):
    (tmp_path / "mine.toml").write_text("mas = 1\n[rotors]\nlayout = 'quad-x'\nnumbering = 'px4'", "utf-8")
    run = eivor("vehicle", "show", "mine.toml")
    assert (run.code, run.out) == (1, "")
    assert "Did you mean 'mass'" in run.err
    run = eivor("vehicle", "show", "hexacopter")
    assert run.code == 1
    assert "crazyflie-2x" in run.err
