"""A study's run: shards of trials, sealed tables and metrics."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import polars as pl

from eivor.atomic_file import remove_abandoned, write_atomically
from eivor.errors import InputError, UsageError
from eivor.inference.distributions import normal_quantile
from eivor.inference.verdict import Status
from eivor.lab.study import FAILED, Study, TrialRecord, trial
from eivor.process_pool import Executor, InProcess, abandoned
from eivor.tools import Float

# -- Sealed table --

#: Key of the checksum in the metadata, and how it is written there: Thrift's header of 64 bytes of text.
SEAL_KEY = "eivor.sha256"
SEAL_MARK = SEAL_KEY.encode() + b"\x18\x40"
SEAL_BYTES = 64
#: Rows of a row group.
GROUP_ROWS = 10_000


def sealed(table: pl.DataFrame, facts: Mapping[str, str]) -> bytes:
    """Parquet of a table, sealed. Equal tables and facts give equal bytes."""
    content = parquet_bytes(table, {SEAL_KEY: "0" * SEAL_BYTES, **facts})
    position = content.rindex(SEAL_MARK) + len(SEAL_MARK)
    return content[:position] + _checksum(content, position) + content[position + SEAL_BYTES :]


def is_sealed(content: bytes, facts: Mapping[str, str]) -> bool:
    """Whether these are the bytes that `sealed` made, of a table of these facts. Decodes no table."""
    position = content.rfind(SEAL_MARK) + len(SEAL_MARK)
    if position < len(SEAL_MARK) or content[position : position + SEAL_BYTES] != _checksum(content, position):
        return False
    result = pl.read_parquet_metadata(io.BytesIO(content))
    return all(result.get(key) == value for key, value in facts.items())


def parquet_bytes(table: pl.DataFrame, metadata: Mapping[str, str] | None = None) -> bytes:
    """Parquet with settings that are all fixed, so that equal tables give equal bytes."""
    buffer = io.BytesIO()
    table.write_parquet(
        buffer,
        compression="zstd",
        compression_level=3,
        statistics=False,
        row_group_size=GROUP_ROWS,
        metadata=dict(metadata) if metadata else None,
    )
    return buffer.getvalue()


def _checksum(content: bytes, position: int) -> bytes:
    """Hexadecimal digest of a file whose seal begins at `place`."""
    digest = hashlib.sha256(content[:position])
    digest.update(b"0" * SEAL_BYTES)
    digest.update(content[position + SEAL_BYTES :])
    return digest.hexdigest().encode()


@contextmanager
def report_system_errors(folder: Path, *, of: str, kept: str) -> Iterator[None]:
    """Turn the system's error for a file of a folder of tables into one of Eivor's."""
    try:
        yield
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"a folder '{folder}' that the {of} can be written to",
            f"what the system says: {reason}",
            f"{kept} are kept: make room, or repair it, and run the same again.",
        ) from error


# -- Trial shards --

#: Trials of a shard. Part of the format: a study that was begun with another number is not continued.
SHARD_TRIALS = 25
#: Packages whose versions bear on the bytes.
PACKAGES = ("eivor", "numpy", "scipy", "polars")
#: Parts of a parameter's record when intervals are requested, besides the value.
INTERVAL_PARTS = ("std_error", "low", "high")
IDENTITY_FILE = "study.json"
TABLE_FILE = "trials.parquet"

#: The system's error for a file of a study's folder, as one of Eivor's.
report_study_errors = partial(report_system_errors, of="study", kept="Trials that were complete")


@dataclass(frozen=True, slots=True)
class TrialShards:
    """Shards of a study in a folder."""

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
        """Trials of a shard."""
        content = self.path(number).read_bytes()
        if not is_sealed(content, self._facts(number)):
            raise InputError(
                f"'{self.path(number)}' as it was written",
                "other bytes",
                "Something has changed it meanwhile: run the same again, and it is computed anew.",
            )
        return pl.read_parquet(io.BytesIO(content))

    def write(self, number: int, trials: Sequence[TrialRecord]) -> None:
        """Keep the trials of a shard."""
        with report_study_errors(self.folder):
            write_atomically(self.path(number), sealed(frame(self.study, trials), self._facts(number)))

    def consolidate(self) -> pl.DataFrame:
        """Make the table of all trials from the shards."""
        with report_study_errors(self.folder):
            # In two steps: thousands of small tables at once take many times the memory of one large one.
            table = pl.concat(
                [
                    pl.concat([self._read(number) for number in group], rechunk=True)
                    for group in batched(range(self.count), GROUP_ROWS // SHARD_TRIALS)
                ],
                rechunk=True,
            )
            write_atomically(self.folder / TABLE_FILE, parquet_bytes(table))
        return table


def batched(numbers: range, size: int) -> Iterator[range]:
    """Successive parts of a range, each of `size` numbers but for the last."""
    for start in range(0, len(numbers), size):
        yield numbers[start : start + size]


def shard_trials(runs: int, number: int) -> range:
    """Trials of a shard."""
    return range(number * SHARD_TRIALS, min(runs, (number + 1) * SHARD_TRIALS))


def open_folder(study: Study, folder: Path) -> TrialShards:
    """Folder for a study: new, or one in which this study was begun."""
    shards = TrialShards(study, folder)
    with report_study_errors(folder):
        if folder.exists() and not folder.is_dir():
            raise UsageError("a folder for the study", f"the file '{folder}'", "Choose another.")
        shards.path(0).parent.mkdir(parents=True, exist_ok=True)
        for item in (folder, shards.path(0).parent):
            remove_abandoned(item)
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
            write_atomically(folder / IDENTITY_FILE, (json.dumps(document, indent=2) + "\n").encode())
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
        results = [record.methods[position] for record in trials]
        columns += [
            pl.Series(
                f"{choice.label}.{part}", [getattr(result, part) or None for result in results], pl.String
            )
            for part in ("status", "error")
        ]
        for index, name in enumerate(study.parameters):
            records = [result.parameters[index] if result.parameters else None for result in results]
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


# -- Run --

#: Called with the number of trials that are done, and that of all.
Progress = Callable[[int, int], None]


def no_progress(_done: int, _total: int, /) -> None:
    """Report to no one how much is done."""


@dataclass(frozen=True)
class StudyResult:
    """A finished study.

    Parameters
    ----------
    study : Study
        What was run.
    folder : Path
        Where its files are, see `eivor.lab.study_run`.
    trials : polars.DataFrame
        One row for each trial, in order.
    """

    study: Study
    folder: Path
    trials: pl.DataFrame


@dataclass(frozen=True, slots=True)
class ShardTrials:
    """The task of a study: from the number of a shard to its trials."""

    study: Study  # whose shards

    def __call__(self, number: int) -> tuple[TrialRecord, ...]:
        """Trials of a shard, in order; fewer of them when nobody waits for them any more."""
        trials = []
        for index in shard_trials(self.study.runs, number):
            if abandoned():
                break
            trials.append(trial(self.study, index))
        return tuple(trials)


def run_study(
    study: Study,
    folder: Path,
    *,
    executor: Executor | None = None,
    progress: Progress = no_progress,
) -> StudyResult:
    """Run what is left of a study.

    Parameters
    ----------
    study : Study
        What to run.
    folder : Path
        A new folder, or one in which this study was begun: its complete shards are not computed again.
    executor : Executor, optional
        Where to compute. Default: in this process. The files do not depend on it.
    progress : callable
        Called with done and total trials, first with what was there already.

    Returns
    -------
    StudyResult
        With all trials.

    Raises
    ------
    UsageError
        When the folder belongs to another study.
    InputError
        When a file cannot be written or a worker is lost. Complete shards are kept.

    Notes
    -----
    Memory: a few shards for each worker, and in the end the table of all trials.
    """
    shards = open_folder(study, folder)
    missing = shards.missing()
    done = study.runs - sum(len(shard_trials(study.runs, number)) for number in missing)
    progress(done, study.runs)
    with closing((executor or InProcess()).map(ShardTrials(study), missing)) as results:
        for item, trials in results:
            shards.write(missing[item], trials)
            done += len(trials)
            progress(done, study.runs)
    return StudyResult(study, folder, shards.consolidate())


# -- Share --


@dataclass(frozen=True, slots=True)
class Share:
    """A share of trials, with its binomial error.

    Parameters
    ----------
    hits, count : int
        Trials that did, and all.
    level : float
        Confidence level of the interval.
    """

    hits: int
    count: int
    level: float = 0.95

    @property
    def value(self) -> float:
        """Hits per count; NaN of nothing."""
        return self.hits / self.count if self.count else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the share; (0, 1) of nothing.

        Notation: z the normal quantile, n the count, p the share. Wilson (1927), J. Am. Stat. Assoc. 22.
        """
        if not self.count:
            return 0.0, 1.0
        z, n, p = normal_quantile(self.level), self.count, self.value
        centre = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return max(centre - half, 0.0), min(centre + half, 1.0)


# -- Metrics --

#: What scores of all parameters together are called.
TOGETHER = "together"


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and sample standard deviation; NaN where there are too few values.

    Parameters
    ----------
    mean, std : float
        Over trials.
    """

    mean: float
    std: float


@dataclass(frozen=True, slots=True)
class ParameterScore:
    """How a method did on one parameter."""

    name: str
    truth: float
    estimate: Spread
    nrmse: Spread
    bias: float
    rmse: float
    coverage: Share | None


@dataclass(frozen=True, slots=True)
class MethodScore:
    """How a method did."""

    label: str
    trials: int
    failed: int
    weak: int
    first_failure: int | None
    parameters: tuple[ParameterScore, ...]
    together: Spread  # NRMSE of the vector of parameters, in percent


def scores(result: StudyResult) -> tuple[MethodScore, ...]:
    """Score of each method of a study, in its order."""
    return tuple(_score(result, choice.label) for choice in result.study.methods)


def trial_nrmse(result: StudyResult, label: str, parameter: str = TOGETHER) -> Float[np.ndarray, " trials"]:
    """NRMSE of each trial in which a method gave an estimate, in percent: what histograms show.

    Parameters
    ----------
    result : StudyResult
        A finished study.
    label : str
        The method.
    parameter : str
        One parameter, or all of them together.
    """
    truth = dict(result.study.experiment.truth)
    names = tuple(truth) if parameter == TOGETHER else (parameter,)
    kept = result.trials.filter(pl.col(f"{label}.status") != FAILED)
    errors = np.column_stack([kept[f"{label}.{name}"].to_numpy() - truth[name] for name in names])
    size = np.linalg.norm([truth[name] for name in names])
    with np.errstate(divide="ignore", invalid="ignore"):  # a truth of zero has no relative error
        relative: Float[np.ndarray, " trials"] = 100.0 * np.linalg.norm(errors, axis=1) / size
    return relative


def _score(result: StudyResult, label: str) -> MethodScore:
    status = result.trials[f"{label}.status"]
    failed = result.trials.filter(status == FAILED)["trial"]
    return MethodScore(
        label,
        len(status),
        len(failed),
        int((status == Status.WEAK.value).sum()),
        int(failed[0]) if len(failed) else None,
        tuple(_parameter_score(result, label, name) for name in result.study.parameters),
        _spread(trial_nrmse(result, label)),
    )


def _parameter_score(result: StudyResult, label: str, name: str) -> ParameterScore:
    truth = result.study.experiment.truth[name]
    kept = result.trials.filter(pl.col(f"{label}.status") != FAILED)
    values = kept[f"{label}.{name}"].to_numpy()
    error = _spread(values - truth)
    coverage = None
    if result.study.intervals:
        low, high = (kept[f"{label}.{name}.{end}"].to_numpy() for end in ("low", "high"))
        coverage = Share(int(((low <= truth) & (truth <= high)).sum()), len(values))
    rmse = float(np.sqrt(np.mean((values - truth) ** 2))) if len(values) else float("nan")
    nrmse = _spread(trial_nrmse(result, label, name))
    return ParameterScore(name, truth, _spread(values), nrmse, error.mean, rmse, coverage)


def _spread(values: Float[np.ndarray, " n"]) -> Spread:
    nan = float("nan")
    return Spread(
        float(values.mean()) if values.size else nan,
        float(values.std(ddof=1)) if values.size > 1 else nan,
    )
