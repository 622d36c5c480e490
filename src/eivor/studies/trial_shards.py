"""The files of a study: a folder with its identity, shards of trials, and all trials in one table.

    study.json              whose trials these are, and what computed them
    shards/000007.parquet   trials [7 n, 8 n) for n = `SHARD_TRIALS`, the last shard may be shorter
    trials.parquet          all of them, in order

A row is a trial: its number, and for each method LABEL.status, LABEL.error and LABEL.PARAMETER, with
LABEL.PARAMETER.std_error, .low and .high when the study asks for intervals; null where a method failed.
Files appear under their names only when they are whole, and the same trials give the same bytes. A shard is
sealed (`eivor.studies.sealed_table`): one that was damaged, or belongs elsewhere, counts as missing.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

import polars as pl

from eivor.errors import InputError, UsageError
from eivor.studies.sealed_table import GROUP_ROWS, is_sealed, parquet_bytes, sealed, system_errors_told
from eivor.studies.study import Study
from eivor.studies.trial import TrialRecord
from eivor.whole_file import remove_abandoned, write_whole

#: Trials of a shard. Part of the format: a study that was begun with another number is not continued.
SHARD_TRIALS = 25
#: Packages whose versions bear on the bytes.
PACKAGES = ("eivor", "numpy", "scipy", "polars")
#: Parts of a parameter's record when intervals are asked for, besides the value.
INTERVAL_PARTS = ("std_error", "low", "high")
IDENTITY_FILE = "study.json"
TABLE_FILE = "trials.parquet"

#: The system's error for a file of a study's folder, as one of Eivor's.
study_errors_told = partial(system_errors_told, of="study", kept="Trials that were complete")


@dataclass(frozen=True, slots=True)
class TrialShards:
    """Shards of a study in a folder.

    Parameters
    ----------
    study : Study
        Whose trials.
    folder : Path
        Where.
    """

    study: Study
    folder: Path

    @property
    def count(self) -> int:
        """Number of shards."""
        return -(-self.study.runs // SHARD_TRIALS)

    def path(self, number: int) -> Path:
        """File of a shard."""
        return self.folder / "shards" / f"{number:06d}.parquet"

    @property
    def tables(self) -> tuple[Path, Path]:
        """What stands beside the shards: the identity, and the table of all trials."""
        return self.folder / IDENTITY_FILE, self.folder / TABLE_FILE

    def missing(self) -> list[int]:
        """Shards that are not there, or not whole, in order."""
        return [number for number in range(self.count) if not self._whole(number)]

    def _whole(self, number: int) -> bool:
        """Whether a shard's file holds its trials, to the bit."""
        try:
            return is_sealed(self.path(number).read_bytes(), self._facts(number))
        except OSError:
            return False

    def _facts(self, number: int) -> dict[str, str]:
        """What the seal of a shard says: whose trials, and which."""
        trials = shard_trials(self.study.runs, number)
        return {"eivor.study": self.study.identity, "eivor.trials": f"{trials.start} to {trials.stop - 1}"}

    def _read(self, number: int) -> pl.DataFrame:
        """Trials of a shard.

        Raises
        ------
        InputError
            When it is not whole.
        """
        content = self.path(number).read_bytes()
        if not is_sealed(content, self._facts(number)):
            raise InputError(
                f"'{self.path(number)}' as it was written",
                "other bytes",
                "Something has changed it meanwhile: run the same again, and it is computed anew.",
            )
        return pl.read_parquet(io.BytesIO(content))

    def write(self, number: int, trials: Sequence[TrialRecord]) -> None:
        """Keep the trials of a shard.

        Raises
        ------
        InputError
            When the system refuses, for example because the disk is full. What was complete stays.
        """
        with study_errors_told(self.folder):
            write_whole(self.path(number), sealed(frame(self.study, trials), self._facts(number)))

    def consolidate(self) -> pl.DataFrame:
        """Make the table of all trials from the shards.

        Raises
        ------
        InputError
            When the system refuses, or a shard is not whole.
        """
        with study_errors_told(self.folder):
            # In two steps: thousands of small tables at once take many times the memory of one large one.
            table = pl.concat(
                [
                    pl.concat([self._read(number) for number in group], rechunk=True)
                    for group in batched(range(self.count), GROUP_ROWS // SHARD_TRIALS)
                ],
                rechunk=True,
            )
            write_whole(self.folder / TABLE_FILE, parquet_bytes(table))
        return table


def batched(numbers: range, size: int) -> Iterator[range]:
    """Successive parts of a range, each of `size` numbers but for the last."""
    for start in range(0, len(numbers), size):
        yield numbers[start : start + size]


def shard_trials(runs: int, number: int) -> range:
    """Trials of a shard."""
    return range(number * SHARD_TRIALS, min(runs, (number + 1) * SHARD_TRIALS))


def open_folder(study: Study, folder: Path) -> TrialShards:
    """Folder for a study: new, or one in which this study was begun.

    Raises
    ------
    UsageError
        When it holds another study, more runs than asked for, or files that are not a study's.
    InputError
        When it cannot be read or written, or when trials are missing and others were computed by other
        versions.
    """
    shards = TrialShards(study, folder)
    with study_errors_told(folder):
        if folder.exists() and not folder.is_dir():
            raise UsageError("a folder for the study", f"the file '{folder}'", "Choose another.")
        shards.path(0).parent.mkdir(parents=True, exist_ok=True)
        for place in (folder, shards.path(0).parent):
            remove_abandoned(place)
        document = {
            "name": study.name,
            "identity": study.identity,
            "shard_trials": SHARD_TRIALS,
            "runs": study.runs,
            "versions": {package: version(package) for package in PACKAGES},
        }
        before = _document(folder)
        if before is not None:
            _check_same(shards, document, before)
            document["versions"] = before["versions"]  # those that computed the trials, whoever looks at them
        if document != before:
            write_whole(folder / IDENTITY_FILE, (json.dumps(document, indent=2) + "\n").encode())
    return shards


def _document(folder: Path) -> Mapping[str, object] | None:
    path = folder / IDENTITY_FILE
    if not path.exists():
        if (folder / TABLE_FILE).exists() or any((folder / "shards").glob("*.parquet")):
            raise UsageError(
                "a new folder, or the folder of this study",
                f"'{folder}', which has trials and no {IDENTITY_FILE}",
                "Choose another folder.",
            )
        return None
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or not {"identity", "runs", "versions"} <= document.keys():
        raise UsageError(
            f"the {IDENTITY_FILE} of a study", f"'{path}', which is another file", "Choose another folder."
        )
    return document


def _check_same(shards: TrialShards, document: Mapping[str, object], before: Mapping[str, object]) -> None:
    name = shards.folder
    if any(document[key] != before.get(key) for key in ("identity", "shard_trials")):
        raise UsageError(
            f"a new folder, or one of the study '{shards.study.name}'",
            f"'{name}', which holds the study '{before.get('name')}' with another experiment, other methods "
            "or another seed",
            "Choose another folder with --out, or delete this one.",
        )
    held = before["runs"]
    if not isinstance(held, int) or held > shards.study.runs:
        raise UsageError(
            f"at least {held} runs, as many as '{name}' was begun with",
            f"{shards.study.runs}",
            "Ask for as many or more, or choose another folder.",
        )
    if document["versions"] != before["versions"] and shards.missing():
        raise InputError(
            f"the versions that '{name}' was begun with: {_listed(before['versions'])}",
            _listed(document["versions"]),
            "Trials of different versions need not agree to the bit, so they are never put together. Begin "
            "anew in another folder with --out, delete this one, or install those versions.",
        )


def _listed(versions: object) -> str:
    pairs = versions.items() if isinstance(versions, dict) else ()
    return ", ".join(f"{package} {number}" for package, number in pairs)


def frame(study: Study, trials: Sequence[TrialRecord]) -> pl.DataFrame:
    """Trials as a table."""
    columns = [pl.Series("trial", [record.index for record in trials], pl.Int64)]
    for position, choice in enumerate(study.methods):
        found = [record.methods[position] for record in trials]
        columns += [
            pl.Series(f"{choice.label}.{part}", [getattr(one, part) or None for one in found], pl.String)
            for part in ("status", "error")
        ]
        for place, name in enumerate(study.parameters):
            records = [one.parameters[place] if one.parameters else None for one in found]
            stem = f"{choice.label}.{name}"
            columns += [
                pl.Series(
                    stem if part == "value" else f"{stem}.{part}",
                    [None if record is None else getattr(record, part) for record in records],
                    pl.Float64,
                )
                for part in ("value", *(INTERVAL_PARTS if study.intervals else ()))
            ]
    return pl.DataFrame(columns)
