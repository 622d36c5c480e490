"""A sound file of every format, as the writers of these tests make it, and ways to damage it."""

import copy
import json
import re
import struct
import sys
import tempfile
from functools import cache
from importlib import import_module, resources
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev

TEXTS = ("csv", "log", "fit.json", "vehicle.toml", "machine.toml", "map.toml")
INTEGERS = [(1 << bits) - less for bits in (1, 7, 8, 15, 16, 31, 32, 40, 63, 64) for less in (0, 1)]
TREE: list[object] = json.loads(
    '[null, true, -1, 0, 1, 1e300, -1e300, 5e-324, 1e40, "", "x", "nan", [], {}, [[]], [null], {"a": 1}]'
)
WORDS = f'nan inf -1 0 1e300 1e-320 -1e9 x [1,2] " true {"9" * 400} {{}} [['.split()


@cache
def seeds() -> dict[str, bytes]:
    """A sound file of each format, by the ending of its name."""
    here = Path(__file__).parent
    sys.path[:0] = [item for item in (str(here.parent), str(here)) if item not in sys.path]
    bags, made = import_module("bag_writer"), dict[str, bytes]()
    rosbag1, rosbag2 = import_module("rosbags.rosbag1"), import_module("rosbags.rosbag2")
    flight = import_module("dataflash_writer").simulated(seed=3, duration=2.0)
    ros1, ros2 = bags.stores()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        polars = import_module("polars")
        with resources.as_file(resources.files("eivor.data") / "example_flight.parquet") as example:
            metadata = {"eivor": polars.read_parquet_metadata(example)["eivor"]}
            polars.read_parquet(example).head(200).write_parquet(folder / "f.parquet", metadata=metadata)
        columns = {"time": np.arange(200) * 0.01, "velocity_z": np.ones(200), "input": np.ones(200)}
        polars.DataFrame(columns).write_csv(folder / "f.csv")
        import_module("scipy.io").savemat(folder / "f.mat", {**columns, "s": {"a": np.ones((200, 2))}})
        with import_module("h5py").File(folder / "f.h5", "w") as file:
            for name, values in columns.items():
                file.create_dataset(
                    f"group/{name}" if name == "input" else name, data=values, compression="gzip"
                )
        lz4 = rosbag1.Writer.CompressionFormat.LZ4
        bags.write_ros1(folder / "f.bag", bags.mavros_messages(ros1, flight), ros1)
        bags.write_ros1(folder / "f.lz4.bag", bags.mavros_messages(ros1, flight), ros1, lz4)
        plugin, mode = rosbag2.StoragePlugin, rosbag2.CompressionMode
        for name, kind, squeezed in (
            ("db3", plugin.SQLITE3, mode.NONE),
            ("mcap", plugin.MCAP, mode.NONE),
            ("zstd.mcap", plugin.MCAP, mode.STORAGE),
        ):
            bags.write_ros2(folder / "bag", bags.px4_messages(ros2, flight), ros2, kind, squeezed)
            (folder / "bag" / f"bag.{name.rpartition('.')[2]}").rename(folder / f"f.{name}")
            for left in (folder / "bag").iterdir():
                left.unlink()
            (folder / "bag").rmdir()
        made |= {path.name[2:]: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    dataflash = import_module("dataflash_writer").flight_log(flight)
    shipped = resources.files("eivor")
    made |= {
        "ulg": import_module("ulog_writer").flight().bytes(),
        **{f"usd{version}": import_module("usd_writer").flight(version).bytes() for version in (1, 2)},
        "bbl": walks(),
        "bin": dataflash.bytes(),
        "log": dataflash.lines(),
        "fit.json": ev.identify_flight(ev.example_flight()).to_json().encode(),
        "vehicle.toml": (shipped / "motions/rigid_body/vehicle_template.toml").read_bytes(),
        "machine.toml": (shipped / "motions/machines/servo.toml").read_bytes(),
        "map.toml": (shipped / "logs/maps/nanobench.toml").read_bytes(),
    }
    return made


def walks():
    """A blackbox log of columns that walk at random."""
    blackbox, rng = import_module("blackbox_writer"), np.random.default_rng(0)
    columns = {name: np.abs(np.cumsum(rng.integers(-9, 9, 200))) for name, *_ in blackbox.FIELDS}
    columns |= {"loopIteration": np.arange(200), "time": 1_000_000 + 500 * np.arange(200)}
    return blackbox.blackbox_log(columns)


def damaged(blob, rng):
    """One of the ways in which files break: changed bytes, a cut, a block twice, a block gone, zeros."""
    data = bytearray(blob)
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(6)
        index = int(rng.integers(len(data))) if data else 0
        length = int(rng.integers(1, 200))
        if kind == 0:
            for integer in rng.integers(0, max(len(data), 1), rng.integers(1, 20)):
                data[integer : integer + 1] = rng.bytes(1)
        elif kind == 1:
            del data[index:]
        elif kind == 2:
            data[index:index] = data[int(rng.integers(len(data) + 1)) :][:length]
        elif kind == 3:
            del data[index : index + length]
        elif kind == 4:
            data[index : index + length] = bytes(length)
        else:
            data[index:index] = rng.bytes(length)
    return bytes(data)


def by_structure(name: str, blob: bytes, rng: np.random.Generator) -> bytes:
    """Records, lines, cells or keys that are changed, gone, twice or elsewhere; numbers at the edge."""
    if name.endswith(".json") and rng.integers(4):
        return json.dumps(changed_tree(json.loads(blob), rng)).encode()
    parts = records(name, blob)
    index, other = (int(item) for item in rng.integers(len(parts), size=2))
    kind, chosen = rng.integers(6), bytearray(parts[index])
    if kind == 0:
        parts[index : index + int(rng.integers(1, 4))] = []
    elif kind == 1:
        parts.insert(other, parts[index])
    elif kind == 2:
        parts[index], parts[other] = parts[other], parts[index]
    elif name in TEXTS:
        tokens = re.split(rb"([^\w.+-]+)", bytes(chosen))
        tokens[int(rng.integers(len(tokens)))] = WORDS[rng.integers(len(WORDS))].encode()
        parts[index] = b"".join(tokens)
    elif chosen:
        size = int(rng.choice([1, 2, 4, 8]))
        place = int(rng.integers(min(len(chosen), 64 if kind == 3 else len(chosen))))
        number = INTEGERS[rng.integers(len(INTEGERS))] % (1 << 8 * size)
        chosen[place : place + size] = number.to_bytes(size, "little")
        parts[index] = bytes(chosen)
    return b"".join(parts)


def records(name: str, blob: bytes) -> list[bytes]:
    """The parts that a format is made of: lines, records, or blocks."""
    kind, position, parts = name.rpartition(".")[2], 0, list[bytes]()
    if name in TEXTS:
        return blob.splitlines(keepends=True)
    if kind in ("bin", "bbl"):
        return re.split(rb"(?=\xa3\x95)" if kind == "bin" else rb"(?=[IPH])", blob)
    begin = {"ulg": 16, "mcap": 8, "bag": blob.find(b"\n") + 1}.get(kind, 0)
    word = lambda at: struct.unpack_from("<I", blob, at)[0]  # noqa: E731
    lengths = {
        "ulg": lambda at: 3 + struct.unpack_from("<H", blob, at)[0],
        "mcap": lambda at: 9 + struct.unpack_from("<Q", blob, at + 1)[0],
        "bag": lambda at: 8 + word(at) + word(at + 4 + word(at)),
    }
    while position < len(blob):
        try:
            size = lengths[kind](position) if position >= begin and kind in lengths else begin or 64
        except struct.error:
            size = len(blob)
        parts.append(blob[position : position + size])
        position += size
    return parts


def changed_tree(document: Any, rng: np.random.Generator) -> Any:
    """A document with one or two values that are others, gone or twice."""
    document = copy.deepcopy(document)
    for _ in range(rng.integers(1, 3)):
        node = document
        while True:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            if not keys:
                break
            key = keys[rng.integers(len(keys))]
            if isinstance(node[key], dict | list) and node[key] and rng.integers(4):
                node = node[key]
                continue
            if rng.integers(4):
                node[key] = copy.deepcopy(TREE[rng.integers(len(TREE))])
            elif isinstance(node, list) and rng.integers(2):
                node.append(copy.deepcopy(node[key]))
            else:
                del node[key]
            break
    return document
