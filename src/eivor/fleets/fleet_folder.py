"""The folder of a fleet: whose rows these are, and parts of them, each whole or not there.

    fleet.json              options of each motion, and the versions that made the rows
    flights/part-*.parquet  rows, see `eivor.fleets.table`
    .lock, .run             one run at a time: the workers of one that was killed write nothing any more

A part is sealed (`eivor.studies.sealed_table`): one that was damaged is set aside, and its rows are made
anew. It is called after its rows, so that the same rows, made twice, are one file.
"""

from __future__ import annotations

import hashlib
import io
import json
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import polars as pl

from eivor.errors import InputError, UsageError
from eivor.fleets.fleet_options import FleetOptions
from eivor.fleets.ledger import SHARES
from eivor.fleets.table import FLIGHTS, Row, flight_frame, part_files
from eivor.studies.sealed_table import is_sealed, sealed, system_errors_told
from eivor.whole_file import remove_abandoned, write_whole

SCHEMA = "eivor.fleet/1"
IDENTITY, RUN = "fleet.json", ".run"
#: Packages whose versions bear on the rows.
PACKAGES = ("eivor", "numpy", "scipy", "polars")
#: Before the name of a part that was damaged.
DAMAGED = "damaged-"
#: Digits of a part's name.
NAME_DIGITS = 24
#: Parts of the logs that could not be opened, each of a share of them; written anew by every run.
UNOPENED = "part-unopened-{motion}-{share:02d}.parquet"
#: Columns that say what is there.
KEYS = ("name", "sha256", "verdict")

#: The system's error for a file of a fleet's folder, as one of Eivor's.
fleet_errors_told = partial(system_errors_told, of="fleet", kept="Rows that were written")


class SupersededError(Exception):
    """Another run has begun on the folder; what this one makes is not wanted any more."""


@dataclass(frozen=True, slots=True)
class FleetFolder:
    """Where a run writes its rows."""

    folder: Path  # absolute, the same for all workers
    run: str = ""  # mark of the run, see `begin`

    def begin(self) -> FleetFolder:
        """The folder for a new run, which ends the writing of all before it."""
        run = uuid.uuid4().hex
        with fleet_errors_told(self.folder):
            (self.folder / FLIGHTS).mkdir(parents=True, exist_ok=True)
            for place in (self.folder, self.folder / FLIGHTS):
                remove_abandoned(place)
            write_whole(self.folder / RUN, run)
        return FleetFolder(self.folder, run)

    def state(self, options: FleetOptions) -> None:
        """Write down whose rows these are; those of other motions stay."""
        versions = {package: version(package) for package in PACKAGES}
        before = self._document()
        if before is not None and before["versions"] != versions and part_files(self.folder):
            raise InputError(
                f"the versions that made the rows of '{self.folder}': {_listed(before['versions'])}",
                _listed(versions),
                "Rows of different versions need not agree, so they are never put together. Begin anew in "
                "another folder with -o, or install those versions.",
            )
        held = {} if before is None else before["options"]
        document = {
            "schema": SCHEMA,
            "versions": versions,
            "options": {**held, options.motion: {"hash": options.hash(), **options.document()}},
        }
        if document != before:
            with fleet_errors_told(self.folder):
                write_whole(self.folder / IDENTITY, json.dumps(document, indent=2) + "\n")

    def check(self, options: FleetOptions) -> None:
        """Refuse a folder that is not for these options."""
        folder = self.folder
        if folder.exists() and not folder.is_dir():
            raise UsageError("a folder for the fleet", f"the file '{folder}'", "Choose another with -o.")
        before = self._document()
        if before is None:
            if part_files(folder):
                raise UsageError(
                    "a new folder, or the folder of a fleet",
                    f"'{folder}', which has parts of flights and no {IDENTITY}",
                    "Choose another with -o.",
                )
            return
        held = before["options"].get(options.motion)
        if held is not None and held.get("hash") != options.hash():
            changed = [key for key, value in options.document().items() if held.get(key) != value]
            raise UsageError(
                f"a new folder, or the options that '{folder}' was begun with for the motion "
                f"'{options.motion}'",
                f"others ({', '.join(changed)})",
                "Rows of different options are never put together: choose another folder with -o, or give "
                f"those of {IDENTITY}.",
            )

    def _document(self) -> dict[str, Any] | None:
        """What the folder says of itself; None of a new one."""
        path = self.folder / IDENTITY
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError):
            document = None
        kinds = {"options": dict, "versions": dict}
        if (
            not isinstance(document, dict)
            or document.get("schema") != SCHEMA
            or not all(isinstance(document.get(key), kind) for key, kind in kinds.items())
        ):
            found = document.get("schema") if isinstance(document, dict) else None
            raise InputError(
                f"a folder of the format {SCHEMA}",
                f"'{path}' of {found!r}" if found else f"'{path}', which is another file",
                "Another version of Eivor made it: use that, or choose another folder with -o.",
            )
        return document

    def check_run(self) -> None:
        """Refuse to go on with a run that another one has followed."""
        try:
            now = (self.folder / RUN).read_text(encoding="utf-8")
        except OSError:
            now = ""
        if now != self.run:
            raise SupersededError

    def write(self, rows: Sequence[Row], options_hash: str, name: str = "") -> str:
        """Keep rows as a part, and give its name."""
        content = sealed(flight_frame(rows), _facts(options_hash))
        name = name or f"part-{hashlib.sha256(content).hexdigest()[:NAME_DIGITS]}.parquet"
        self.check_run()
        with fleet_errors_told(self.folder):
            write_whole(self.folder / FLIGHTS / name, content)
        return name

    def there(self, motion: str) -> Iterator[pl.DataFrame]:
        """`KEYS` of the rows of a motion that are there, part by part; a damaged one is set aside instead."""
        unopened = {self._unopened(motion, share).name for share in range(SHARES)}
        with fleet_errors_told(self.folder):
            for path in part_files(self.folder):
                content = path.read_bytes()
                if not is_sealed(content, {}):
                    path.rename(path.with_name(f"{DAMAGED}{path.name}"))
                elif path.name not in unopened:
                    part = pl.read_parquet(io.BytesIO(content), columns=["motion", *KEYS])
                    yield part.filter(pl.col("motion") == motion).select(KEYS)

    def replace_unopened(
        self, share: int, rows: Sequence[Row], is_given: Callable[[str], bool], options: FleetOptions
    ) -> None:
        """Write the rows of logs that could not be opened, in place of earlier ones."""
        path = self._unopened(options.motion, share)
        with fleet_errors_told(self.folder):
            before = pl.read_parquet(path).rows(named=True) if path.exists() else []
        now = [*rows, *(row for row in before if not is_given(row["name"]))]
        if now:
            self.write(now, options.hash(), path.name)
        else:
            with fleet_errors_told(self.folder):
                path.unlink(missing_ok=True)

    def _unopened(self, motion: str, share: int) -> Path:
        return self.folder / FLIGHTS / UNOPENED.format(motion=motion, share=share)


def _facts(options_hash: str) -> dict[str, str]:
    return {"eivor.fleet": SCHEMA, "eivor.options": options_hash}


def _listed(versions: Mapping[str, Any]) -> str:
    return ", ".join(f"{package} {number}" for package, number in versions.items())
