"""One simulated flight as a ULog, as topics of px4_msgs and as topics of mavros, in every kind of bag.

Messages are written by rosbags, whose serialisers know nothing of this project's decoder.
"""

import sqlite3
import tomllib
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
import ulog_writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ulog_writer import parts, px4_topics

BOOT_US = 50_000_000
EPOCH_S = 1_700_000_000
DEFINITIONS = tomllib.loads((files("eivor.logs.rosbag") / "definitions.toml").read_text(encoding="utf-8"))


def ulog(flight):
    """The flight as a ULog."""
    return ulog_writer.ulog(flight, BOOT_US).bytes()


@cache
def stores(release="1.15"):
    """Typestores of ROS 1 and of ROS 2, with the messages of mavros and of a release of PX4."""
    texts = {}
    for number, changed in DEFINITIONS["px4"].items():
        if float(number) <= float(release):
            texts |= {f"px4_msgs/{name}": text for name, text in changed.items()}
    texts |= {name: text for name, text in DEFINITIONS["types"].items() if name.startswith("mav")}
    results = []
    for store in (Stores.ROS1_NOETIC, Stores.ROS2_HUMBLE):
        typestore = get_typestore(store)
        types = {}
        for name, text in texts.items():
            package, _, kind = name.partition("/")
            types |= get_types_from_msg(text.replace("; ", "\n") + "\n", f"{package}/msg/{kind}")
        typestore.register(types)
        results.append(typestore)
    return results


def px4_messages(store, flight, prefix="/fmu/out/", but=()):
    """Topic, type, stamp [s] and message of everything in PX4's topics."""
    for name, (times, fields) in px4_topics(flight).items():
        if name in but:
            continue
        full = f"px4_msgs/msg/{name.title().replace('_', '')}"
        plain = blank(store, full)
        for row, time in enumerate(times):
            selected = {key: _of(plain[key], value[row]) for key, value in fields.items()}
            message = store.types[full](**(plain | selected | {"timestamp": BOOT_US + round(time * 1e6)}))
            yield f"{prefix}{name}", full, time, message


def _of(like, value):
    return value.astype(like.dtype) if isinstance(like, np.ndarray) else value.item()


def blank(store, kind):
    """A message of zeros, by field."""
    return {name: _zero(store, item) for name, item in store.fielddefs[kind][1]}


def _zero(store, described):
    node, content = described
    if node == 1:
        return "" if content[0] == "string" else 0
    if node == 2:
        return store.types[content](**blank(store, content))
    (inner, what), count = content
    if inner == 2:
        return [_zero(store, (inner, what)) for _ in range(count if node == 3 else 0)]
    kind = {"bool": "bool", "char": "uint8", "byte": "uint8"}.get(what[0], what[0])
    return np.zeros(count if node == 3 else 0, dtype=kind)


def vector(store, x, y, z, kind="Vector3"):
    return store.types[f"geometry_msgs/msg/{kind}"](x=float(x), y=float(y), z=float(z))


def turned(store, w, x, y, z):
    return store.types["geometry_msgs/msg/Quaternion"](w=float(w), x=float(x), y=float(y), z=float(z))


def header(store, time):
    ns = EPOCH_S * 10**9 + round(time * 1e9)
    fields = {"stamp": store.types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)}
    fields |= {"frame_id": "map", "seq": 0}
    kind = store.types["std_msgs/msg/Header"]
    return kind(**{name: fields[name] for name, _ in store.fielddefs["std_msgs/msg/Header"][1]})


def mavros_messages(store, flight, prefix="/mavros/"):
    """Topic, type, stamp [s] and message of a flight as mavros has it, z up."""
    times, values, turn, throttle, force = parts(flight)

    def made(name, kind, **fields):
        return name, kind, store.types[kind](**(blank(store, kind) | fields))

    twist, zero = store.types["geometry_msgs/msg/Twist"], vector(store, 0, 0, 0)
    for row, time in enumerate(times):
        index = {"header": header(store, time)}
        orientation = turned(store, *turn[row])
        up = {name: vector(store, 0, 0, item[row]) for name, item in values.items() if name.endswith("_z")}
        positions = (values[name][row] for name in ("position_z", "reference_position_z"))
        now, wanted = (vector(store, 0, 0, item, "Point") for item in positions)
        pose = store.types["geometry_msgs/msg/Pose"](position=now, orientation=orientation)
        moving = twist(linear=up["velocity_z"], angular=zero)
        inertial = {"orientation": orientation, "linear_acceleration": vector(store, 0, 0, force[row])}
        attitude = {"thrust": throttle[row], "orientation": orientation}
        target = {"coordinate_frame": 1, "position": wanted, "velocity": up["reference_velocity_z"]}
        target["acceleration_or_force"] = up["reference_acceleration_z"]
        selected = [
            made("local_position/pose", "geometry_msgs/msg/PoseStamped", **index, pose=pose),
            made("local_position/velocity_local", "geometry_msgs/msg/TwistStamped", **index, twist=moving),
            made("imu/data", "sensor_msgs/msg/Imu", **index, **inertial),
            made("setpoint_raw/target_attitude", "mavros_msgs/msg/AttitudeTarget", **index, **attitude),
            made("setpoint_raw/local", "mavros_msgs/msg/PositionTarget", **index, **target),
        ]
        if row % 25 == 0:
            mode = "OFFBOARD" if row else "AUTO.TAKEOFF"
            selected.append(made("state", "mavros_msgs/msg/State", **index, mode=mode))
            landed = made("extended_state", "mavros_msgs/msg/ExtendedState", **index, landed_state=2)
            selected.append(landed)
        for name, kind, message in selected:
            yield f"{prefix}{name}", kind, time, message


def record_ns(time, rng):
    """When a message is recorded: late by 10 to 100 ms, another each time."""
    return EPOCH_S * 10**9 + round(time * 1e9) + int(rng.integers(10_000_000, 100_000_000))


def write_ros1(path, messages, store, compression=None):
    rng, connections = np.random.default_rng(0), {}
    writer = Writer1(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        for topic, kind, time, message in sorted(messages, key=lambda item: item[2]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], record_ns(time, rng), store.serialize_ros1(message, kind))
    return path


def write_ros2(
    path, messages, store, plugin=StoragePlugin.SQLITE3, compression=CompressionMode.NONE, window=None
):
    path, rng, connections = Path(path), np.random.default_rng(0), {}
    writer = Writer2(path, version=9, storage_plugin=plugin)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        for topic, kind, time, message in messages:
            if window is not None and not window[0] <= time < window[1]:
                continue
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], record_ns(time, rng), store.serialize_cdr(message, kind))
    return path


def without_definitions(folder):
    """Make a bag what ROS 2 before Iron writes: no table of definitions, and no hashes of types."""
    (file,) = folder.glob("*.db3")
    database = sqlite3.connect(file)
    for table in ("message_definitions", "schema", "metadata"):
        database.execute(f"DROP TABLE {table}")
    database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    database.commit()
    database.close()
    return folder


def inertial(store, n=60):
    """Messages of an IMU."""
    kind = "sensor_msgs/msg/Imu"
    for row in range(n):
        selected = {"header": header(store, 0.01 * row)}
        selected["linear_acceleration"] = vector(store, 0.0, 0.1 * row, 9.8)
        yield "/imu", kind, 0.01 * row, store.types[kind](**(blank(store, kind) | selected))
