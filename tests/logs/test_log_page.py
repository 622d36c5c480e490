"""The page of logs holds what the code holds, and what it recommends can be read."""

from __future__ import annotations

import re
import runpy
import shlex
import tomllib
from pathlib import Path

import bag_writer
import numpy as np
import polars as pl
import pytest
from dataflash_writer import simulated

import eivor as ev
from eivor.cli.main import app
from validation.pages import page_with

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "logs.md").read_text(encoding="utf-8")


def test_tables_are_fresh():
    parts = runpy.run_path(str(DOCS / "log_tables.py"))["parts"]()
    assert page_with(PAGE, parts) == PAGE, "run python -m docs.log_tables"
    assert "| `velocity_z` | `vehicle_local_position.vz` |" in PAGE
    assert "| `km/h` | 0.277778 m/s |" in PAGE
    assert " to`" not in PAGE


@pytest.mark.parametrize(
    ("column", "logged", "rule", "meant"),
    [
        ("pwm_1", 1250.0, 'expression = "(pwm_1 - 1000) / 1000"', 0.25),
        ("erpm_1", 7000.0, 'expression = "erpm_1 / 7"\nunit = "rpm"', 1000.0 * np.pi / 30.0),
        ("vz[m/s]", 3.0, 'column = "vz[m/s]"', 3.0),
        ("vz[m/s]", 3.0, """expression = '"vz[m/s]" * 2'""", 6.0),
    ],
)
def test_recipes_of_channel_maps(tmp_path, column, logged, rule, meant):
    assert all(f"`{line}`" in PAGE for line in rule.splitlines())
    pl.DataFrame({"t": [0.0, 1.0], column: [logged, logged]}).write_csv(tmp_path / "t.csv")
    channel = "rotor_speed_1" if "rpm" in column else "input" if "pwm" in column else "velocity_z"
    text = (
        f'name = "m"\n[time]\ncolumn = "t"\n[columns."{column}"]\nvalid = [0, 65535]\n[channels.{channel}]\n'
    )
    (tmp_path / "m.toml").write_text(text + rule)
    r = ev.read_log(tmp_path / "t.csv", channel_map=tmp_path / "m.toml")
    np.testing.assert_allclose(r.channels[channel].values, meant)


COMMANDS_PAGE = (Path(__file__).parents[2] / "docs" / "logs.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\$ (.*)$", COMMANDS_PAGE, re.MULTILINE)
BLOCKS = re.findall(r"^```(toml|python)\n(.*?)^```", COMMANDS_PAGE, re.MULTILINE | re.DOTALL)


def table(flight):
    """A table with the columns of the page's map."""
    values = {name: channel.values for name, channel in flight.channels.items()}
    time = flight.channels["position_z"].time_s
    half = 0.5 * np.arccos(np.clip(values["cos_tilt"], -1.0, 1.0))
    columns = {"t_us": np.round(1e6 * time), "vz": 100.0 * values["velocity_z"], "battery": 4.2 + 0.0 * time}
    columns["motor_1"] = 65535.0 * values["rotor_command_1"]
    zeros = dict.fromkeys(("qy", "qz"), 0.0 * time)
    return pl.DataFrame(columns | {"qw": np.cos(half), "qx": np.sin(half)} | zeros)


def messages(store, flight):
    """Topics of the page's map of a bag."""
    times, values, turn, throttle, _ = bag_writer.parts(flight)
    kinds = {
        "/vicon/drone/odom": "nav_msgs/msg/Odometry",
        "/planner/pose": "geometry_msgs/msg/PoseStamped",
        "/motors": "mav_msgs/msg/Actuators",
    }
    for row, time in enumerate(times):
        for topic, kind in kinds.items():
            stamped = {"header": bag_writer.header(store, time)}
            types = store.types[kind](**(bag_writer.blank(store, kind) | stamped))
            if "odom" in topic:
                types.pose.pose.orientation.w, types.pose.pose.orientation.x = turn[row, :2]
                types.twist.twist.linear.z = values["velocity_z"][row]
            elif "planner" in topic:
                types.pose.position.z = values["reference_position_z"][row]
            else:
                types.angular_velocities = np.array([throttle[row]])
            yield topic, kind, time, types


@pytest.fixture
def files(tmp_path, monkeypatch):
    """The files that the page names."""
    monkeypatch.chdir(tmp_path)
    flight = simulated(seed=3, duration=4.0)
    Path("flight.ulg").write_bytes(bag_writer.ulog(flight))
    table(flight).write_csv("flight.csv")
    for kind, text in BLOCKS:
        if kind == "toml":
            Path(f"{tomllib.loads(text)['name']}.toml").write_text(text)
    _, store = bag_writer.stores()
    bag_writer.write_ros2("bag", messages(store, flight), store)
    return flight


@pytest.mark.thorough
@pytest.mark.usefixtures("files")
def test_commands_run(capsys):
    assert len(COMMANDS) == 3
    for command in COMMANDS:
        with pytest.raises(SystemExit) as left:
            app(shlex.split(command)[1:], prog_name="eivor")
        assert left.value.code == 0, command
        assert "velocity_z" in capsys.readouterr().out


@pytest.mark.thorough
def test_python_runs(files):
    values = {name: channel.values for name, channel in files.channels.items()}
    names = {"t": files.channels["position_z"].time_s, "v": values["velocity_z"]}
    names |= {"u": values["rotor_command_1"], "r": values["reference_position_z"]}
    for kind, text in BLOCKS:
        if kind == "python":
            exec(compile(text, "logs.md", "exec"), names)  # noqa: S102 - the project's own page
    assert set(names["log"].channels) == {"velocity_z", "input", "reference_position_z"}
