"""The commands and the Python of the page on logs run as they stand."""

from __future__ import annotations

import io
import re
import shlex
import sys
from pathlib import Path

import bag_writer
import numpy as np
import polars as pl
import pytest
from dataflash_writer import simulated

from eivor.cli.main import app
from eivor.logs.channel_map import parse_channel_map

PAGE = (Path(__file__).parents[2] / "docs" / "logs.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\$ (.*)$", PAGE, re.MULTILINE)
BLOCKS = re.findall(r"^```(toml|python)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


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
            Path(f"{parse_channel_map(text, 'page').name}.toml").write_text(text)
    _, store = bag_writer.stores()
    bag_writer.write_ros2("bag", messages(store, flight), store)
    return flight


@pytest.mark.thorough
@pytest.mark.usefixtures("files")
def test_commands_run(monkeypatch, capsys):
    assert len(COMMANDS) == 4
    for command in COMMANDS:
        piped, _, current = command.rpartition(" | ")
        if piped:
            monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(Path("flight.csv").read_bytes())))
        with pytest.raises(SystemExit) as left:
            app(shlex.split(current)[1:], prog_name="eivor")
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
