"""Columnar tables: Parquet, HDF5 and MATLAB files, decoded in a child process first."""

from __future__ import annotations

import codecs
import inspect
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import datetime
from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import scipy

from eivor.atomic_file import atomic_write
from eivor.errors import (
    ChannelMapError,
    CorruptLogError,
    EmptyLogError,
    LogTooLargeError,
    MissingReaderError,
    UsageError,
)
from eivor.logs import common
from eivor.logs.channel_map import columns_of, load_channel_map
from eivor.logs.mapping import fitted_rules, fitting_map, listed, mapped_recording
from eivor.logs.table import delimited
from eivor.process_pool import SANDBOX
from eivor.signals.channels import CurveSide
from eivor.signals.recording import Channel, Frame, LogOrigin, Recording
from eivor.tools import Float

if TYPE_CHECKING:
    import polars as pl


# -- Decoding in a child process --

#: What a child leaves with that refuses a file, having printed why.
REFUSED = 3
_DAMAGED = "The file is damaged or incomplete; write it again."
#: Time of the processor that a child may take [s], and more for each byte of the file.
CPU_S, CPU_S_PER_BYTE = 15, 2e-7
#: What a child begins with: `request` is what it is given, and it may use so many bytes.
#: Where the system cannot limit memory, it is not limited.
BEGINNING = """
import json, sys
request = json.load(sys.stdin)
try:
    import resource
    resource.setrlimit(resource.RLIMIT_DATA, (request["bytes"], request["bytes"]))
    resource.setrlimit(resource.RLIMIT_CPU, (request["seconds"], request["seconds"] + 5))
except (ImportError, ValueError, OSError):
    pass
"""
#: What follows a `try` in a child.
ENDING = f"""
except BaseException as error:
    print(type(error).__name__, str(error)[:500])
    sys.exit({REFUSED})
"""


def decode_in_child(
    file: Path, code: str, requested: Mapping[str, Any], max_bytes: int, kind: str, timeout_s: float = 120.0
) -> None:
    """Decode a file in a child process, and refuse one that the child refuses, dies of or does not finish."""
    if SANDBOX in os.environ or not sys.executable or getattr(sys, "frozen", False):
        return
    seconds = CPU_S + int(file.stat().st_size * CPU_S_PER_BYTE)
    selected = {"path": str(file.resolve()), "bytes": max_bytes, "seconds": seconds, **requested}
    try:
        child = subprocess.run(  # noqa: S603 - the program is this interpreter, the path goes to its stdin
            [sys.executable, "-P", "-c", code],
            input=json.dumps(selected).encode(),
            capture_output=True,
            # each thread has a stack and arenas of its own, which count as memory
            env=os.environ | {"POLARS_MAX_THREADS": "1"},
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        reason = f"{kind} that is not decoded within {timeout_s:.0f} s"
        raise delimited.corrupt_table(file.name, reason, _DAMAGED) from error
    except OSError:
        return
    if child.returncode == REFUSED:
        reason = f"cannot be decoded: {child.stdout.decode('utf-8', 'replace').strip()}"
    else:
        reason = f"makes the decoder fail (exit code {child.returncode}; it may use {max_bytes >> 20} MiB)"
    if child.returncode != 0:
        raise delimited.corrupt_table(file.name, f"{kind} that {reason}", _DAMAGED)


# -- Parquet --

PARQUET_TIMEOUT_S = 300.0

#: Runs in the child; an import that fails there says nothing about the file, hence leaves with 0.
_PARQUET_CODE = f"""{BEGINNING}
try:
    import polars as pl
except ImportError:
    sys.exit(0)
try:
    frame = pl.scan_parquet(request["path"], glob=False, hive_partitioning=False)
    for pattern in request["patterns"]:
        frame.select(pl.col(pattern)).collect()
{ENDING}"""


def exactly(column: str) -> str:
    """Return the pattern of polars that means the column of this very name ("*" and "^a$" mean others)."""
    letters = "".join(f"\\x{{{ord(letter):x}}}" for letter in column)
    return f"^{letters}$"


#: Most rows that are read: a Parquet file may say much more than its size holds.
MAX_ROWS = 50_000_000
#: Memory that the decoding of one column may take [bytes]: for the decoder itself, and for each row.
PARQUET_DECODER_BYTES = 512 << 20
ROW_BYTES = 64
#: Key of the file's metadata under which `write_recording` keeps what is not a number.
METADATA_KEY = "eivor"


def open_parquet(file: Path, max_bytes: int) -> delimited.TableSource:
    """Read the footer of a Parquet file."""
    import polars as pl

    with delimited.polars_errors(partial(_unreadable_parquet, file)):
        frame = pl.scan_parquet(file.resolve(), glob=False, hive_partitioning=False)
        schema = frame.collect_schema()
        rows = int(frame.select(pl.len()).collect().item())
        metadata = pl.read_parquet_metadata(file.resolve())
    if len(schema) > delimited.MAX_COLUMNS:
        remedy = f"At most {delimited.MAX_COLUMNS} are read; select some."
        raise delimited.corrupt_table(file.name, f"with {len(schema)} columns", remedy)
    if rows == 0:
        raise EmptyLogError("a table with rows", f"'{file.name}' without one", "Check the export.")
    if rows > MAX_ROWS:
        remedy = "Cut the log to the manoeuvre of interest."
        raise LogTooLargeError(f"at most {MAX_ROWS} rows", f"'{file.name}' with {rows}", remedy)
    read_columns = partial(_read_columns, file, frame, schema, rows, max_bytes)
    return delimited.TableSource(tuple(schema), read_columns, (), metadata.get(METADATA_KEY, ""))


def _unreadable_parquet(file: Path, error: BaseException) -> CorruptLogError:
    return delimited.corrupt_table(file.name, f"a Parquet file that cannot be decoded: {error}", _DAMAGED)


def _read_columns(
    file: Path, frame: pl.LazyFrame, schema: pl.Schema, rows: int, max_bytes: int, columns: Sequence[str]
) -> common.Columns:
    """Decode columns; those that hold no numbers (lists, structures, bytes) are not touched."""
    import polars as pl

    _check_cells(file, rows * len(columns), max_bytes)
    bases = {column: common.element_of(column, list(schema)) or (column, None) for column in columns}
    decoded = [base for base, index in bases.values() if _is_decoded(schema[base], index)]
    # the package's own file is known to be whole, and a probe takes a process
    if file.resolve().parent != Path(str(resources.files("eivor.data"))).resolve():
        request = {"patterns": [exactly(base) for base in dict.fromkeys(decoded)]}
        limit = PARQUET_DECODER_BYTES + ROW_BYTES * rows
        decode_in_child(file, _PARQUET_CODE, request, limit, "a Parquet file", PARQUET_TIMEOUT_S)

    def convert(base: str, index: int | None) -> tuple[np.ndarray, int, str]:
        kind = schema[base]
        if not _is_decoded(kind, index):
            return np.full(rows, np.nan), rows, f"{kind}" if _holds_lists(kind) else ""
        with delimited.polars_errors(partial(_unreadable_parquet, file)):
            # under a name of our own, as an operation on a series may take its name as a pattern too
            series = frame.select(pl.col(exactly(base)).alias("c")).head(rows).collect().to_series()
            values, bad = _parquet_numbers(series if index is None else _element(series, index))
        if values.size != rows:
            raise _unreadable_parquet(file, ValueError(f"{values.size} values of '{base}' in {rows} rows"))
        return values, bad, ""

    clocks = (pl.Datetime, pl.Duration)
    seconds = frozenset(column for column, (base, _) in bases.items() if schema[base] in clocks)
    return replace(delimited.table_columns(columns, list(schema), convert), seconds=seconds)


def _element(series: pl.Series, index: int) -> pl.Series:
    import polars as pl

    if series.dtype == pl.Array:
        series = series.arr.to_list()
    return series.list.get(index, null_on_oob=True)


def _holds_lists(kind: pl.DataType) -> bool:
    import polars as pl

    inner = getattr(kind, "inner", None)
    return kind in (pl.List, pl.Array) and inner is not None and inner.is_numeric()


def _check_cells(file: Path, cells: int, max_bytes: int) -> None:
    """Refuse a file whose numbers would exceed the memory limit, before decoding."""
    size = file.stat().st_size
    limit = common.most_cells(size, max_bytes)
    if cells > limit:
        remedy = "Cut it to the manoeuvre, or raise the limit: read_log(max_bytes=...)."
        if limit < common.MAX_CELLS and limit < max_bytes // 8:
            remedy = "Such a file repeats itself, which no flight does; check what wrote it."
        expected = f"at most {limit} numbers in the needed variables of {size} bytes"
        raise LogTooLargeError(expected, f"'{file.name}' with {cells}", remedy)


def _is_decoded(kind: pl.DataType, index: int | None) -> bool:
    import polars as pl

    if index is not None:
        return _holds_lists(kind)
    return kind.is_numeric() or kind in (pl.Boolean, pl.Null, pl.String, pl.Datetime, pl.Duration)


def _parquet_numbers(series: pl.Series) -> tuple[np.ndarray, int]:
    import polars as pl

    missing = series.null_count()
    if series.dtype in (pl.Datetime, pl.Duration):
        unit = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}[str(getattr(series.dtype, "time_unit", "us"))]
        series = series.to_physical().cast(pl.Float64) * unit
    elif series.dtype == pl.String:
        series = series.str.strip_chars()
    numbers = series.cast(pl.Float64, strict=False)
    return numbers.fill_null(np.nan).to_numpy().copy(), numbers.null_count() - missing


def variables_source(
    name: str,
    shapes: Mapping[str, tuple[int, ...]],
    values: Callable[[Sequence[str]], Mapping[str, np.ndarray]],
) -> delimited.TableSource:
    """Return the table of a file's variables."""
    if not shapes:
        remedy = "Save each signal as a vector of its own; objects (timeseries, tables) are not read."
        raise EmptyLogError("a file with vectors or matrices of numbers", f"'{name}' without any", remedy)
    if len(shapes) > delimited.MAX_COLUMNS:
        remedy = f"At most {delimited.MAX_COLUMNS} are read."
        raise delimited.corrupt_table(name, f"with {len(shapes)} variables", remedy)

    def read(columns: Sequence[str]) -> common.Columns:
        bases = (common.element_of(column, list(shapes)) or (column, None) for column in columns)
        arrays = values(list(dict.fromkeys(base for base, _ in bases)))

        def convert(base: str, index: int | None) -> tuple[np.ndarray, int, str]:
            array = np.squeeze(np.asarray(arrays[base], dtype=np.float64))
            if array.ndim < 2:
                return np.atleast_1d(array), 0, ""
            # one row of a matrix for each instant, whichever way it was saved
            array = array if array.shape[0] >= array.shape[1] else array.T
            missing = np.full(array.shape[0], np.nan)
            if index is None:
                return missing, missing.size, f"a matrix of {shapes[base]}"
            return array[:, index] if index < array.shape[1] else missing, 0, ""

        table = delimited.table_columns(columns, list(shapes), convert)
        lengths = {column: array.size for column, array in table.values.items()}
        if len(set(lengths.values())) > 1:
            text = ", ".join(f"'{column}' {size}" for column, size in list(lengths.items())[:8])
            remedy = "Name those of one clock in a channel map (--map)."
            raise ChannelMapError("variables of one length, with one clock", f"'{name}' with {text}", remedy)
        return table

    return delimited.TableSource(tuple(shapes), read)


# -- HDF5 --

#: Memory that a decoder may take [bytes]: for itself, and for each number.
DECODER_BYTES, BYTES_PER_CELL = 400 << 20, 16
#: Kinds of MATLAB's variables that are no numbers, although they are stored as such.
_NO_NUMBERS = (b"char", b"cell", b"function_handle", b"FileWrapper__")


def hdf5_variables(
    h5py: Any, file: Any, limit: int, objects: int, depth: int
) -> tuple[dict[str, tuple[int, ...]], set[str]]:
    """Shapes of variables by path, and those beyond so many numbers, small ones and whole chunks first."""
    sizes: dict[str, tuple[int, ...]] = {}
    cells: dict[str, int] = {}
    waiting, visited = [("", file, 1)], 0
    while waiting:
        prefix, group, level = waiting.pop()
        for name in group:
            visited += 1
            if visited > objects or level > depth:
                raise ValueError(f"more than {objects} groups and variables, or {depth} in each other")
            if name == "#refs#" or not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            node = group[name]
            if isinstance(node, h5py.Group):
                waiting.append((f"{prefix}{name}/", node, level + 1))
                continue
            # other files are none of this one's business, and one without a space has no shape
            is_plain = isinstance(node, h5py.Dataset) and not (node.is_virtual or node.external)
            if is_plain and node.dtype.kind in "iufb" and node.size and len(node.shape) in (1, 2):
                sizes[prefix + name] = tuple(int(size) for size in node.shape)
                cells[prefix + name] = max(math.prod(node.shape), math.prod(node.chunks or ()))
    large, total = set(), 0
    for path in sorted(cells, key=lambda path: cells[path]):
        total += cells[path]
        if total > limit:
            large.add(path)
    return sizes, large


_HDF5_CODE = f"""from __future__ import annotations
{BEGINNING}
from typing import Any
import h5py, math
{inspect.getsource(hdf5_variables)}
try:
    with h5py.File(request["path"], "r") as file:
        found, large = hdf5_variables(h5py, file, *request["limits"])
        for path in found:
            if path not in large:
                file[path][()]
{ENDING}"""


def open_hdf5(file: Path, max_bytes: int) -> delimited.TableSource:
    """Name the variables of an HDF5 file."""
    try:
        import h5py
    except ImportError as error:
        expected = "h5py, which reads HDF5 and MATLAB 7.3"
        remedy = "Install it: pip install 'eivor[hdf5]'. Or save with '-v7' in MATLAB."
        raise MissingReaderError(expected, f"an installation without it ({error})", remedy) from error
    most = common.most_cells(file.stat().st_size, max_bytes)
    limits = (most, common.MAX_OBJECTS, common.MAX_DEPTH)
    limit = DECODER_BYTES + BYTES_PER_CELL * most
    decode_in_child(file, _HDF5_CODE, {"limits": limits}, limit, "an HDF5 file")
    try:
        with h5py.File(file, "r") as content:
            sizes, large = hdf5_variables(h5py, content, *limits)
            kinds = {path: content[path].attrs.get("MATLAB_class") for path in sizes}
    except common.DECODER_ERRORS as error:
        reason = f"an HDF5 file that cannot be read: {error}"
        raise delimited.corrupt_table(file.name, reason, "The file is damaged; write it again.") from error
    positions = {path.replace("/", "."): path for path in sizes if kinds[path] not in _NO_NUMBERS}

    def values(names: Sequence[str]) -> dict[str, np.ndarray]:
        if any(positions[name] in large for name in names):
            cells = sum(math.prod(sizes[positions[name]]) for name in names)
            _check_cells(file, max(most + 1, cells), max_bytes)
        with h5py.File(file, "r") as content:
            return {name: np.asarray(content[positions[name]][()]) for name in names}

    return variables_source(file.name, {name: sizes[path] for name, path in positions.items()}, values)


# -- MATLAB --

#: How deep structures may stand in each other.
MAX_NESTING = 4
#: Kinds of variables that hold numbers; others are objects, cells and texts.
_MATLAB_KINDS = (
    "struct",
    "double",
    "single",
    "logical",
    *(f"{u}int{8 * n}" for u in ("", "u") for n in (1, 2, 4, 8)),
)
_MATLAB_CODE = f"""{BEGINNING}
from math import prod
from scipy.io import loadmat, whosmat
try:
    known = [item for item in whosmat(request["path"]) if item[2] in request["kinds"]]
    if sum(prod(shape) for _, shape, _ in known) <= request["most"]:
        loadmat(request["path"], squeeze_me=True, variable_names=[name for name, *_ in known])
{ENDING}"""


def open_matlab(file: Path, max_bytes: int) -> delimited.TableSource:
    """Read the variables of a MATLAB file."""
    most = common.most_cells(file.stat().st_size, max_bytes)
    limit = DECODER_BYTES + BYTES_PER_CELL * most
    decode_in_child(file, _MATLAB_CODE, {"kinds": _MATLAB_KINDS, "most": most}, limit, "a MATLAB file")
    try:
        known = [item for item in scipy.io.whosmat(file) if item[2] in _MATLAB_KINDS]
        _check_cells(file, sum(math.prod(shape) for _, shape, _ in known), max_bytes)
        content = scipy.io.loadmat(file, squeeze_me=True, variable_names=[name for name, *_ in known])
    except common.DECODER_ERRORS as error:
        reason = f"a MATLAB file that cannot be decoded: {error}"
        raise delimited.corrupt_table(file.name, reason, "The file is damaged; save it again.") from error
    results = {
        name: array
        for key, value in content.items()
        if not key.startswith("__")
        for name, array in _matlab_numbers(key, value, MAX_NESTING)
    }
    shapes = {name: result.shape for name, result in results.items()}
    return variables_source(file.name, shapes, lambda names: {name: results[name] for name in names})


def _matlab_numbers(name: str, value: Any, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    array = np.asarray(value)
    if array.dtype.names and array.ndim == 0 and depth:
        for field in array.dtype.names:
            yield from _matlab_numbers(f"{name}.{field}", array[field].item(), depth - 1)
    elif array.dtype.kind in "iufb" and array.ndim in (1, 2) and array.size:
        yield name, array


# -- Written recordings --


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as one table with canonical column names."""
    import polars as pl

    position = Path(path)
    if position.suffix != ".parquet":
        raise UsageError("a path that ends in .parquet", f"'{position.name}'", "Change the ending.")
    if not recording.channels:
        raise UsageError("a recording with channels", "one without", "Nothing can be written.")
    clocks: list[np.ndarray] = []
    for channel in recording.channels.values():
        if not any(np.array_equal(channel.time_s, clock) for clock in clocks):
            clocks.append(channel.time_s)
    time = clocks[0] if len(clocks) == 1 else np.unique(np.concatenate(clocks))
    channels = {name: _on_stamps(channel, time) for name, channel in recording.channels.items()}
    frame = pl.DataFrame({"time": time, **channels})
    on_own = [channel.name for channel in recording.channels.values() if channel.time_s.size != time.size]
    with atomic_write(position) as file:
        frame.write_parquet(file, metadata={METADATA_KEY: _metadata(recording, on_own)})


def _on_stamps(channel: Channel, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    if channel.time_s.size == time.size:
        return channel.values
    if np.isnan(channel.values).any():
        expected = f"values at all stamps of '{channel.name}', which has a clock of its own"
        received = "NaN among them, which would read back as no stamp"
        raise UsageError(expected, received, "Leave these samples out first, or write the channel by itself.")
    values = np.full(time.size, np.nan)
    values[np.searchsorted(time, channel.time_s)] = channel.values
    return values


#: What metadata hold of a channel and of its quality, and the type of each.
_CHANNEL: Mapping[str, type] = {"source": str, "held": bool, "estimated": bool, "delay_s": float}
_QUALITY = ("overflowed", "saturated")


def _metadata(recording: Recording, on_own: Sequence[str]) -> str:
    channels = {
        channel.name: {
            **{name: getattr(channel, name) for name in _CHANNEL},
            "curve_side": channel.curve_side.value,
            "own_clock": channel.name in on_own,
            **{name: getattr(channel.quality, name) for name in _QUALITY},
        }
        for channel in recording.channels.values()
    }
    content = {
        "version": 1,
        "frame": recording.frame.name,
        "input_map": recording.input_map,
        "parameters": dict(recording.parameters),
        "origin": asdict(recording.origin),
        "channels": channels,
    }
    return json.dumps(content, default=datetime.isoformat)


def restore(recording: Recording, metadata: str) -> Recording:
    """Return the recording with what `write_recording` left in the file's metadata."""
    if not metadata:
        return recording
    try:
        content = json.loads(metadata)
        changes: dict[str, Any] = {
            "frame": Frame[content["frame"]],
            "input_map": _typed(content["input_map"], str),
            "parameters": {name: _typed(value, float) for name, value in content["parameters"].items()},
            "channels": {
                name: _restored(channel, content["channels"].get(name, {}))
                for name, channel in recording.channels.items()
            },
        }
        if "origin" in content:
            changes["origin"] = msgspec.convert(content["origin"], LogOrigin)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        return replace(recording, findings=(*recording.findings, *common.noted("metadata")))
    return replace(recording, **changes)


def _restored(channel: Channel, content: Mapping[str, Any]) -> Channel:
    quality = replace(channel.quality, **{name: _typed(content.get(name, 0), int) for name in _QUALITY})
    if _typed(content.get("own_clock", False), bool):
        finite = ~np.isnan(channel.values)
        channel = replace(channel, time_s=channel.time_s[finite], values=channel.values[finite])
        quality = replace(quality, missing_values=0)
    given = {name: kind for name, kind in _CHANNEL.items() if content.get(name) is not None}
    kept = {name: _typed(content[name], kind) for name, kind in given.items()}
    side = CurveSide(content.get("curve_side", channel.curve_side.value))
    return replace(channel, quality=quality, curve_side=side, **kept)


def _typed(value: Any, kind: type) -> Any:
    """A value of a type: a whole number is a number, and numbers are finite, counts zero or more."""
    if kind is float and isinstance(value, int | float) and math.isfinite(value):
        return float(value)
    if type(value) is not kind or (isinstance(value, int) and value < 0):
        raise TypeError(kind)
    return value


_HDF5 = b"\x89HDF\r\n\x1a\n"


def _is_csv(head: bytes, _file: Path) -> bool:
    decoder = codecs.getincrementaldecoder("utf-8-sig")()
    try:
        return delimited.is_delimited(decoder.decode(head))
    except UnicodeDecodeError:
        return False


def _table(
    name: str,
    label: str,
    sniff: Callable[[bytes, Path], bool],
    opened: Callable[[Path, int], delimited.TableSource],
    *endings: str,
) -> common.LogFormat:
    """Row of a table: what is the same of all is said here."""

    def read(file: Path, options: common.ReadOptions) -> Recording:
        source, alone = opened(file, options.max_bytes), options.channel_map is None
        findings = list(source.findings)
        if options.channel_map is None:
            chosen = fitting_map(source.names, file.name, findings, source.units)
        else:
            chosen = load_channel_map(options.channel_map)
        elements = [
            name for name in columns_of(chosen.rules) if common.element_of(name, source.names) is not None
        ]
        rules = fitted_rules(chosen, [*source.names, *elements], file.name)
        needed = chosen.needed_by(rules)
        if alone and chosen.origin == file.name:
            ignored = listed([name for name in source.names if name not in needed])
            findings += common.noted("ignored_columns", ignored)
        recording = mapped_recording(
            chosen, rules, source.read(needed), name=file.name, log_format=name, findings=findings
        )
        return restore(recording, source.metadata) if alone else recording

    words = "Add a column '{}', or map one in a channel map."
    advised = common.advised(common.LOG_TABLES["tables"], lambda channel: (words.format(channel),))
    return common.LogFormat(name, label, sniff, read, takes_map=True, endings=endings, **advised)


TEXTS = (_table("csv", "CSV", _is_csv, lambda file, _: delimited.open_csv(file), ".csv", ".tsv"),)
PARQUETS = (_table("parquet", "Parquet", common.begins_with(b"PAR1"), open_parquet, ".parquet"),)
ARRAYS = (
    _table("matlab", "MATLAB", common.begins_with(b"MATLAB 5.0 MAT-file"), open_matlab, ".mat"),
    # at once, or after the 512 bytes of text of MATLAB 7.3
    _table("hdf5", "HDF5", lambda head, _: _HDF5 in (head[:8], head[512:520]), open_hdf5, ".h5", ".hdf5"),
)
