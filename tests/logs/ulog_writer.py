"""A small writer of ULog files: just enough to make every case that the reader must tell apart."""

import struct

import numpy as np

_CODES = {
    "uint64_t": "Q",
    "float": "f",
    "bool": "?",
    "uint8_t": "B",
    "int32_t": "i",
    "uint32_t": "I",
    "double": "d",
}


def message(kind: str, payload: bytes) -> bytes:
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
        for row, time in enumerate(times_s):
            stamp = (self.start_us + round(time * 1e6)) % 2**64
            row_values = [v[row].item() for v in columns]
            self.data += message("D", struct.pack("<H", number) + struct.pack(codes, stamp, *row_values))
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
    ones = np.ones(n)
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
            z_valid__bool=ones > 0,
            v_z_valid__bool=ones > 0,
            v_xy_valid__bool=ones > 0,
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
