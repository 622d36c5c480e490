"""An autopilot as MAVSDK sees PX4: MAVLink over UDP on 127.0.0.1, modes, telemetry, and what arrives.

The vehicle is at its setpoint at once. Offboard mode is lost after 0.5 s without setpoints, as in PX4.
"""

from __future__ import annotations

import math
import os
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

#: Main mode and sub mode of PX4.
MODES = {"MANUAL": (1, 0), "ALTCTL": (2, 0), "POSCTL": (3, 0), "OFFBOARD": (6, 0)}
MODES |= {"HOLD": (4, 3), "RTL": (4, 5), "LAND": (4, 6)}
OFFBOARD_LOSS_S = 0.5
TICK_S = 0.01
#: Below those that systems give by themselves; each is tried once.
PORTS = iter(range(18000 + os.getpid() % 8000, 32000))
#: Messages that move the vehicle or change its mode.
SETPOINTS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET")
#: Messages per second.
RATES_HZ = {"heartbeat": 1.0, "attitude": 20.0, "local_position": 20.0, "global_position": 20.0}
RATES_HZ |= {"landed": 5.0, "status": 5.0, "battery": 5.0}


class Received(NamedTuple):
    """A message, when it came, and the mode at that time."""

    time: float
    message: Any
    mode: str

    def is_setpoint(self):
        """Whether it is a setpoint of any kind."""
        return self.message.get_type() in SETPOINTS

    def wanted_mode(self):
        """Mode that it commands, if any."""
        if self.message.get_type() == "SET_MODE":
            return "SET_MODE"
        if self.message.get_type() not in ("COMMAND_LONG", "COMMAND_INT"):
            return None
        if self.message.command != mavlink.MAV_CMD_DO_SET_MODE:
            return None
        pair = (int(self.message.param2), int(self.message.param3))
        return next(name for name, value in MODES.items() if value == pair)


def free_port():
    """A free port that the system gives to no other socket by itself."""
    for port in PORTS:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial, suppress(OSError):
            trial.bind(("127.0.0.1", port))
            return port
    raise OSError("no port is free")


@dataclass
class Autopilot:
    """The vehicle, its link, and what happens to it.

    Parameters
    ----------
    happens : callable
        Called with the autopilot at each tick and, before they take effect, with each message received.
    silent : set of str
        Telemetry that is not sent; "all" for a link that is lost in this direction.
    refuses, ignores : set of str
        Modes that are denied; modes whose commands have no effect and no answer.
    commanded, changed, told : list of (float, str)
        Modes with times: when commanded, when entered, and when first announced.
    """

    happens: Callable[[Autopilot, Received | None], None] = lambda _autopilot, _received: None
    mode: str = "HOLD"
    height: float = 5.5
    gust: float = 0.0
    climb: float = 0.0
    roll: float = 0.0
    east: float = 0.0
    batteries: dict[int, int] = field(default_factory=lambda: {0: 90})
    in_air: bool = True
    position_ok: bool = True
    silent: set[str] = field(default_factory=set)
    refuses: set[str] = field(default_factory=set)
    ignores: set[str] = field(default_factory=set)
    heartbeats_hz: float = 1.0
    received: list[Received] = field(default_factory=list)
    commanded: list[tuple[float, str]] = field(default_factory=list)
    changed: list[tuple[float, str]] = field(default_factory=list)
    told: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self):
        self.port = free_port()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(TICK_S)
        self._link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._link.robust_parsing = True
        self._started = time.monotonic()
        self._rates = RATES_HZ | {"heartbeat": self.heartbeats_hz}
        self._sent = dict.fromkeys(RATES_HZ, -math.inf)
        self._last_setpoint = -math.inf
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        self._socket.close()

    def setpoints(self):
        """Setpoints in order of arrival."""
        return [item for item in self.received if item.is_setpoint()]

    def flying_s(self):
        """Time since offboard mode was entered [s]; negative before."""
        entered = [when for when, mode in self.changed if mode == "OFFBOARD"]
        return time.monotonic() - entered[0] if entered else -1.0

    def change(self, mode, *, quiet=False):
        """Enter a mode, and announce it at once or, when quiet, with the next regular heartbeat."""
        if mode != self.mode:
            self.mode = mode
            self.changed.append((time.monotonic(), mode))
            if not quiet:
                self._tell("heartbeat")

    def _run(self):
        """Send and receive until the end."""
        while not self._over.is_set():
            now = time.monotonic()
            self.happens(self, None)
            for name, rate in self._rates.items():
                if now - self._sent[name] >= 1.0 / rate:
                    self._tell(name)
            if self.mode == "OFFBOARD" and now - self._last_setpoint > OFFBOARD_LOSS_S:
                self.change("HOLD")
            try:
                data = self._socket.recv(4096)
            except (TimeoutError, ConnectionRefusedError):
                continue
            for message in self._link.parse_buffer(data) or []:
                received = Received(time.monotonic(), message, self.mode)
                self.received.append(received)
                if wanted := received.wanted_mode():
                    self.commanded.append((received.time, wanted))
                self.happens(self, received)
                self._take(received)

    def _take(self, received):
        """Do what a message says."""
        message = received.message
        if received.is_setpoint():
            self._last_setpoint = received.time
            if self.mode == "OFFBOARD":
                self.height, self.climb = -20.0 - message.z, -message.vz
        elif message.get_type() == "COMMAND_LONG" and received.wanted_mode() not in self.ignores:
            wanted = received.wanted_mode()
            result = mavlink.MAV_RESULT_ACCEPTED
            late = received.time - self._last_setpoint > OFFBOARD_LOSS_S
            if wanted in self.refuses or (wanted == "OFFBOARD" and late):
                result = mavlink.MAV_RESULT_DENIED
            if wanted and result == mavlink.MAV_RESULT_ACCEPTED:
                self.change(wanted)
            self._send(mavlink.MAVLink_command_ack_message(message.command, result))

    def _tell(self, name):
        """Send one kind of telemetry."""
        self._sent[name] = time.monotonic()
        if name in self.silent or "all" in self.silent:
            return
        if name == "heartbeat" and (not self.told or self.told[-1][1] != self.mode):
            self.told.append((time.monotonic(), self.mode))
        for message in self._messages(name):
            self._send(message)

    def _messages(self, name):
        """Messages of one kind of telemetry."""
        since_ms, height = int((time.monotonic() - self._started) * 1000.0), self.height + self.gust
        if name == "heartbeat":
            (main, sub), kind = MODES[self.mode], (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4)
            flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            state = (flags, main << 16 | sub << 24, mavlink.MAV_STATE_ACTIVE, 3)
            yield mavlink.MAVLink_heartbeat_message(*kind, *state)
        elif name == "attitude":
            yield mavlink.MAVLink_attitude_message(since_ms, self.roll, 0.0, 0.5, 0.0, 0.0, 0.0)
        elif name == "local_position":
            place = (1.0, self.east, -20.0 - height)
            yield mavlink.MAVLink_local_position_ned_message(since_ms, *place, 0.0, 0.0, -self.climb)
        elif name == "global_position":
            place = (473977000, 85456000, 500000 + int(height * 1000.0), int(height * 1000.0))
            yield mavlink.MAVLink_global_position_int_message(since_ms, *place, 0, 0, 0, 0)
        elif name == "landed":
            states = mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_IN_AIR
            yield mavlink.MAVLink_extended_sys_state_message(0, states[self.in_air])
        elif name == "status":
            gyro, lowest = mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO, min(self.batteries.values())
            present = gyro | mavlink.MAV_SYS_STATUS_SENSOR_GPS
            sensors = (present, present, present if self.position_ok else gyro)
            yield mavlink.MAVLink_sys_status_message(*sensors, 0, 15000, 100, lowest, 0, 0, 0, 0, 0, 0)
        else:
            for number, percent in self.batteries.items():
                if f"battery {number}" not in self.silent:
                    cells = (2500, [15000] + [65535] * 9)
                    used = (100, 10, 10, percent)
                    yield mavlink.MAVLink_battery_status_message(number, 0, 0, *cells, *used)

    def _send(self, message):
        """Send a message to the ground side."""
        if "all" not in self.silent:
            self._socket.sendto(message.pack(self._link), ("127.0.0.1", self.port))
            self._link.seq = (self._link.seq + 1) % 256
