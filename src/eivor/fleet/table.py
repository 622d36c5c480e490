"""Table of flights in a fleet's folder: one row for each log and motion."""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import re
import uuid
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property, partial
from importlib.metadata import version
from itertools import chain, count
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import polars as pl

from eivor import checks
from eivor.atomic_file import is_sealed, remove_abandoned, report_system_errors, sealed, write_atomically
from eivor.errors import EivorError, InputError, UsageError
from eivor.fleet.logs import Log, LogList, path_fields
from eivor.flights.motion import Motion, of_vehicle
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.logs.channel_map import load_channel_map, shipped_maps
from eivor.logs.read import format_at, here, is_address, is_local, path_of, read_log
from eivor.motions.identify import identify_flight
from eivor.motions.table import DEFAULT, motion_by_name
from eivor.process_pool import Limits
from eivor.signals.recording import Recording
from eivor.strict_toml import package_tables


@dataclass(frozen=True)
class FleetOptions:
    """What is asked of every log."""

    motion: str = DEFAULT  # name of the motion
    vehicle_file: str = ""  # vehicle of the motions that ask for one: a name, or a file
    flight: FlightOptions = field(default_factory=FlightOptions)  # of every identification
    # patterns of logs' or files' names, and channel maps (names or files); the first that fits is taken
    maps: tuple[tuple[str, str], ...] = ()
    # pattern of paths with ``{vehicle}``, see `path_fields`, or a column of the list or of the logs;
    # empty for the board's id
    vehicle_from: str = ""
    limits: Limits = field(default_factory=Limits)  # of one log

    def __post_init__(self) -> None:
        self.chosen_motion()
        for _, chosen in self.maps:
            load_channel_map(chosen)
        if self.is_pattern:
            path_fields(self.vehicle_from)

    def chosen_motion(self) -> Motion[Any]:
        """The motion, of its vehicle; its channels are known from then on."""
        motion = motion_by_name(self.motion)
        return of_vehicle(motion, self.vehicle_file) if self.vehicle_file else motion

    @property
    def is_pattern(self) -> bool:
        return "{" in self.vehicle_from

    def document(self) -> dict[str, Any]:
        """Everything that rows depend on, as JSON: files by their content's hash."""
        return {
            "motion": self.motion,
            "vehicle": _content(self.vehicle_file),
            "flight": json.loads(json.dumps(asdict(self.flight), default=repr)),
            "maps": [[pattern, _content(item)] for pattern, item in self.maps],
            "vehicle_from": self.vehicle_from,
            "limits": asdict(self.limits),
        }

    @cached_property
    def hash(self) -> str:
        """Hash of the options, stored in each row."""
        text = json.dumps(self.document(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def row_of(self, log: Log) -> dict[str, Any]:
        """Beginning of the row of a log, also of one that is not read: what its name and the list say."""
        marks = {"motion": self.motion, "eivor_version": version("eivor"), "options_hash": self.hash}
        return {"sha256": log.sha256 or None, "name": log.name, **marks, **self.whose(log)}

    def whose(self, log: Log) -> Mapping[str, str]:
        """Vehicle and type as the log's path or the list says, where the user says that it does."""
        if self.is_pattern:
            return path_fields(self.vehicle_from, log.name)
        vehicle = log.metadata.get(self.vehicle_from, "")
        return {"vehicle": vehicle} if vehicle else {}


def given_maps(texts: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Patterns and maps as typed: ``PATTERN=MAP``; a map alone is that of all logs."""
    results = []
    for text in texts:
        pattern, equals, chosen = text.rpartition("=")
        if not chosen or (equals and not pattern):
            expected = f"PATTERN=MAP, with a file or one of {', '.join(shipped_maps())}"
            raise UsageError(expected, f"'{text}'", "Write --map 'lab/*.csv=lab.toml', for example.")
        results.append((pattern or "*", chosen))
    return tuple(results)


def _content(text: str) -> str:
    """A name as it is, a file as its hash: another content is another choice."""
    path = Path(text)
    return f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}" if text and path.is_file() else text


#: Folder of the parts that others read, that of rows which are in none of them yet, and what all are called.
FLIGHTS, PENDING, PART = "flights", "pending", "part-*.parquet"
#: A part of the table, by its number; it is full with so many rows.
NUMBERED, PART_ROWS = "part-{number:06d}.parquet", 100_000
_NUMBERED = re.compile(r"part-(\d{6})\.parquet")
#: Metadata key of the files merged into a part; such files are not read again.
MERGED = "eivor.merged"
POLARS_ERRORS = (pl.exceptions.PolarsError, pl.exceptions.PanicException)
#: Verdicts of rows without a result, beside those of `eivor.inference.verdict.Status`.
FAILED, COPY = "failed", "copy"
#: Columns of a quantity, after its name and a dot.
NUMBERS, VERDICT = ("value", "std_error", "low", "high"), "verdict"
#: Before the name of a diagnostic.
DIAGNOSTIC = "diagnostic."

_TEXT, _NUMBER, _TIME = pl.String(), pl.Float64(), pl.Datetime("us", "UTC")
_KINDS = {
    "text": _TEXT,
    "number": _NUMBER,
    "time": _TIME,
    "texts": pl.List(_TEXT),
    "numbers": pl.List(_NUMBER),
}
_WORDS = package_tables("eivor.fleet", "columns.toml")
#: Tables of a report without rows.
COVARIATES, DEVIATING = (
    pl.DataFrame(schema={name: _KINDS[kind] for name, kind in _WORDS[part].items()})
    for part in ("covariates", "deviating")
)
#: Columns before those of the quantities, and after them: type, what it is, and in which unit.
LEADING, TRAILING = (
    {name: (_KINDS[kind], words, unit) for name, (kind, words, unit) in _WORDS[part].items()}
    for part in ("leading", "trailing")
)
#: By which rows are sorted: a log has one row for each motion.
ORDER = ("motion", "name", "sha256")

Row = Mapping[str, Any]


def _column_words(types: Mapping[str, Any], motion: Motion[Any] | None) -> dict[str, dict[str, Any]]:
    """JSON Schemas of columns: of common ones, of a motion's quantities, and of others without words."""
    results: dict[str, dict[str, Any]] = {}
    for name, kind in types.items():
        quantity, _, part = name.rpartition(".")
        text = "string" if kind in (_TEXT, _TIME) else "number"
        about: dict[str, Any] = {"type": [text, "null"]}
        if isinstance(kind, pl.List):
            item = {"type": "string" if kind.inner == _TEXT else "number"}
            about = {"type": ["array", "null"], "items": item}
        _, words, unit = {**LEADING, **TRAILING}.get(name, (kind, _WORDS["quantity"].get(part, ""), ""))
        if name.startswith(DIAGNOSTIC):
            words = f"diagnostic {part}"
        spec = None if motion is None else motion.quantities.get(quantity)
        if spec is not None:
            words, unit = f"{spec.words}: {words}", "" if part == VERDICT else spec.unit
        results[name] = about | {"description": words} | ({"unit": unit} if unit else {})
    return results


def flight_frame(rows: Sequence[Row]) -> pl.DataFrame:
    """Rows as a table: every column that all fleets have, and those that these rows bring."""
    types = _column_types({name for row in rows for name in row})
    records = [{name: _finite_or_none(row.get(name)) for name in types} for row in rows]
    # a hundred columns of few rows: at once, which is three times as quick as one after the other
    return pl.from_dicts(records, schema=types).sort(ORDER, nulls_last=True)


def _column_types(names: Iterable[str]) -> dict[str, Any]:
    """Columns of a table in order, each with its type."""
    common = {name: kind for name, (kind, _, _) in {**LEADING, **TRAILING}.items()}
    of_quantity = {name: _TEXT if name.endswith(f".{VERDICT}") else _NUMBER for name in names}
    return {name: {**of_quantity, **common}[name] for name in _in_order(of_quantity)}


def _in_order(names: Iterable[str]) -> list[str]:
    """Every column that all fleets have, quantities by their names between them, diagnostics at the end."""
    parts = (*NUMBERS, VERDICT)

    def rank(name: str) -> tuple[str, int]:
        quantity, _, part = name.rpartition(".")
        return quantity, parts.index(part) if part in parts else len(parts)

    measured = sorted({*names}.difference(LEADING, TRAILING), key=rank)
    diagnostics = sorted(name for name in measured if name.startswith(DIAGNOSTIC))
    return [*LEADING, *(name for name in measured if name not in diagnostics), *TRAILING, *diagnostics]


def _finite_or_none(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def part_files(folder: Path) -> list[Path]:
    """Files of a fleet's rows: parts of the table, then pending ones; no row is in two of them."""
    parts = sorted((folder / FLIGHTS).glob(PART))
    merged = {name for path in parts for name in _merged(path)}
    pending = sorted((folder / PENDING).glob(PART))
    return [path for path in (*parts, *pending) if path.name not in merged]


def _merged(path: Path) -> list[str]:
    """Names of the parts that a part took in when it was written."""
    if not _NUMBERED.fullmatch(path.name):
        return []
    try:
        return pl.read_parquet_metadata(_parquet(path)).get(MERGED, "").split()
    except (OSError, *POLARS_ERRORS):
        return []  # whoever reads it says so


def read_flights(folder: Path, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Table of all rows of a fleet, sorted by `ORDER`."""
    parts = _parts(folder, None if columns is None else {*columns, *ORDER})
    table = pl.concat(parts, how="diagonal", rechunk=True)
    if columns is None:
        columns = _in_order(table.columns)
    absent = [name for name in columns if name not in table.columns]
    table = table.with_columns(pl.lit(None, pl.Float64).alias(name) for name in absent)
    return table.sort(ORDER, nulls_last=True).select(columns)


def _parts(folder: Path, columns: Set[str] | None) -> list[pl.DataFrame]:
    files = part_files(folder)
    if not files:
        expected = "the folder of a fleet, with its table of flights"
        remedy = "Make one: eivor fleet run LOGS -o FOLDER."
        raise InputError(expected, f"'{folder}', which has no {FLIGHTS}/{PART}", remedy)
    try:
        return [_read_part(file, columns) for file in files]
    except (OSError, *POLARS_ERRORS) as error:
        expected = f"a table of flights in '{folder}' that can be read"
        remedy = "Run `eivor fleet run` on it again, which sets damaged parts aside and makes them anew."
        raise InputError(expected, f"{type(error).__name__}: {error}", remedy) from error


def _read_part(file: Path, columns: Set[str] | None) -> pl.DataFrame:
    """The columns of a part that are among `columns`; folder names are not read as columns."""
    content = pl.scan_parquet(_parquet(file), hive_partitioning=False)
    if columns is None:
        return content.collect()
    names = content.collect_schema().names()
    return content.select([name for name in names if name in columns]).collect()


def quantity_names(table: pl.DataFrame) -> list[str]:
    """Quantities that a table of flights has columns of, in their order."""
    ending = f".{VERDICT}"
    return [name.removesuffix(ending) for name in table.columns if name.endswith(ending)]


SCHEMA = "eivor.fleet/1"
IDENTITY, RUN = "fleet.json", ".run"
#: Packages whose versions may change the rows.
PACKAGES = ("eivor", "numpy", "scipy", "polars")
#: Part of a motion's logs that could not be opened, written anew by every run.
UNOPENED = "part-unopened-{motion}.parquet"
#: JSON Schema of a row, with a description of every column.
COLUMNS = "schema.json"
#: Columns that identify the rows present.
KEY_COLUMNS = ("name", "sha256", "verdict")

#: The system's error for a file of a fleet's folder, as one of Eivor's.
report_fleet_errors = partial(report_system_errors, of="fleet", kept="Rows that were written")


class SupersededError(Exception):
    """Another run has begun on the folder: results of this one are dropped."""


@dataclass(frozen=True, slots=True)
class FleetFolder:
    """Where a run writes its rows."""

    folder: Path  # absolute, the same for all workers
    run: str = ""  # mark of the run, see `begin`

    def begin(self) -> FleetFolder:
        """The folder for a new run, which ends the writing of all before it."""
        run = uuid.uuid4().hex
        with report_fleet_errors(self.folder):
            for path in (self.folder, self.folder / FLIGHTS, self.folder / PENDING):
                path.mkdir(parents=True, exist_ok=True)
                remove_abandoned(path)
            _write(self.folder / RUN, run)
        return FleetFolder(self.folder, run)

    def state(self, options: FleetOptions) -> None:
        """Store the options and versions of the rows; those of other motions stay."""
        versions = {package: version(package) for package in PACKAGES}
        stored = self._read_document()
        if stored is not None and stored["versions"] != versions and part_files(self.folder):
            raise InputError(
                f"the versions that made the rows of '{self.folder}': {_versions_text(stored['versions'])}",
                _versions_text(versions),
                "Rows of different versions need not agree, so they are never put together. Begin anew in "
                "another folder with -o, or install those versions.",
            )
        options_of = {} if stored is None else stored["options"]
        document = {
            "schema": SCHEMA,
            "versions": versions,
            "options": {**options_of, options.motion: {"hash": options.hash, **options.document()}},
        }
        if document != stored:
            with report_fleet_errors(self.folder):
                _write(self.folder / IDENTITY, json.dumps(document, indent=2) + "\n")

    def check(self, options: FleetOptions) -> None:
        folder = self.folder
        if folder.exists() and not folder.is_dir():
            raise UsageError("a folder for the fleet", f"the file '{folder}'", "Choose another with -o.")
        stored = self._read_document()
        if stored is None and part_files(folder):
            received = f"'{folder}', which has parts of flights and no {IDENTITY}"
            raise UsageError("a new folder, or the folder of a fleet", received, "Choose another with -o.")
        earlier = None if stored is None else stored["options"].get(options.motion)
        if earlier is not None and earlier.get("hash") != options.hash:
            changed = [key for key, value in options.document().items() if earlier.get(key) != value]
            raise UsageError(
                f"a new folder, or the options that '{folder}' was begun with for the motion "
                f"'{options.motion}'",
                f"others ({', '.join(changed)})",
                "Rows of different options are never put together: choose another folder with -o, or give "
                f"those of {IDENTITY}.",
            )

    def _read_document(self) -> dict[str, Any] | None:
        path = self.folder / IDENTITY
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError):
            document = None
        content: dict[str, Any] = document if isinstance(document, dict) else {}
        schema, parts = content.get("schema"), (content.get("options"), content.get("versions"))
        if schema != SCHEMA or not all(isinstance(part, dict) for part in parts):
            received = f"'{path}' of {schema!r}" if schema else f"'{path}', which is another file"
            remedy = "Another version of Eivor made it: use that, or choose another folder with -o."
            raise InputError(f"a folder of the format {SCHEMA}", received, remedy)
        return content

    def check_run(self) -> None:
        """Refuse to go on with a run that another one has followed."""
        try:
            now = (self.folder / RUN).read_text(encoding="utf-8")
        except OSError:
            now = ""
        if now != self.run:
            raise SupersededError

    def write(self, rows: Sequence[Row]) -> None:
        """Keep rows as a pending part, named by its content."""
        content = _part_bytes(flight_frame(rows))
        name = f"part-{hashlib.sha256(content).hexdigest()[:24]}.parquet"
        self.check_run()
        with report_fleet_errors(self.folder):
            _write(self.folder / PENDING / name, content)

    def opened_rows(self, motion: str) -> pl.DataFrame:
        """`KEY_COLUMNS` of a motion's rows of logs that could be opened; a damaged part is set aside."""
        parts = [pl.DataFrame(schema=dict.fromkeys(KEY_COLUMNS, pl.String))]
        with report_fleet_errors(self.folder):
            for path in part_files(self.folder):
                content = path.read_bytes()
                if not is_sealed(content, {}):
                    _write(self.folder / f"damaged-{path.name}", content)
                    path.unlink()
                    return self.opened_rows(motion)  # what the part took in may be there still
                part = pl.read_parquet(io.BytesIO(content), columns=["motion", *KEY_COLUMNS])
                parts.append(part.filter(motion=motion).drop_nulls("sha256").select(KEY_COLUMNS))
        return pl.concat(parts)

    def replace_unopened(self, logs: pl.DataFrame, options: FleetOptions) -> None:
        """Write the rows of logs that could not be opened, in place of earlier ones of these logs."""
        path = self.folder / FLIGHTS / UNOPENED.format(motion=options.motion)
        pages = LogList(logs.filter(pl.col("sha256").is_null())).pages()
        frames = [
            flight_frame([failed_row(options.row_of(log), log.problem) for log in page]) for page in pages
        ]
        with report_fleet_errors(self.folder):
            if path.exists():
                frames.append(_read_part(path, None).join(logs, on="name", how="anti"))
            table = pl.concat([flight_frame([]), *frames], how="diagonal")
            self.check_run()
            if table.height:
                self._write_part(path, table, _column_types(set(table.columns)))
            else:
                path.unlink(missing_ok=True)

    def merge(self, motion: Motion[Any] | None = None) -> None:
        """Take pending and earlier parts into the table's, which all get the same columns.

        A part is replaced as a whole and says what it took in; that is removed only then. Wherever this
        ends, no row is lost, and none is read twice.
        """
        self.check_run()
        with report_fleet_errors(self.folder):
            files = part_files(self.folder)
            for path in set((self.folder / PENDING).glob(PART)).difference(files):
                path.unlink()
            columns = {path: list(pl.read_parquet_schema(_parquet(path))) for path in files}
            types = _column_types({name for names in columns.values() for name in names})
            patterns = _NUMBERED.pattern, UNOPENED.format(motion=".*")  # any other is taken into one of these
            final = [path for path in files if any(re.fullmatch(pattern, path.name) for pattern in patterns)]
            for path in final:
                if columns[path] != list(types):
                    self._write_part(path, _read_part(path, None), types, _merged(path))
            numbers = [int(match[1]) for path in final if (match := _NUMBERED.fullmatch(path.name))]
            sources = [path for path in files if path not in final]
            for number in chain(numbers, count(max(numbers, default=-1) + 1)):
                if not sources:
                    break
                path = self.folder / FLIGHTS / NUMBERED.format(number=number)
                sources = self._fill_part(path, sources, types)
            self._describe(types, motion)

    def _fill_part(self, path: Path, sources: list[Path], types: Mapping[str, Any]) -> list[Path]:
        """Fill a part from sources, and return the remaining sources."""
        existing = [pl.scan_parquet(_parquet(path), hive_partitioning=False)] if path.exists() else []
        rows, used = sum(part.select(pl.len()).collect().item() for part in existing), 0
        frames = [part.collect() for part in existing if rows < PART_ROWS]
        while rows < PART_ROWS and used < len(sources):
            frames.append(_read_part(sources[used], None))
            rows, used = rows + frames[-1].height, used + 1
        if used:
            names = [source.name for source in sources[:used]]
            self._write_part(path, pl.concat(frames, how="diagonal"), types, names)
            for source in sources[:used]:
                source.unlink(missing_ok=True)
        return sources[used:]

    def _write_part(
        self, path: Path, table: pl.DataFrame, types: Mapping[str, Any], merged: Sequence[str] = ()
    ) -> None:
        """Write a part atomically: no reader sees an incomplete file among the parts."""
        absent = [pl.lit(None, kind).alias(name) for name, kind in types.items() if name not in table.columns]
        complete = table.with_columns(absent).select(*types).sort(ORDER, nulls_last=True)
        content = _part_bytes(complete, {MERGED: " ".join(merged)})
        if not is_local(path):
            _write(path, content)
            return
        temporary = self.folder / PENDING / "merging.parquet"
        write_atomically(temporary, content)
        temporary.replace(path)

    def _describe(self, types: Mapping[str, Any], motion: Motion[Any] | None) -> None:
        path = self.folder / COLUMNS
        try:
            stored = dict(json.loads(path.read_text(encoding="utf-8"))["properties"])
        except (OSError, ValueError, LookupError, TypeError):
            stored = {}
        of_motion = {} if motion is None else motion.quantities
        fresh = {name for name in types if name not in stored or name.rpartition(".")[0] in of_motion}
        about = {**stored, **_column_words({name: types[name] for name in types if name in fresh}, motion)}
        document = {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": f"A row of {FLIGHTS}/{PART}, of the format {SCHEMA}",
            "type": "object",
            "properties": {name: about[name] for name in types},
        }
        if about != stored:
            _write(path, json.dumps(document, indent=2) + "\n")


def _write(path: Path, content: bytes | str) -> None:
    """Write a file whole or not at all; elsewhere every file is written so."""
    if is_local(path):
        write_atomically(path, content)
    else:
        path.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def _parquet(path: Path) -> Path | io.BytesIO:
    """What polars reads a part from: elsewhere its bytes."""
    return path if is_local(path) else io.BytesIO(path.read_bytes())


def _part_bytes(table: pl.DataFrame, facts: Mapping[str, str] | None = None) -> bytes:
    return sealed(table, {"eivor.fleet": SCHEMA, **(facts or {})})


def _versions_text(versions: Mapping[str, Any]) -> str:
    return ", ".join(f"{package} {number}" for package, number in versions.items())


#: Folder of the reports in that of the fleet.
REPORTS = "reports"
#: Key of a row, until it is written, that holds the page of its flight.
PAGE = "page"
_NAME = re.compile(r"([0-9a-f]{64})\.html")

#: What makes the page of a result.
PageOf: TypeAlias = Callable[[FlightEstimate], str]


def report_path(folder: Path, sha256: str) -> Path:
    """Where the report of a log is, by its hash and by nothing else that the log says."""
    return folder / REPORTS / f"{sha256}.html"


def write_report(folder: Path, sha256: str, page: str) -> None:
    """Write the report of a log."""
    position = report_path(folder, sha256)
    with report_fleet_errors(folder):
        position.parent.mkdir(exist_ok=True)
        _write(position, page)


def reports_there(folder: Path) -> Generator[str, None, None]:
    """Hashes of the logs that have a report, in any order; none are kept."""
    with report_fleet_errors(folder), suppress(FileNotFoundError):
        for entry in (folder / REPORTS).iterdir():
            match = _NAME.fullmatch(entry.name)
            if match is not None:
                yield match[1]


@dataclass(frozen=True, slots=True)
class RowOfLog:
    """The function from a log to its row."""

    options: FleetOptions
    page_of: PageOf | None = None

    def __call__(self, log: Log) -> dict[str, Any]:
        """Row of a log that could be opened; also of one without a result."""
        try:
            with here(log.path) as local:
                return self._made(replace(log, path=str(local)))
        except OSError as error:
            if not is_address(log.path):
                raise
            return failed_row(self.options.row_of(log), f"It cannot be fetched: {error}.")

    def _made(self, log: Log) -> dict[str, Any]:
        motion, about = self.options.chosen_motion(), self.options.row_of(log)
        try:
            names, maps = (log.name, log.name.rpartition("/")[2]), self.options.maps
            chosen = next((item for fit, item in maps if any(fnmatchcase(name, fit) for name in names)), None)
            takes_map = chosen is not None and format_at(Path(log.path)).takes_map
            recording = read_log(log.path, channel_map=chosen if takes_map else None)
            if recording.sha256 != log.sha256:
                return failed_row(about, "The file changed while the fleet was run: run it again.")
            about = {**about, **_of_recording(recording), **self._whose(log, recording)}
            result = identify_flight(recording, self.options.flight, model=motion)
        except EivorError as error:
            return failed_row(about, str(error))
        page = {} if self.page_of is None else {PAGE: self.page_of(result)}
        return {**about, **_of_result(result), **page}

    def _whose(self, log: Log, recording: Recording) -> dict[str, str]:
        """Vehicle and type: as the user says where it is said, else as the log does."""
        origin, whose = recording.origin, self.options.whose(log)
        results = {"vehicle": origin.board, "type": origin.airframe, **whose}
        if self.options.vehicle_from and not self.options.is_pattern and not whose:
            results["vehicle"] = _in_table(Path(log.path), self.options.vehicle_from) or origin.board
        return {key: text for key, text in results.items() if text}


def failed_row(about: Mapping[str, Any], reason: str) -> dict[str, Any]:
    """Row of a log without a result."""
    return {**about, "verdict": FAILED, "reason": reason}


def _of_recording(recording: Recording) -> dict[str, Any]:
    (start, end), origin = recording.span_s, recording.origin
    results = {"firmware": origin.firmware or None, "start": origin.start, "duration_s": end - start}
    for column in ("battery_voltage", "temperature", "air_density"):
        channel = recording.channels.get("air_temperature" if column == "temperature" else column)
        if channel is not None and np.isfinite(channel.values).any():
            results[column] = float(np.nanmean(channel.values))
    return results


def _of_result(result: FlightEstimate) -> dict[str, Any]:
    sentences = " ".join(result.verdict.sentences) or None
    row: dict[str, Any] = {"verdict": result.verdict.status.value, "reason": sentences}
    for name, quantity in result.quantities.items():
        numbers = (quantity.value, quantity.std_error, *quantity.interval)
        row |= {f"{name}.{part}": float(number) for part, number in zip(NUMBERS, numbers, strict=True)}
        row[f"{name}.{VERDICT}"] = quantity.verdict.value
    if result.fit is not None:
        row["covariance"] = result.covariance.ravel().tolist()
        row["covariance_names"] = list(result.names)
    row |= {f"{DIAGNOSTIC}{name}": float(value) for name, value in result.diagnostics.items()}
    return row


def _in_table(path: Path, column: str) -> str:
    """First text of a column of a log that is a table; empty when it has no such column."""
    with suppress(EivorError, OSError, pl.exceptions.PolarsError):
        kind = format_at(path).name
        if kind in ("csv", "parquet"):
            rows = pl.scan_csv(path, infer_schema=False) if kind == "csv" else pl.scan_parquet(path)
            text = rows.select(pl.col(column).drop_nulls().first()).collect().item()
            return "" if text is None else str(text)
    return ""


@dataclass(frozen=True)
class Fleet:
    """A fleet that `eivor fleet run` made."""

    folder: Path  # Where its files are

    @cached_property
    def flights(self) -> pl.DataFrame:
        """Every row: one for each log and motion, see `eivor.fleet.table`.

        Raises
        ------
        InputError
            When there is no such table, or it cannot be read.
        """
        return read_flights(self.folder)

    @property
    def quantities(self) -> pl.DataFrame:
        """Every quantity of every flight that has a result, one below the other.

        Returns
        -------
        polars.DataFrame
            `name`, `sha256`, `vehicle`, `type`, `motion`, `start`, `quantity`, `value`, `std_error`, `low`,
            `high` (SI units, 95 %; null where there is no number) and `verdict`.
        """
        table = self.flights
        about = ["name", "sha256", "vehicle", "type", "motion", "start"]
        parts = [
            table.filter(pl.col(f"{name}.{VERDICT}").is_not_null()).select(
                *about,
                pl.lit(name).alias("quantity"),
                *(pl.col(f"{name}.{part}").alias(part) for part in (*NUMBERS, VERDICT)),
            )
            for name in quantity_names(table)
        ]
        none = table.select(about).clear()
        columns = {"quantity": pl.String, **dict.fromkeys(NUMBERS, pl.Float64), VERDICT: pl.String}
        none = none.with_columns(pl.lit(None, kind).alias(name) for name, kind in columns.items())
        return pl.concat([none, *parts]).sort("motion", "name", "sha256", "quantity", nulls_last=True)


def open(folder: str | PathLike[str]) -> Fleet:
    """Open a fleet.

    Parameters
    ----------
    folder : str or path
        That `eivor fleet run` made; an address such as s3://bucket/fleet, too.

    Returns
    -------
    Fleet
        Its tables, read when they are first asked for.

    Raises
    ------
    InputError
        When the folder has no table of flights.
    UsageError
        When `folder` is no path.
    """
    checks.path("folder", folder)
    fleet = Fleet(path_of(os.fspath(folder)))
    read_flights(fleet.folder, ["name"])
    return fleet
