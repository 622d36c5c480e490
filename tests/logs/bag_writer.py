"""One simulated flight as a ULog, as topics of px4_msgs and as topics of mavros, in every kind of bag.

Messages are written by rosbags, whose serialisers know nothing of this project's decoder.
"""

import sqlite3
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ulog_writer import UlogWriter

from eivor.logs.rosbag.messages import definitions

BOOT_US = 50_000_000
EPOCH_S = 1_700_000_000
HEADER = "std_msgs/Header header\n"


def floats(values):
    """What is left of numbers in 32 bits."""
    return np.asarray(values, dtype=np.float32).astype(float)


def parts(flight):
    """The quantities of a simulated flight, z up, on stamps of whole hundredths."""
    values = {name: floats(channel.values) for name, channel in flight.channels.items()}
    t = flight.channels["position_z"].time_s
    roll = np.arccos(np.clip(values["cos_tilt"], -1.0, 1.0))
    turn = floats(np.stack([np.cos(roll / 2), np.sin(roll / 2), 0 * t, 0 * t], 1))
    throttle = floats(values["rotor_command_1"] ** 2)
    return t, values, turn, throttle, floats(values["specific_force_z"] / values["cos_tilt"])


def px4_topics(flight):
    """Fields of PX4's topics, z down; of each topic its type, the stamps and arrays (n,) or (n, k)."""
    t, values, turn, throttle, force = parts(flight)
    zeros, yes = 0.0 * t, np.ones(t.size, dtype=bool)

    def down(value):
        return np.stack([zeros, zeros, -value], 1)

    position = {"z": -values["position_z"], "vz": -values["velocity_z"], "x": zeros, "y": zeros}
    position |= {"vx": zeros, "vy": zeros}
    position |= dict.fromkeys(("xy_valid", "z_valid", "v_xy_valid", "v_z_valid"), yes)
    requested = {
        name: down(values[f"reference_{name}_z"]) for name in ("position", "velocity", "acceleration")
    }
    return {
        "vehicle_local_position": ("VehicleLocalPosition", t, position),
        "vehicle_attitude": ("VehicleAttitude", t, {"q": turn}),
        "vehicle_acceleration": ("VehicleAcceleration", t, {"xyz": down(force)}),
        "vehicle_thrust_setpoint": ("VehicleThrustSetpoint", t, {"xyz": down(throttle)}),
        "trajectory_setpoint": ("TrajectorySetpoint", t, requested),
        "vehicle_status": (
            "VehicleStatus",
            t[:1],
            {"nav_state": np.array([3]), "vehicle_type": np.array([1])},
        ),
        "vehicle_land_detected": ("VehicleLandDetected", t[:1], {"landed": np.array([False])}),
    }


def ulog(flight):
    """The flight as a ULog."""
    writer = UlogWriter(start_us=BOOT_US)
    kinds = {"b": "__bool", "i": "__uint8_t", "f": ""}
    for name, (_, t, fields) in px4_topics(flight).items():
        named = {f"{key}{kinds[np.asarray(value).dtype.kind]}": value for key, value in fields.items()}
        writer.topic(name, t, **named)
    return writer.bytes()


def stores(release="1.15"):
    """Typestores of ROS 1 and of ROS 2, with the messages of mavros and of a release of PX4."""
    texts = {}
    for number, changed in definitions()["px4"].items():
        if float(number) <= float(release):
            texts |= {f"px4_msgs/{name}": text for name, text in changed.items()}
    texts |= {name: text for name, text in definitions()["types"].items() if name.startswith("mav")}
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
    for name, (kind, times, fields) in px4_topics(flight).items():
        if name in but:
            continue
        full = f"px4_msgs/msg/{kind}"
        plain = blank(store, full)
        for row, time in enumerate(times):
            selected = {key: _of(plain[key], np.asarray(value)[row]) for key, value in fields.items()}
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

    def made(kind, **fields):
        return kind, store.types[kind](**(blank(store, kind) | fields))

    twist = store.types["geometry_msgs/msg/Twist"]
    for row, time in enumerate(times):
        index = {"header": header(store, time)}
        zero = vector(store, 0, 0, 0)
        orientation = turned(store, *turn[row])
        up = vector(store, 0, 0, values["velocity_z"][row])
        position = vector(store, 0, 0, values["position_z"][row], "Point")
        pose = store.types["geometry_msgs/msg/Pose"](position=position, orientation=orientation)
        selected = (
            ("local_position/pose", *made("geometry_msgs/msg/PoseStamped", **index, pose=pose)),
            (
                "local_position/velocity_local",
                *made("geometry_msgs/msg/TwistStamped", **index, twist=twist(linear=up, angular=zero)),
            ),
            (
                "imu/data",
                *made(
                    "sensor_msgs/msg/Imu",
                    **index,
                    orientation=orientation,
                    linear_acceleration=vector(store, 0, 0, force[row]),
                ),
            ),
            (
                "setpoint_raw/target_attitude",
                *made(
                    "mavros_msgs/msg/AttitudeTarget", **index, thrust=throttle[row], orientation=orientation
                ),
            ),
            (
                "setpoint_raw/local",
                *made(
                    "mavros_msgs/msg/PositionTarget",
                    **index,
                    coordinate_frame=1,
                    position=vector(store, 0, 0, values["reference_position_z"][row], "Point"),
                    velocity=vector(store, 0, 0, values["reference_velocity_z"][row]),
                    acceleration_or_force=vector(store, 0, 0, values["reference_acceleration_z"][row]),
                ),
            ),
        )
        if row % 25 == 0:
            selected += (
                (
                    "state",
                    *made("mavros_msgs/msg/State", **index, mode="OFFBOARD" if row else "AUTO.TAKEOFF"),
                ),
                ("extended_state", *made("mavros_msgs/msg/ExtendedState", **index, landed_state=2)),
            )
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
    for statement in (
        "DROP TABLE message_definitions",
        "DROP TABLE schema",
        "DROP TABLE metadata",
        "ALTER TABLE topics DROP COLUMN type_description_hash",
    ):
        database.execute(statement)
    database.commit()
    database.close()
    return folder
