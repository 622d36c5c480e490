"""What tests of logs share: a file of some content, as it is read."""

from __future__ import annotations

import pytest
from bag_writer import inertial, stores, write_ros1, write_ros2
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode, StoragePlugin

import eivor as ev


@pytest.fixture
def read(tmp_path):
    """Reads bytes, a text, or what a writer has written, as a file of some name."""

    def read(content, name="flight.log", **options):
        content = content.bytes() if hasattr(content, "bytes") else content
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
        return ev.read_log(tmp_path / name, **options)

    return read


@pytest.fixture
def whole(monkeypatch):
    """Files are whole: no child need decode them first."""
    monkeypatch.setattr("eivor.logs.table.columnar.decode_in_child", lambda *_, **__: None)


@pytest.fixture(scope="module")
def store():
    return dict(zip(("ros1", "ros2"), stores(), strict=True))


@pytest.fixture(scope="module")
def sound(store, tmp_path_factory):
    """The bytes of a small bag of each kind."""
    folder = tmp_path_factory.mktemp("bags")
    lz4 = Writer1.CompressionFormat.LZ4
    ros1 = write_ros1(folder / "one.bag", inertial(store["ros1"]), store["ros1"], lz4)
    plain = write_ros2(folder / "two", inertial(store["ros2"]), store["ros2"])
    mcap = write_ros2(
        folder / "three", inertial(store["ros2"]), store["ros2"], StoragePlugin.MCAP, CompressionMode.STORAGE
    )
    return {
        "bag": ros1.read_bytes(),
        "db3": (plain / "two.db3").read_bytes(),
        "mcap": (mcap / "three.mcap").read_bytes(),
    }
