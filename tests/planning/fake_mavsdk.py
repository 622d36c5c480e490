"""A simulated system behind MAVSDK's names: what the program of a plan imports, awaits and streams.

Its clock jumps from one thing that is due to the next, and the vehicle is at its setpoint at once.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from enum import Enum
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any


class FlightMode(Enum):
    """MAVSDK's, those that are used."""

    HOLD = 1
    POSCTL = 2
    OFFBOARD = 3
    MANUAL = 4
    UNKNOWN = 5


class OffboardError(Exception):
    """MAVSDK's."""


@dataclass
class Vehicle:
    """The vehicle, its link, and what happens to it on the way.

    Parameters
    ----------
    height : float
        Above take-off [m].
    happens : callable
        Called with the vehicle before each setpoint takes effect, and the setpoint's number.
    """

    height: float = 5.5
    mode: FlightMode = FlightMode.HOLD
    battery: float = 90.0
    in_air: bool = True
    position_ok: bool = True
    connected: bool = True
    silent: bool = False
    refuses_hold: int = 0
    refuses_offboard: bool = False
    climb: float = 0.0
    roll_deg: float = 0.0
    east: float = 0.0
    happens: Callable[[Vehicle, int], None] = lambda _vehicle, _number: None
    heights: list[float] = field(default_factory=list)
    calls: list[str] = field(default_factory=list)

    async def send(self, position: Any, velocity: Any, _acceleration: Any) -> None:
        """Take a setpoint; down is -20 m at take-off height zero."""
        self.heights.append(-20.0 - position.down_m)
        self.height, self.climb = self.heights[-1], -velocity.down_m_s
        if self.mode is FlightMode.OFFBOARD:
            self.happens(self, len(self.heights))

    async def start(self) -> None:
        """Enter offboard mode, unless refused."""
        self.calls.append("offboard")
        if self.refuses_offboard:
            raise OffboardError("denied")
        self.mode = FlightMode.OFFBOARD

    async def hold(self) -> None:
        """Enter hold, unless refused."""
        self.calls.append("hold")
        if self.refuses_hold:
            self.refuses_hold -= 1
            raise RuntimeError("denied")
        self.mode = FlightMode.HOLD

    async def stream(self, value: Callable[[], Any]) -> AsyncIterator[Any]:
        """Telemetry, until the link is silent."""
        while not self.silent:
            yield value()
            await asyncio.sleep(0.02)
        await asyncio.sleep(1e6)

    def telemetry(self) -> SimpleNamespace:
        """Streams by MAVSDK's names."""

        def odometry() -> SimpleNamespace:
            return SimpleNamespace(
                position=SimpleNamespace(north_m=1.0, east_m=self.east, down_m=-20.0 - self.height),
                velocity=SimpleNamespace(north_m_s=0.0, east_m_s=0.0, down_m_s=-self.climb),
            )

        values: dict[str, Callable[[], Any]] = {
            "position": lambda: SimpleNamespace(relative_altitude_m=self.height),
            "position_velocity_ned": odometry,
            "attitude_euler": lambda: SimpleNamespace(roll_deg=self.roll_deg, pitch_deg=0.0, yaw_deg=30.0),
            "flight_mode": lambda: self.mode,
            "battery": lambda: SimpleNamespace(remaining_percent=self.battery),
            "in_air": lambda: self.in_air,
            "health": lambda: SimpleNamespace(is_local_position_ok=self.position_ok),
        }
        return SimpleNamespace(**{name: (lambda v=value: self.stream(v)) for name, value in values.items()})

    def system(self) -> SimpleNamespace:
        """MAVSDK's System."""

        async def connect(system_address: str) -> None:
            self.calls.append(f"connect {system_address}")

        async def connection_state() -> AsyncIterator[SimpleNamespace]:
            while True:
                yield SimpleNamespace(is_connected=self.connected)
                await asyncio.sleep(0.02)

        return SimpleNamespace(
            connect=connect,
            core=SimpleNamespace(connection_state=connection_state),
            telemetry=self.telemetry(),
            offboard=SimpleNamespace(set_position_velocity_acceleration_ned=self.send, start=self.start),
            action=SimpleNamespace(hold=self.hold),
        )


class QuickLoop(asyncio.SelectorEventLoop):
    """An event loop whose clock jumps to the next thing that is due: nothing waits, and nothing is late."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def time(self) -> float:
        """Seconds since the loop was made."""
        return self.now

    def _run_once(self) -> None:
        if not self._ready and self._scheduled:
            self.now = max(self.now, self._scheduled[0].when())
        super()._run_once()


def fly(text: str, vehicle: Vehicle, monkeypatch: Any, folder: Path, *, begin: bool) -> int:
    """Exit code of the program, with the vehicle behind MAVSDK's names and a clock that jumps."""

    def record(*names: str) -> type:
        def build(self: Any, *values: float) -> None:
            self.__dict__.update(zip(names, values, strict=True))

        return type("Record", (), {"__init__": build})

    modules = {
        "mavsdk": {"System": vehicle.system},
        "mavsdk.offboard": {
            "OffboardError": OffboardError,
            "PositionNedYaw": record("north_m", "east_m", "down_m", "yaw_deg"),
            "VelocityNedYaw": record("north_m_s", "east_m_s", "down_m_s", "yaw_deg"),
            "AccelerationNed": record("north_m_s2", "east_m_s2", "down_m_s2"),
        },
        "mavsdk.telemetry": {"FlightMode": FlightMode},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    program = written_module(text, folder)
    with asyncio.Runner(loop_factory=QuickLoop) as runner:
        program.time = SimpleNamespace(monotonic=runner.get_loop().time)
        return runner.run(program.fly("udpin://0.0.0.0:14540", begin))


def written_module(text: str, folder: Path) -> Any:
    """The text as a module, from a file."""
    path = folder / "written.py"
    path.write_text(text, encoding="utf-8")
    spec = spec_from_file_location("written", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
