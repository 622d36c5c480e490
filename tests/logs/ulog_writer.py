"""A small writer of ULog files: just enough to make every case that the reader must tell apart."""

import struct

import numpy as np

from logs.dataflash_writer import commands

_CODES = {
    "uint64_t": "Q",
    "float": "f",
    "bool": "?",
    "uint8_t": "B",
    "int32_t": "i",
    "uint32_t": "I",
    "double": "d",
}


def message(kind, payload):
    return struct.pack("<HB", len(payload), ord(kind)) + payload


class UlogWriter:
    def __init__(self, start_us=1_000_000, flags=True):
        self.start_us = start_us
        self.head = b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", start_us)
        self.definitions = message("B", bytes(40)) if flags else b""
        self.data = b""
        self.topics = {}

    def parameter(self, name, value):
        kind, code = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
        key = f"{kind} {name}".encode()
        self.definitions += message("P", bytes([len(key)]) + key + struct.pack(code, value))
        return self

    def topic(self, name, times_s, instance=0, padding=0, **fields):
        """Add a topic; a field's value is an array (n,) or (n, k), its type by a suffix: z__bool."""
        times_s = np.asarray(times_s, dtype=float)
        columns, texts, codes = [], ["uint64_t timestamp"], "<Q"
        for key, given in fields.items():
            field, _, kind = key.partition("__")
            kind = kind or "float"
            values = np.broadcast_to(given, times_s.shape) if np.ndim(given) == 0 else np.asarray(given)
            if values.ndim == 2:
                texts.append(f"{kind}[{values.shape[1]}] {field}")
                codes += _CODES[kind] * values.shape[1]
                columns += list(values.T)
            else:
                texts.append(f"{kind} {field}")
                codes += _CODES[kind]
                columns.append(values)
        if padding:
            texts.append(f"uint8_t[{padding}] _padding0")
        if name not in self.topics:
            self.topics[name] = True
            self.definitions += message("F", f"{name}:{';'.join(texts)};".encode())
        number = len(self.topics) * 16 + instance
        self.data += message("A", struct.pack("<BH", instance, number) + name.encode())
        stamps = [(self.start_us + round(time * 1e6)) % 2**64 for time in times_s.tolist()]
        rows = zip(stamps, *(values.tolist() for values in columns), strict=True)
        head, packed = struct.pack("<H", number), struct.Struct(codes).pack
        self.data += b"".join(message("D", head + packed(*row)) for row in rows)
        return self

    def dropout(self, milliseconds):
        self.data += message("O", struct.pack("<H", milliseconds))
        return self

    def sync(self):
        self.data += message("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12")
        return self

    def raw(self, blob):
        self.data += blob
        return self

    def bytes(self):
        return self.head + self.definitions + self.data


def flight(n=200):
    """A short flight in new topic names."""
    t = np.arange(n) * 0.02
    z = -1.0 - 0.2 * np.sin(t)
    entries = np.ones(n)
    return (
        UlogWriter()
        .parameter("MPC_THR_HOVER", 0.5)
        .parameter("SYS_AUTOSTART", 4001)
        .topic(
            "vehicle_local_position",
            t,
            z=z,
            vx=0 * t,
            vy=0 * t,
            vz=-0.2 * np.cos(t),
            az=0.2 * np.sin(t),
            z_valid__bool=entries > 0,
            v_z_valid__bool=entries > 0,
            v_xy_valid__bool=entries > 0,
        )
        .topic("vehicle_thrust_setpoint", t, xyz=np.stack([0 * t, 0 * t, -0.5 - 0.1 * np.sin(t)], 1))
        .topic(
            "trajectory_setpoint",
            t[::10],
            position=np.stack([z, z, z], 1)[::10],
            velocity=np.full((n, 3), 0.1)[::10],
            acceleration=np.full((n, 3), np.nan)[::10],
        )
        .topic("vehicle_land_detected", [0.0, 1.0], landed__bool=np.array([True, False]))
        .topic("vehicle_status", [0.0, 1.0], nav_state__uint8_t=np.array([2, 3]))
        .topic("vehicle_attitude", t, q=np.tile([1.0, 0, 0, 0], (n, 1)), padding=3)
        .sync()
    )


#: Pulse widths of the motors' range [us].
LOW, HIGH = 1000.0, 1950.0


def flight_log(record, true=1.0, in_force=0.0, outputs="actuator_motors"):
    """Write a simulated flight as PX4 logs it: `true` is the curve of the motors, `in_force` THR_MDL_FAC.

    Firmware without `actuator_motors` logs pulse widths in `actuator_outputs` alone.
    """
    values = {name: channel.values for name, channel in record.channels.items()}
    t = record.channels["position_z"].time_s
    values |= commands(values["rotor_command_1"] ** 2, true, in_force)
    nothing, entries = 0.0 * t, np.ones(t.size)
    roll = 0.5 * np.arccos(np.clip(values["cos_tilt"], -1.0, 1.0))
    force = -values["specific_force_z"] / values["cos_tilt"]
    requested = [-values[f"reference_{name}_z"] for name in ("position", "velocity", "acceleration")]
    setpoint = {
        name: np.stack([nothing, nothing, item], 1)
        for name, item in zip(("position", "velocity", "acceleration"), requested, strict=True)
    }
    local = {"z": -values["position_z"], "vx": nothing, "vy": nothing, "vz": -values["velocity_z"]}
    valid = {f"{name}_valid__bool": entries > 0.0 for name in ("z", "v_z", "v_xy")}
    writer = (
        UlogWriter()
        .parameter("THR_MDL_FAC", in_force)
        .parameter("MPC_THR_HOVER", 0.5)
        .topic("vehicle_local_position", t, **local, **valid)
        .topic("vehicle_acceleration", t, xyz=np.stack([nothing, nothing, force], 1))
        .topic("vehicle_attitude", t, q=np.stack([np.cos(roll), np.sin(roll), nothing, nothing], 1))
        .topic("vehicle_thrust_setpoint", t, xyz=np.stack([nothing, nothing, -values["throttle"]], 1))
        .topic("trajectory_setpoint", t, **setpoint)
        .topic("vehicle_land_detected", [0.0], landed__bool=np.array([False]))
        .topic("vehicle_status", [0.0], nav_state__uint8_t=np.array([3]))
    )
    if outputs == "actuator_motors":
        return writer.topic(outputs, t, control=np.tile(values["throttle"][:, None], 4))
    for motor in range(1, 5):
        for name, value in (("MIN", int(LOW)), ("MAX", int(HIGH)), ("FUNC", 100 + motor)):
            writer.parameter(f"PWM_MAIN_{name}{motor}", value)
    widths = LOW + values["signal"] * (HIGH - LOW)
    return writer.topic(outputs, t, output=np.tile(widths[:, None], 4))
