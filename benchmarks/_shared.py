"""What the benchmarks share: the machine, times of whole processes, logs to read."""

from __future__ import annotations

import argparse
import os
import platform
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import resources
from importlib.metadata import version
from pathlib import Path

import numpy as np

#: The command line, whatever the PATH holds.
EIVOR = (sys.executable, "-c", "from eivor.__main__ import run; run()")


def arguments(about: str | None) -> argparse.Namespace:
    """The option that all benchmarks have."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--small", action="store_true", help="one repetition of the smallest case")
    return parser.parse_args()


def machine() -> str:
    """The machine and the versions that matter, in one line."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line
        ]
        model = names[0] if names else model
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "polars", "pyulog"))
    return f"{os.cpu_count()} cores, {model}, Python {platform.python_version()}, {versions}"


def least_seconds(
    action: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Least time of some runs of `action` [s], by the clock on the wall or another."""
    best = float("inf")
    for _ in range(repeats):
        started = clock()
        action()
        best = min(best, clock() - started)
    return best


def process_seconds(command: tuple[str, ...], *, allowed: tuple[int, ...] = (0,)) -> float:
    """Wall time of a whole process, interpreter start included [s]."""
    start_s = time.perf_counter()
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start_s
    if run.returncode not in allowed:
        raise RuntimeError(f"{command} left with {run.returncode}:\n{run.stdout}{run.stderr}")
    return seconds


def alternating(
    commands: dict[str, tuple[str, ...]], repeats: int, **options: tuple[int, ...]
) -> dict[str, float]:
    """Least wall time of each command [s]; they take turns, so that all see the same machine."""
    best = dict.fromkeys(commands, float("inf"))
    for _ in range(repeats):
        for name, command in commands.items():
            best[name] = min(best[name], process_seconds(command, **options))
    return best


def example_flight() -> Path:
    """The flight that comes with the package."""
    return Path(str(resources.files("eivor.data") / "example_flight.parquet"))


def real_ulogs() -> list[Path]:
    """Real ULog files of about 3 MB, when there are recordings."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("EIVOR_DATA") or default) / "px4"
    return [path for name in ("ekf_failure", "battery_brownout") if (path := folder / f"{name}.ulg").exists()]


def synthetic_ulog(path: Path, *, flight_s: float, filler_bytes: int) -> Path:
    """ULog of the example flight as PX4 would log it, and `filler_bytes` of a topic that nobody needs."""
    import polars as pl

    table = pl.read_parquet(example_flight()).filter(pl.col("time") <= flight_s)
    column = {name: table[name].to_numpy().astype(np.float64) for name in table.columns}
    rows = table.height
    zero = np.zeros(rows)
    thrust = np.mean([(column[f"rotor_command_{i}"] / 2500.0) ** 2 for i in range(1, 5)], axis=0)
    force = [column.get(f"specific_force_body_{axis}", zero) for axis in "xy"]
    vertical = column.get("specific_force_body_z", column.get("specific_force_z", zero))
    quaternion = [column.get(f"attitude_{part}", zero + (part == "w")) for part in "wxyz"]
    time = column["time"]
    topics = {
        "vehicle_local_position": ("z vz", [-column["position_z"], -column["velocity_z"]]),
        "vehicle_acceleration": ("[3]xyz", [force[0], -force[1], -vertical]),
        "vehicle_attitude": ("[4]q", [quaternion[0], quaternion[1], -quaternion[2], -quaternion[3]]),
        "vehicle_thrust_setpoint": ("[3]xyz", [zero, zero, -thrust]),
        "trajectory_setpoint": ("[3]position", [zero, zero, -column["reference_position_z"]]),
    }
    definitions, data = [_message("B", bytes(40))], []
    for number, (name, (fields, columns)) in enumerate(topics.items()):
        definition, messages = _topic(number, name, fields, time, columns)
        definitions.append(definition)
        data.append(messages)
    count = filler_bytes // (5 + 8 + 4 * 60)
    if count:
        filler = [np.linspace(0.0, 1.0, count)] * 60
        definition, messages = _topic(
            99, "debug_array", "[60]data", np.linspace(0.0, flight_s, count), filler
        )
        definitions.append(definition)
        data.append(messages)
    header = b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
    path.write_bytes(header + b"".join(definitions) + b"".join(data))
    return path


def _message(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def _topic(
    number: int, name: str, fields: str, time: np.ndarray, columns: list[np.ndarray]
) -> tuple[bytes, bytes]:
    """Definition and messages of a topic of floats; `fields` as in "z vz" or "[3]xyz"."""
    kinds = []
    for field in fields.split():
        length, _, label = field.rpartition("]")
        kinds.append(f"float{length}{']' if length else ''} {label}")
    definition = _message("F", f"{name}:uint64_t timestamp;{';'.join(kinds)};".encode())
    layout = np.dtype(
        [
            ("size", "<u2"),
            ("kind", "S1"),
            ("id", "<u2"),
            ("timestamp", "<u8"),
            ("values", "<f4", len(columns)),
        ]
    )
    messages = np.zeros(time.size, dtype=layout)
    messages["size"] = layout.itemsize - 3
    messages["kind"] = b"D"
    messages["id"] = number
    messages["timestamp"] = 1_000_000 + np.round(time * 1e6).astype(np.uint64)
    messages["values"] = np.column_stack(columns)
    subscription = _message("A", struct.pack("<BH", 0, number) + name.encode())
    return definition, subscription + messages.tobytes()
