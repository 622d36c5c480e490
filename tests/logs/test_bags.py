"""One flight in every kind of bag: the same channels, the same numbers."""

from __future__ import annotations

import sqlite3

import bag_writer
import numpy as np
import pytest
from bag_writer import (
    EPOCH_S,
    blank,
    header,
    mavros_messages,
    px4_messages,
    stores,
    without_definitions,
    write_ros1,
    write_ros2,
)
from dataflash_writer import simulated, told
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from eivor import read_log
from eivor.errors import InputError


@pytest.fixture(scope="module")
def flight():
    return simulated(seed=3, duration=2.0)


@pytest.fixture(scope="module")
def ulog(flight, tmp_path_factory):
    path = tmp_path_factory.mktemp("ulog") / "flight.ulg"
    path.write_bytes(bag_writer.ulog(flight))
    return read_log(path)


def same(recording, expected, *, sign=1.0, but=()):
    """Whether every channel of a recording is that of another, with z turned where the sign says so."""
    for name in set(expected.channels) - set(but):
        channel, other = recording.channels[name], expected.channels[name]
        down = name.endswith("_z") and not name.startswith("attitude")
        np.testing.assert_allclose(channel.time_s, other.time_s, rtol=0, atol=1e-9, err_msg=name)
        turned = sign * other.values if down else other.values
        np.testing.assert_allclose(channel.values, turned, rtol=1e-12, atol=1e-12, err_msg=name)
        assert (channel.held, channel.estimated) == (other.held, other.estimated) or sign < 0, name
    return True


def thorough(*rest):
    """Parameters of cases beside which something quicker stands."""
    return [pytest.param(item, marks=pytest.mark.thorough) for item in rest]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "kind", ["sqlite", "chunks", *thorough("mcap", "messages", "files", "bare", "ros1", "split")]
)
def test_px4_topics_are_those_of_the_ulog(tmp_path, flight, store, ulog, kind):
    messages = list(px4_messages(store["ros1" if kind == "ros1" else "ros2"], flight))
    folder = tmp_path / "flight"
    if kind == "ros1":
        path = write_ros1(tmp_path / "flight.bag", messages, store["ros1"], Writer1.CompressionFormat.LZ4)
    elif kind in {"mcap", "bare", "chunks"}:
        mode = CompressionMode.STORAGE if kind == "chunks" else CompressionMode.NONE
        write_ros2(folder, messages, store["ros2"], StoragePlugin.MCAP, mode)
        path = folder / "flight.mcap" if kind == "bare" else folder
    elif kind == "split":
        folder.mkdir()
        for part, window in enumerate(((0.0, 0.7), (0.7, 1.2), (1.2, 9.0))):
            made = write_ros2(tmp_path / f"part{part}", messages, store["ros2"], window=window)
            (made / f"part{part}.db3").rename(folder / f"flight_{part + 9}.db3")
        path = folder
    else:
        mode = {"messages": CompressionMode.MESSAGE, "files": CompressionMode.FILE}.get(kind)
        path = write_ros2(folder, messages, store["ros2"], compression=mode or CompressionMode.NONE)
    r = read_log(path)
    assert same(r, ulog)
    assert (r.frame.name, r.vehicle, r.name) == ("NED", "rotary wing", path.name)
    assert r.format == {"ros1": "ros1", "bare": "mcap"}.get(kind, "ros2")
    assert len(r.sha256) == 64
    assert "their delay is not taken off" in told(r, "sensor_delay")


@pytest.mark.parametrize("release", ["1.15", *thorough("1.13", "1.14", "1.16")])
def test_without_definitions_the_release_is_told_by_the_lengths(tmp_path, flight, ulog, release):
    _, store = stores(release)
    known = px4_messages(store, flight, but=("vehicle_status",) if release == "1.13" else ())
    folder = without_definitions(write_ros2(tmp_path / "flight", known, store))
    r = read_log(folder)
    missing = set(ulog.channels) - set(r.channels)
    assert missing == (
        {"pilot_in_control", "input_open_loop", "pilot_sets_attitude"} if release == "1.13" else set()
    )
    assert same(r, ulog, but=missing)
    assert f"as those of PX4 {release}, whose lengths fit" in told(r, "px4_release")


def test_messages_of_no_known_release_are_left_out(tmp_path, flight, store, ulog):
    messages = list(px4_messages(store["ros2"], flight))
    folder = without_definitions(write_ros2(tmp_path / "flight", messages, store["ros2"]))
    database = sqlite3.connect(folder / "flight.db3")
    ((topic,),) = database.execute("SELECT id FROM topics WHERE name LIKE '%thrust_setpoint'").fetchall()
    longer = "UPDATE messages SET data = CAST(data || x'00000000' AS BLOB) WHERE topic_id = ?"
    database.execute(longer, (topic,))
    database.commit()
    database.close()
    r = read_log(folder)
    assert "input" not in r.channels
    assert same(r, ulog, but={"input"})
    assert "vehicle_thrust_setpoint (36 bytes)" in told(r, "px4_release")


@pytest.mark.thorough
def test_versions_and_instances_in_the_names_of_topics(tmp_path, flight, store, ulog):
    renamed = [
        (topic.replace("vehicle_status", "vehicle_status_v1"), *rest)
        for topic, *rest in px4_messages(store["ros2"], flight, "/drone/fmu/out/")
    ]
    r = read_log(write_ros2(tmp_path / "flight", renamed, store["ros2"], StoragePlugin.MCAP))
    assert same(r, ulog)
    other = [("/other/fmu/out/vehicle_attitude", *rest) for topic, *rest in renamed if "attitude" in topic]
    two = write_ros2(tmp_path / "two", [*renamed, *other], store["ros2"])
    with pytest.raises(InputError, match=r"a bag of one vehicle; received .* 2: /drone, /other"):
        read_log(two)


@pytest.mark.parametrize("kind", ["ros1", *thorough("sqlite", "mcap", "plain sqlite")])
def test_mavros_is_the_same_flight_with_z_up(tmp_path, flight, store, ulog, kind):
    if kind == "ros1":
        path = write_ros1(tmp_path / "flight.bag", mavros_messages(store["ros1"], flight), store["ros1"])
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        path = write_ros2(tmp_path / "flight", mavros_messages(store["ros2"], flight), store["ros2"], plugin)
    if kind == "plain sqlite":
        without_definitions(path)
    r = read_log(path)
    assert r.frame.name == "Z_UP"
    modes = {"landed", "pilot_in_control", "input_open_loop", "pilot_sets_attitude"}
    assert same(r, ulog, sign=-1.0, but=modes)
    assert {r.channels[name].values.tolist()[0] for name in modes} == {0.0}
    assert r.channels["velocity_z"].source == "/mavros/local_position/velocity_local.twist.linear.z"
    assert "feedback_reference_roll" in r.channels
    assert r.channels["input"].curve_side.value == "before"


def test_fields_that_a_setpoint_leaves_free_are_not_in_force(tmp_path, flight, store):
    made = []
    for topic, kind, time, message in mavros_messages(store["ros2"], flight):
        if kind.endswith("PositionTarget"):
            message.type_mask = 32 | (4 if time > 1.0 else 0)
        if kind.endswith("AttitudeTarget"):
            message.type_mask = 128 | (64 if time > 1.0 else 0)
        if kind.endswith("/State"):
            message.mode = "STABILIZED" if time >= 1.0 else "OFFBOARD"
        made.append((topic, kind, time, message))
    r = read_log(write_ros2(tmp_path / "flight", made, store["ros2"], StoragePlugin.MCAP))
    assert "reference_velocity_z" not in r.channels
    assert "feedback_reference_roll" not in r.channels
    for name in ("reference_position_z", "input"):
        channel = r.channels[name]
        np.testing.assert_array_equal(np.isnan(channel.values), channel.time_s > 1.0)
    assert r.channels["input_open_loop"].values.tolist() == [0.0] * 4 + [1.0] * 4


def odometry(store, *, in_world=False):
    """A vehicle that looks to the left of the world's x axis, and flies along it and up and down."""
    kinds = {name: f"{name}/msg/{kind}" for name, kind in (("nav_msgs", "Odometry"), ("sensor_msgs", "Imu"))}
    for time in np.arange(200) * 0.02:
        stamped = {"header": bag_writer.header(store, time)}
        kind = kinds["nav_msgs"]
        types = store.types[kind](**(bag_writer.blank(store, kind) | stamped))
        position, orientation, speed = (
            types.pose.pose.position,
            types.pose.pose.orientation,
            types.twist.twist.linear,
        )
        position.x, position.z = np.sin(time), 0.5 * np.sin(2 * time)
        orientation.w = orientation.z = np.sqrt(0.5)
        speed.z = np.cos(2 * time)
        speed.x, speed.y = (np.cos(time), 0.0) if in_world else (0.0, -np.cos(time))
        yield "/odom", kind, time, types
        kind = kinds["sensor_msgs"]
        stamped = {"header": bag_writer.header(store, time)}
        force = {"linear_acceleration": bag_writer.vector(store, 0.0, 0.0, 9.8 + 0.1 * np.sin(time))}
        imu = store.types[kind](**(bag_writer.blank(store, kind) | stamped | force))
        imu.orientation_covariance[0] = -1.0
        yield "/imu", kind, time, imu


@pytest.mark.parametrize("in_world", [False, *thorough(True)])
def test_plain_odometry_is_turned_into_the_world(tmp_path, store, in_world):
    messages = odometry(store["ros2"], in_world=in_world)
    r = read_log(write_ros2(tmp_path / "flight", messages, store["ros2"], StoragePlugin.MCAP))
    time = r.channels["velocity_x"].time_s
    np.testing.assert_allclose(r.channels["velocity_x"].values, np.cos(time), atol=1e-9)
    np.testing.assert_allclose(r.channels["velocity_y"].values, 0.0, atol=1e-9)
    np.testing.assert_allclose(r.channels["velocity_z"].values, np.cos(2 * time), atol=1e-9)
    np.testing.assert_allclose(r.channels["attitude_z"].values, np.sqrt(0.5))
    assert r.channels["attitude_w"].source.startswith("/odom")
    np.testing.assert_allclose(r.channels["specific_force_body_z"].values, 9.8 + 0.1 * np.sin(time))
    assert bool(told(r, "odometry_frame")) == in_world


@pytest.mark.thorough
def test_two_of_a_kind_are_not_guessed_between(tmp_path, store):
    messages = list(odometry(store["ros2"]))
    messages += [("/vio", *rest) for topic, *rest in messages if topic == "/odom"]
    r = read_log(write_ros2(tmp_path / "flight", messages, store["ros2"]))
    assert "velocity_z" not in r.channels
    assert "nav_msgs/Odometry, of which none says what it is of: /odom, /vio" in told(r, "several_topics")


def test_stamps_of_another_clock_are_left_out(tmp_path, store):
    messages = list(odometry(store["ros2"]))
    for topic, _, _, message in messages:
        if topic == "/imu":
            message.header.stamp.sec -= bag_writer.EPOCH_S
    r = read_log(write_ros2(tmp_path / "flight", messages, store["ros2"]))
    assert "/imu" in told(r, "clocks") or "/odom" in told(r, "clocks")
    assert r.span_s[1] < 5.0


MAP = """
name = "rig"
frame = "ned"
[time]
column = "stamp"
[channels.velocity_z]
column = "/vicon/drone/twist.twist.linear.z"
unit = "cm/s"
sign = -1
[channels.position_z]
expression = '-"/vicon/drone/pose.point.z" / 2'
delay_ms = 10
[channels.rotor_command_2]
column = "/motors.angular_velocities[1]"
[channels.battery_voltage]
column = "/power.voltage"
optional = true
"""


def rig(folder):
    _, store = stores()
    made = []
    kinds = {
        "/vicon/drone/twist": "geometry_msgs/msg/TwistStamped",
        "/vicon/drone/pose": "geometry_msgs/msg/PointStamped",
        "/motors": "mav_msgs/msg/Actuators",
    }
    for row, time in enumerate(np.arange(50) * 0.02):
        for topic, kind in kinds.items():
            types = store.types[kind](**(blank(store, kind) | {"header": header(store, time)}))
            if "twist" in topic:
                types.twist.linear.z = 100.0 * row
            elif "pose" in topic:
                types.point.z = 2.0 * row
                types.header.frame_id = "a" * (row % 3)
            else:
                types.angular_velocities = np.array([1.0, 2.0 + row, 3.0])
            made.append((topic, kind, time, types))
    return write_ros2(folder / "rig", made, store, StoragePlugin.MCAP)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return rig(tmp_path_factory.mktemp("bag"))


def mapped(bag, tmp_path, text):
    (tmp_path / "rig.toml").write_text(text)
    return read_log(bag, channel_map=tmp_path / "rig.toml")


def test_fields_by_their_topics(bag, tmp_path):
    r = mapped(bag, tmp_path, MAP)
    assert set(r.channels) == {"velocity_z", "position_z", "rotor_command_2"}
    assert r.frame.name == "NED"
    rows = np.arange(50.0)
    np.testing.assert_allclose(r.channels["velocity_z"].values, -rows)
    np.testing.assert_allclose(r.channels["position_z"].values, -rows)
    np.testing.assert_allclose(r.channels["rotor_command_2"].values, 2.0 + rows)
    np.testing.assert_allclose(r.channels["velocity_z"].time_s, 0.02 * rows, atol=1e-9)
    np.testing.assert_allclose(r.channels["position_z"].time_s, 0.02 * rows - 0.01, atol=1e-9)
    assert EPOCH_S > 1e9
