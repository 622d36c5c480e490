"""A channel map names fields of a bag's topics."""

import numpy as np
import pytest
from bag_writer import EPOCH_S, blank, header, stores, write_ros2
from rosbags.rosbag2 import StoragePlugin

from eivor.errors import ChannelMapError, EmptyLogError
from eivor.logs.read import read_log

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


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
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
    folder = tmp_path_factory.mktemp("bag") / "rig"
    return write_ros2(folder, made, store, StoragePlugin.MCAP)


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


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('column = "stamp"', 'column = "t"', "the clock of a bag, 'stamp'.*received 't'"),
        ("/motors.", "/motor.", "a topic '/motor'.*'/motors'.*Did you mean '/motors'"),
        ("angular_velocities[1]", "angular_velocities[7]", r"Did you mean.*angular_velocities\[1\]"),
        (".point.z\" / 2'", ".header.frame_id\" / 2'", "column|field"),
        (".point.z\" / 2'", '.point.z" / "/motors.normalized"\'', "columns of one topic"),
    ],
)
def test_maps_that_do_not_fit(bag, tmp_path, old, new, words):
    assert old in MAP
    with pytest.raises(ChannelMapError, match=f"(?s){words}"):
        mapped(bag, tmp_path, MAP.replace(old, new))


def test_an_empty_bag_says_that_nothing_was_recorded(tmp_path):
    folder = write_ros2(tmp_path / "flight", [], stores()[1])
    with pytest.raises(EmptyLogError, match=r"with no messages\. Nothing was recorded"):
        read_log(folder)


def test_a_bag_without_stamps_says_so(tmp_path):
    _, store = stores()
    kind = "sensor_msgs/msg/Imu"
    folder = write_ros2(
        tmp_path / "flight", [("/imu", kind, 0.0, store.types[kind](**blank(store, kind)))], store
    )
    with pytest.raises(EmptyLogError, match=r"/imu without a stamp that can be, .*: 1\. Write a channel map"):
        read_log(folder)


def test_a_bag_of_nothing_that_is_known_names_its_topics(tmp_path):
    _, store = stores()
    kind = "geometry_msgs/msg/Vector3Stamped"
    types = store.types[kind](**(blank(store, kind) | {"header": header(store, 0.0)}))
    folder = write_ros2(tmp_path / "flight", [("/wind", kind, 0.0, types)], store)
    with pytest.raises(EmptyLogError, match=r"/wind \(geometry_msgs/Vector3Stamped\).*TOPIC.FIELD"):
        read_log(folder)
