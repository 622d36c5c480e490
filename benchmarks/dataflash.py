"""`read_log` on a DataFlash log of firmware 4.6 with fast logging against pymavlink, in processor time.

Target: 50 MB/s, and a tenth of the time in which pymavlink hands out the same messages one by one.

Tables of 17 columns beside it, 1e6 rows, against polars' own read (targets: CSV 2.5, Parquet 8).
"""

from __future__ import annotations

import struct
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl
from _shared import arguments, least_seconds, machine
from pymavlink.DFReader import DFReader_binary

from eivor.logs import read_log
from eivor.logs.dataflash.sources import NEEDED

#: Name, codes, columns, and how often it is logged [Hz].
MESSAGES = (
    ("RATE", "Qfffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut,AOutSlew", 400),
    ("IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz", 400),
    ("ATT", "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF", 400),
    ("XKF1", "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH", 25),
    ("VIBE", "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip", 25),
    ("PSCD", "Qffffffff", "TimeUS,DPD,TPD,PD,DVD,TVD,VD,DAD,TAD", 10),
    ("CTUN", "Qfffff", "TimeUS,ThI,ABst,ThO,ThH,DAlt", 10),
    ("RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4", 10),
)
HEAD = b"\xa3\x95"
#: What is written again and again with later stamps [s].
PERIOD_S = 0.2
SMALL_MB, LARGE_MB = 2.0, 20.0


def synthetic(path: Path, megabytes: float) -> Path:
    """Write a log of so many megabytes: what the loop logs in a period, over and over."""
    kinds = {"Q": "Q", "B": "B", "H": "H", "I": "I", "f": "f", "c": "h", "C": "H", "e": "i"}
    descriptions = b"".join(
        HEAD
        + struct.pack("<BBB4s16s64s", 128, n, size(codes, kinds), *map(str.encode, (name, codes, columns)))
        for n, (name, codes, columns, _) in enumerate(MESSAGES, start=129)
    )
    rng, logged = np.random.default_rng(0), []
    for n, (_, codes, _, rate_hz) in enumerate(MESSAGES, start=129):
        for k in range(round(PERIOD_S * rate_hz)):
            values = [rng.uniform(0.1, 0.9) if kinds[code] == "f" else 0 for code in codes[1:]]
            message = HEAD + struct.pack("<BQ" + "".join(kinds[code] for code in codes[1:]), n, 0, *values)
            logged.append((round(1e6 * (k + 1) / rate_hz), message))
    logged.sort(key=lambda pair: pair[0])
    joined = b"".join(message for _, message in logged)
    stamps = np.array([stamp for stamp, _ in logged])
    positions = 3 + np.cumsum([0, *(len(message) for _, message in logged)])[:-1]
    count = max(1, round(1e6 * megabytes / len(joined)))
    whole = np.tile(np.frombuffer(joined, dtype=np.uint8), (count, 1))
    ticks = (stamps + (np.arange(count) * round(1e6 * PERIOD_S))[:, None]).astype("<u8")
    for byte in range(8):
        whole[:, positions + byte] = ticks[..., None].view(np.uint8)[:, :, byte]
    path.write_bytes(descriptions + whole.tobytes())
    return path


def size(codes: str, kinds: dict[str, str]) -> int:
    """Length of a message with its head and type [bytes]."""
    return 3 + struct.calcsize("<" + "".join(kinds[code] for code in codes))


def messages_of_peer(path: Path) -> int:
    """Read the messages that Eivor needs with pymavlink; return how many there are."""
    log, count = DFReader_binary(str(path)), 0
    wanted = [name for name in NEEDED if name in log.name_to_id]
    while log.recv_match(type=wanted) is not None:
        count += 1
    log.filehandle.close()
    return count


def tables(folder: Path, rows: int, repeats: int) -> None:
    """Times of tables, in turns with polars."""
    rng, names = np.random.default_rng(0), ["velocity_z", "specific_force_z", "input", "position_z"]
    names += [f"rotor_command_{number}" for number in range(1, 5)] + [f"attitude_{part}" for part in "wxyz"]
    names += [f"rate_{axis}" for axis in "xyz"] + ["battery_voltage"]
    columns = {name: rng.standard_normal(rows).round(5) for name in names}
    table = pl.DataFrame({"time": 0.01 * np.arange(rows), **columns})
    table.write_csv(folder / "flight.csv")
    table.write_parquet(folder / "flight.parquet")
    for name, read in (("flight.csv", pl.read_csv), ("flight.parquet", pl.read_parquet)):
        path = folder / name
        works = (lambda path=path: read_log(path), lambda path=path, read=read: read(path))
        pairs = [[least_seconds(work, 1, time.process_time) for work in works] for _ in range(repeats)]
        ours, peer = np.min(pairs, axis=0)
        ratio = np.median([mine / other for mine, other in pairs])
        print(
            f"{name:<16}{rows:9,} rows   read_log {ours:6.3f} s   polars {peer:6.3f} s   ratio {ratio:5.1f}"
        )


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    with tempfile.TemporaryDirectory() as folder:
        tables(Path(folder), 20_000 if small else 1_000_000, 1 if small else 5)
        for megabytes in [SMALL_MB] if small else [SMALL_MB, LARGE_MB]:
            path = synthetic(Path(folder) / "flight.bin", megabytes)
            repeats = 1 if small else 3
            ours = least_seconds(lambda path=path: read_log(path), repeats, time.process_time)
            peer = least_seconds(lambda path=path: messages_of_peer(path), repeats, time.process_time)
            written = path.stat().st_size / 1e6
            print(
                f"{written:6.1f} MB   read_log {ours:6.3f} s, {written / ours:5.1f} MB/s   "
                f"pymavlink {peer:6.2f} s   ratio {peer / ours:5.1f}"
            )


if __name__ == "__main__":
    main()
