"""Write Crazyflie microSD logs byte by byte, sound ones and others."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np


@dataclass
class UsdLog:
    """A log that grows: types of events first, then records."""

    version: int = 2
    types: list[tuple[int, str, tuple[str, ...]]] = field(default_factory=list)
    body: bytearray = field(default_factory=bytearray)

    def add_type(self, number, name, *variables):
        """Announce a type; a variable is written as "acc.x(f)"."""
        self.types.append((number, name, variables))

    def add_record(self, number, stamp, *values):
        """Append a record; the stamp in ms (version 1) or us."""
        variables = next(announced for known, _, announced in self.types if known == number)
        letters = "".join(variable[-2] for variable in variables)
        self.body += struct.pack("<H" + ("I" if self.version == 1 else "Q"), number, stamp)
        self.body += struct.pack("<" + letters, *values)

    def head(self):
        """The head."""
        out = b"\xbc" + struct.pack("<HH", self.version, len(self.types))
        for number, name, variables in self.types:
            out += struct.pack("<H", number) + name.encode() + b"\x00" + struct.pack("<H", len(variables))
            out += b"".join(variable.encode() + b"\x00" for variable in variables)
        return out

    def bytes(self):
        """The file, with its checksum."""
        return with_checksum(self.head() + bytes(self.body))


def with_checksum(content):
    """Content and its CRC-32."""
    return content + struct.pack("<I", zlib.crc32(content))


def fixed(version, variables, rows, start=1000):
    """Log of one type of events, with a row each 10 ms."""
    log = UsdLog(version)
    log.add_type(0xFFFF, "fixedFrequency", *variables)
    step = 10 if version == 1 else 10_000
    for number, row in enumerate(rows):
        log.add_record(0xFFFF, start + number * step, *row)
    return log


def flight(version=2, count=200):
    """A flight of three types of events that alternate irregularly."""
    log = UsdLog(version)
    motors = [f"motor.m{rotor}(I)" for rotor in range(1, 5)]
    log.add_type(0xFFFF, "fixedFrequency", "acc.z(f)", "gyro.y(f)", *motors, "stateEstimate.vz(f)")
    log.add_type(0, "estBarometer", "pm.vbat(f)")
    log.add_type(1, "poll", "ctrltargetZ.z(h)", "stateEstimateZ.quat(I)")
    tick = 1000 if version == 1 else 1_000_000
    for row in range(count):
        t = 0.01 * row
        stamp = round((3.0 + t) * tick)
        power = int(40000 + 2000 * np.sin(t))
        log.add_record(0xFFFF, stamp, 1.0 + 0.1 * np.sin(t), 90.0, power, power, power, 65535, np.sin(t))
        if row % 7 == 0:
            log.add_record(0, stamp + tick // 500, 4.0)
        if row % 5 == 2:
            log.add_record(1, stamp + tick // 250, 500 + row % 9, 3 << 30)
    return log
