"""A small writer of ULog files: just enough to make every case that the reader must tell apart."""

import struct

import numpy as np

from logs.dataflash_writer import commands

_CODES = {"uint64_t": "Q", "uint32_t": "I", "int32_t": "i", "uint8_t": "B"}
_CODES |= {"float": "f", "double": "d", "bool": "?"}


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
    z, zeros, yes = -1.0 - 0.2 * np.sin(t), 0.0 * t, np.ones(n, dtype=bool)
    local = {"z": z, "vx": zeros, "vy": zeros, "vz": -0.2 * np.cos(t), "az": 0.2 * np.sin(t)}
    local |= dict.fromkeys(("z_valid__bool", "v_z_valid__bool", "v_xy_valid__bool"), yes)
    setpoint = {"position": np.stack([z, z, z], 1), "velocity": np.full((n, 3), 0.1)}
    setpoint["acceleration"] = np.full((n, 3), np.nan)
    return (
        UlogWriter()
        .parameter("MPC_THR_HOVER", 0.5)
        .parameter("SYS_AUTOSTART", 4001)
        .topic("vehicle_local_position", t, **local)
        .topic("vehicle_thrust_setpoint", t, xyz=np.stack([zeros, zeros, -0.5 - 0.1 * np.sin(t)], 1))
        .topic("trajectory_setpoint", t[::10], **{name: item[::10] for name, item in setpoint.items()})
        .topic("vehicle_land_detected", [0.0, 1.0], landed__bool=np.array([True, False]))
        .topic("vehicle_status", [0.0, 1.0], nav_state__uint8_t=np.array([2, 3]))
        .topic("vehicle_attitude", t, q=np.tile([1.0, 0, 0, 0], (n, 1)), padding=3)
        .sync()
    )


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


def px4_topics(flight, throttle=None):
    """Stamps and fields of PX4's topics, z down; a field is an array (n,) or (n, k)."""
    t, values, turn, squared, force = parts(flight)
    zeros, yes = 0.0 * t, np.ones(t.size, dtype=bool)

    def down(value):
        return np.stack([zeros, zeros, -value], 1)

    position = {"z": -values["position_z"], "vz": -values["velocity_z"]}
    position |= dict.fromkeys(("x", "y", "vx", "vy"), zeros)
    position |= dict.fromkeys(("xy_valid", "z_valid", "v_xy_valid", "v_z_valid"), yes)
    requested = {
        name: down(values[f"reference_{name}_z"]) for name in ("position", "velocity", "acceleration")
    }
    return {
        "vehicle_local_position": (t, position),
        "vehicle_attitude": (t, {"q": turn}),
        "vehicle_acceleration": (t, {"xyz": down(force)}),
        "vehicle_thrust_setpoint": (t, {"xyz": down(squared if throttle is None else throttle)}),
        "trajectory_setpoint": (t, requested),
        "vehicle_status": (t[:1], {"nav_state": np.array([3]), "vehicle_type": np.array([1])}),
        "vehicle_land_detected": (t[:1], {"landed": np.array([False])}),
    }


def ulog(flight, start_us=1_000_000, throttle=None):
    """Writer of a simulated flight; `throttle` in place of the squared rotor command."""
    writer = UlogWriter(start_us=start_us)
    kinds = {"b": "__bool", "i": "__uint8_t", "f": ""}
    for name, (t, fields) in px4_topics(flight, throttle).items():
        writer.topic(name, t, **{f"{key}{kinds[value.dtype.kind]}": value for key, value in fields.items()})
    return writer


#: Pulse widths of the motors' range [us].
LOW, HIGH = 1000.0, 1950.0


def flight_log(record, true=1.0, in_force=0.0, outputs="actuator_motors"):
    """Write a simulated flight as PX4 logs it: `true` is the curve of the motors, `in_force` THR_MDL_FAC.

    Firmware without `actuator_motors` logs pulse widths in `actuator_outputs` alone.
    """
    t, rotor = record.channels["position_z"].time_s, record.channels["rotor_command_1"]
    values = commands(rotor.values**2, true, in_force)
    writer = ulog(record, throttle=values["throttle"])
    writer.parameter("THR_MDL_FAC", in_force).parameter("MPC_THR_HOVER", 0.5)
    if outputs == "actuator_motors":
        return writer.topic(outputs, t, control=np.tile(values["throttle"][:, None], 4))
    for motor in range(1, 5):
        for name, value in (("MIN", int(LOW)), ("MAX", int(HIGH)), ("FUNC", 100 + motor)):
            writer.parameter(f"PWM_MAIN_{name}{motor}", value)
    widths = LOW + values["signal"] * (HIGH - LOW)
    return writer.topic(outputs, t, output=np.tile(widths[:, None], 4))
