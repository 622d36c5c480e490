"""A Monte Carlo study: its definition, trials, shards and metrics."""

from __future__ import annotations

import hashlib
import io
import json
import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl

from eivor import atomic_file, checks
from eivor.errors import EivorError, InputError, UsageError
from eivor.estimation import methods
from eivor.estimation.linear import SAME_COLUMN, LinearMethod, Method
from eivor.estimation.weighting import EquationWeighting
from eivor.inference import covariance as covariances
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.distributions import normal_quantile
from eivor.inference.verdict import Status
from eivor.lab.experiments import Experiment, Records, stream
from eivor.lab.regularised import ShrunkTowards, regularised
from eivor.linalg.total_least_squares import AugmentedTotalLeastSquares
from eivor.models.regression import Column, lags
from eivor.process_pool import Executor, InProcess, abandoned, local_executor
from eivor.signals.signals import Signals
from eivor.tools import Bool, Float, ItemsDone, no_items_callback

#: Methods that need no instruments.
DIRECT = ("least_squares", "total_least_squares", "bias_compensated_least_squares")
#: Methods with instruments whose equations can be weighted.
WEIGHTED = ("extended_iv", "generalized_iv")
#: Methods with instruments and a strength.
STRENGTHS = ("fuller", "generalized_fuller")
#: Methods that need instruments.
INSTRUMENTAL = (
    *(*WEIGHTED, "extended_iv_tls", "generalized_iv_tls", "liml", "generalized_liml", "spectral_giv"),
    *("spectral_giv_combined", "whittle_ml", "generalized_iv_unknown_noise"),
    *("bias_eliminating_least_squares", "frisch_scheme", *STRENGTHS),
)
#: Methods whose equations of many trials are solved at once.
PLAIN = (*DIRECT, *WEIGHTED, "extended_iv_tls", "generalized_iv_tls")
#: Every method of a study, by the name of its maker in `eivor.methods`.
METHODS = (*DIRECT, *INSTRUMENTAL)
WEIGHTINGS: Mapping[str, Callable[[], EquationWeighting]] = {
    "unweighted": methods.Unweighted,
    "two_stage": methods.TwoStage,
    "two_step_robust": methods.TwoStepRobust,
}
#: What regularisation may pull a solution towards.
TARGETS: Mapping[str, Method | None] = {"zero": None, "least_squares": methods.least_squares()}
#: Trials of a shard. Part of the format: a study that was begun with another number is not continued.
SHARD_TRIALS = 25
#: Of trials that are computed side by side there are more, up to so many, or so many samples.
MOST_SHARD_TRIALS, MOST_SHARD_SAMPLES = 1_000, 500_000
#: Largest number of runs: above it a study is more likely a mistake.
MOST_RUNS = 10_000_000


@dataclass(frozen=True, slots=True)
class Regularisation:
    """Tikhonov's regularisation of a method."""

    parameter: float | None = None
    towards: str = "zero"

    def __post_init__(self) -> None:
        checks.index_of("a vector to be shrunk towards", self.towards, TARGETS)
        regularised(methods.least_squares(), self.parameter)


@dataclass(frozen=True, slots=True)
class MethodChoice:
    """A method and its options in a study."""

    name: str  # One of `METHODS`
    # First and last lag of the instruments, both included; for methods that need them
    lags: tuple[int, int] | None = None
    channel: str = "input"  # Channel that the instruments are lags of
    weighting: str = "unweighted"  # Of the equations, one of `WEIGHTINGS`
    # Channels whose true noise the method is identified; None for all of them
    known_noise: tuple[str, ...] | None = None
    label: str = ""  # What results call it; default: its name
    # What intervals rest on: "default", or one of `eivor.inference.covariance.TABLE`
    covariance: str = "default"
    strength: float = 1.0  # Of `fuller` and `generalized_fuller`
    regularisation: Regularisation | None = None  # Tikhonov's, of a linear method; none by default

    def __post_init__(self) -> None:
        checks.index_of("a method", self.name, METHODS)
        checks.index_of("a weighting", self.weighting, WEIGHTINGS)
        checks.index_of("a covariance", self.covariance, ("default", *covariances.TABLE))
        if not self.label:
            object.__setattr__(self, "label", self.name)
        if (self.lags is None) != (self.name in DIRECT):
            expected = f"lags = [first, last] for {', '.join(INSTRUMENTAL)}, and for no other method"
            received = f"'{self.name}' with " + ("none" if self.lags is None else f"{list(self.lags)}")
            remedy = "The paper's extended IV has [1, 10], generalized IV [0, 10]."
            raise UsageError(expected, received, remedy)
        if self.lags is not None:
            lags(self.channel, *self.lags)
        for setting, value, usual, fitting in (
            ("weighting", self.weighting, "unweighted", WEIGHTED),
            ("strength", self.strength, 1.0, STRENGTHS),
        ):
            if value != usual and self.name not in fitting:
                text = f"'{value}'" if isinstance(value, str) else f"{value:g}"
                expected = f"a {setting} for {' or '.join(fitting)} only"
                raise UsageError(expected, f"{text} for '{self.name}'", "Leave it out.")
        method = self.method  # refuses a strength out of range, and what cannot be regularised
        if self.regularisation is not None and not isinstance(method, LinearMethod | ShrunkTowards):
            raise UsageError("a regularisation of a linear method", f"one of '{self.name}'", "Leave it out.")

    @property
    def method(self) -> Method:
        make: Callable[..., Method] = getattr(methods, self.name)
        if self.name in WEIGHTED:
            result = make(WEIGHTINGS[self.weighting]())
        else:
            result = make(self.strength) if self.name in STRENGTHS else make()
        if self.regularisation is None or not isinstance(result, LinearMethod):
            return result
        return regularised(result, self.regularisation.parameter, TARGETS[self.regularisation.towards])

    @property
    def is_plain(self) -> bool:
        """Whether trials of the method can be computed side by side."""
        return self.name in PLAIN and self.weighting == "unweighted" and self.regularisation is None

    @property
    def instruments(self) -> tuple[Column, ...]:
        return () if self.lags is None else lags(self.channel, *self.lags)


@dataclass(frozen=True, slots=True)
class Study:
    """A Monte Carlo study."""

    name: str  # What reports call it
    experiment: Experiment  # What each trial repeats
    methods: tuple[MethodChoice, ...]  # What is tried on each record, with labels of their own
    runs: int = 100  # Number of trials
    seed: int = 0  # Of all randomness; trial `index` draws from the seed sequence's child of that number
    intervals: bool = False  # Record standard errors and intervals as well
    level: float = 0.95  # Confidence level of the intervals

    def __post_init__(self) -> None:
        if not 1 <= self.runs <= MOST_RUNS:
            raise UsageError(f"runs from 1 to {MOST_RUNS}", f"{self.runs}", "Ask for a number of trials.")
        checks.seed(self.seed)
        checks.level(self.level)
        labels = [choice.label for choice in self.methods]
        if not labels or len(set(labels)) < len(labels) or any("." in label for label in labels):
            expected = "one method or more, with labels of their own that have no dot in them"
            remedy = 'Give a method that appears twice a label, such as label = "giv_20_lags".'
            raise UsageError(expected, f"labels {', '.join(labels) or 'of no method'}", remedy)
        for choice in self.methods:
            named = (choice.channel,) if choice.lags else ()
            for channel in (*named, *(choice.known_noise or ())):
                checks.index_of(f"a channel for '{choice.label}'", channel, self.experiment.channels)

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(self.experiment.truth)

    def rng(self, index: int) -> np.random.Generator:
        return stream(self.seed, index)

    @property
    def shard_trials(self) -> int:
        """Trials of a shard: more where they take microseconds."""
        alike = not self.intervals and all(choice.is_plain for choice in self.methods)
        largest = min(MOST_SHARD_TRIALS, MOST_SHARD_SAMPLES // self.experiment.samples)
        return max(SHARD_TRIALS, largest * alike)

    @property
    def identity(self) -> str:
        """Hash of everything that trials depend on: two studies of one identity have the same trials."""
        parts = (self.experiment, self.methods, self.parameters, self.seed, self.intervals, self.level)
        text = json.dumps(_plain(parts), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: object) -> object:
    """Value in terms of JSON, exact and with the kind of every object."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = {item.name: _plain(getattr(value, item.name)) for item in fields(value)}
        return {"kind": type(value).__name__} | parts
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, Enum):
        return {"kind": type(value).__name__, "value": value.value}
    if isinstance(value, float):
        return float(value).hex()
    if value is None or isinstance(value, bool | int | str):
        return value
    raise TypeError(f"a study cannot hold a {type(value).__name__}")


#: Status of a method that raised.
FAILED = "failed"

#: A row of the table of trials: a trial's number, and what each method did, by column; None for nothing.
Row = dict[str, int | float | str | None]
#: Parts of a parameter's result by the ends of their columns' names; without intervals the first alone.
PARTS = ("", ".std_error", ".low", ".high")


def trial(study: Study, index: int, known: Row | None = None) -> Row:
    """Compute a trial, a pure function of study and index: nothing in it is a time, say."""
    row: Row = dict.fromkeys(schema(study)) | {"trial": index} if known is None else known
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # weak instruments are recorded as a status
        record = cache(lambda: study.experiment.record(study.rng(index)))
        for choice in study.methods:
            if row[f"{choice.label}.status"] is not None:
                continue
            try:
                row |= _estimate(study, choice, record())
            except MemoryError:
                raise
            except Exception as error:  # noqa: BLE001 - whatever breaks a record or a method is its result
                row |= {f"{choice.label}.status": FAILED, f"{choice.label}.error": type(error).__name__}
    return row


def schema(study: Study) -> dict[str, Any]:
    """Columns of the table of trials."""
    columns: dict[str, Any] = {"trial": pl.Int64}
    for choice in study.methods:
        columns |= {f"{choice.label}.status": pl.String, f"{choice.label}.error": pl.String}
        for name in study.parameters:
            parts = PARTS if study.intervals else PARTS[:1]
            columns |= {f"{choice.label}.{name}{part}": pl.Float64 for part in parts}
    return columns


def failure(study: Study, index: int, label: str) -> str:
    """Return what a method of that label said when it failed in a trial, by computing it once more."""
    choice = next(choice for choice in study.methods if choice.label == label)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            _estimate(study, choice, study.experiment.record(study.rng(index)))
        except Exception as error:  # noqa: BLE001 - its message is what is asked for
            return f"{type(error).__name__}: {error}"
    return ""


def _estimate(study: Study, choice: MethodChoice, signals: Signals) -> Row:
    """Status and estimates of a method on a record."""
    if choice.known_noise is not None:
        signals = replace(signals, noise={name: signals.noise[name] for name in choice.known_noise})
    estimate = methods.identify(study.experiment.problem(signals, choice.instruments), choice.method)
    estimate = replace(estimate, doubts=None)  # Periods would cost each trial as much again
    if study.intervals and choice.covariance != "default":
        estimate = estimate.with_covariance(covariances.TABLE[choice.covariance]())
    row: Row = {f"{choice.label}.status": estimate.status.value}
    for name in study.parameters:
        values: tuple[float, ...] = (estimate.parameters[name],)
        if study.intervals:
            values += (estimate.std_error(name), *estimate.interval(name, study.level))
        row |= {f"{choice.label}.{name}{part}": value for part, value in zip(PARTS, values, strict=False)}
    return row


#: Numbers of a table of columns that is worked on at a time, as many as a cache holds.
CACHED = 400_000
#: Trials whose records are held at a time.
TRIALS_AT_ONCE = 250
#: Equations of a larger condition are solved one by one: ways agree to some times its product with rounding.
PLAIN_CONDITION = 1e3
#: Trials so near to a limit are solved one by one.
MARGIN = 1e-6

Stack = Float[np.ndarray, "trials _ _"]


def side_by_side(study: Study, numbers: Sequence[int]) -> list[Row]:
    """Trials solved together, equal to `trial` to rounding; `trial` computes those in doubt."""
    records, none = None, dict.fromkeys(schema(study))
    if len(numbers) > 1 and any(choice.is_plain for choice in study.methods) and not study.intervals:
        with suppress(EivorError, ArithmeticError, ValueError, LookupError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            records = study.experiment.records(study.seed, numbers)
    rows: list[Row] = [none | {"trial": number} for number in numbers]
    for choice in study.methods:
        if records is None or not choice.is_plain:
            continue
        solved = np.full((len(numbers), len(study.parameters)), np.nan)
        # whatever breaks all of them breaks each
        with suppress(EivorError, ArithmeticError, np.linalg.LinAlgError), np.errstate(all="ignore"):
            solved = _solve(study, choice, records)
        names = [f"{choice.label}.status", *(f"{choice.label}.{name}" for name in study.parameters)]
        for row, values in zip(rows, solved.tolist(), strict=True):
            if all(map(math.isfinite, values)):
                row.update(zip(names, (Status.IDENTIFIED.value, *values), strict=True))
    statuses = [f"{choice.label}.status" for choice in study.methods]
    return [
        trial(study, number, row) if None in map(row.get, statuses) else row
        for number, row in zip(numbers, rows, strict=True)
    ]


def _solve(study: Study, choice: MethodChoice, records: Records) -> Float[np.ndarray, "trials parameters"]:
    """Parameters of every trial by one method; NaN where a trial is in doubt."""
    method, (signals, channels) = cast("LinearMethod", choice.method), records
    if choice.known_noise is not None:
        signals = replace(signals, noise={name: signals.noise[name] for name in choice.known_noise})
    problem, assembler = study.experiment.problem(signals, choice.instruments), method.assembler
    unknowns, tested = len(problem.parameters), problem.instrument_count
    columns = (*problem.instrument_columns, *problem.regressor_columns, problem.equation.response)
    count = signals.sample_count - problem.first
    if problem.used is not None or count <= unknowns or any(c.gain_channel or not c.channel for c in columns):
        raise UsageError("columns of channels", "others", "They are computed one by one.")
    series = [(column.gain, channels[column.channel], problem.first - column.lag) for column in columns]
    trials, results = len(series[-1][1]), []
    table = np.empty((min(trials, max(1, CACHED // (count * len(columns)))), len(columns), count))
    for start in range(0, trials, len(table)):
        data = table[: trials - start]  # once for all: new memory takes longer than what is done with it
        for index, (gain, values, begin) in enumerate(series):
            data[:, index] = values[start : start + len(data), begin : begin + count]
            if gain != 1.0:
                data[:, index] *= gain
        if not assembler.moment_equations:
            root, sound = _root(data.swapaxes(1, 2)), np.ones(len(data), dtype=np.bool_)
            S = problem.declared_noise()
        else:
            # no array times itself: BLAS would take another way, which is slower for few columns
            products = data[:, : tested or unknowns] @ data.swapaxes(1, 2) / count
            gram = (data[:, tested:-1] @ data[:, tested:].swapaxes(1, 2) / count)[..., :-1]
            noise, cross = assembler.noise(problem), products[..., tested:]
            equations = cross if noise is None else cross - noise
            sound = _is_strong(products[..., : products.shape[1]], cross[..., :-1], gram, count, noise)
            if assembler.takes_out_own_noise:
                scale = 1.0 / np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
                scaled = scale[:, :, None] * equations[..., :-1] * scale[:, None]
                sound &= np.linalg.eigvalsh(scaled)[:, 0] > MARGIN
            root, S = _root(equations), None
        of_noise = isinstance(method.solver, AugmentedTotalLeastSquares)
        theta = _total_least_squares(root, S) if of_noise else _least_squares(root)
        results.append(np.where(sound[:, None], theta, np.nan))
    return np.concatenate(results)


def _root(equations: Stack) -> Stack:
    return np.asarray(np.linalg.qr(equations, mode="r"))


def _least_squares(root: Stack) -> Float[np.ndarray, "trials n"]:
    """Solutions of [R r]; NaN where R is ill conditioned."""
    n = root.shape[2] - 1
    lengths = np.linalg.norm(root[:, :, :n], axis=1)[:, None]
    inverse = np.linalg.inv(root[:, :n, :n] / lengths)
    condition = np.sqrt(n) * np.linalg.norm(inverse, axis=(1, 2))
    theta = (inverse @ root[:, :n, n:])[..., 0] / lengths[:, 0]
    return np.where(condition[:, None] < PLAIN_CONDITION, theta, np.nan)


def _total_least_squares(
    root: Stack, S: Float[np.ndarray, "n_plus_1 n_plus_1"] | None
) -> Float[np.ndarray, "trials n"]:
    """Solutions of [R r] whose columns have errors; NaN where they are hardly determined."""
    n = root.shape[2] - 1
    S = np.eye(n + 1) if S is None else S
    exact, noisy = np.flatnonzero(np.diag(S)[:-1] == 0.0), np.flatnonzero(np.diag(S) > 0.0)
    k, q = exact.size, noisy.size - 1
    unweighted = _least_squares(root)
    if noisy.size == 0 or k == n:
        return unweighted
    if noisy[-1] != n or root.shape[1] < n + 1:
        return np.full_like(unweighted, np.nan)
    ordered = _root(root[:, :, np.concatenate([exact, noisy])])
    L = np.linalg.cholesky(S[np.ix_(noisy, noisy)])
    remainder = _root(ordered[:, k:, k:] @ np.linalg.inv(L).T)
    smallest = np.linalg.svd(remainder, compute_uv=False)[:, -1:]
    U, singular, Vt = np.linalg.svd(remainder[:, :q, :q])
    gains = singular / ((singular - smallest) * (singular + smallest))
    projected = (U.swapaxes(1, 2) @ remainder[:, :q, q:])[..., 0]
    whitened = (Vt.swapaxes(1, 2) @ (gains * projected)[..., None])[..., 0]
    direction = (np.column_stack([whitened, -np.ones(len(remainder))])[:, None] @ np.linalg.inv(L))[:, 0]
    theta = np.empty((len(remainder), n))
    theta[:, noisy[:-1]] = -direction[:, :-1] / direction[:, -1:]
    if k:
        right = ordered[:, :k, n:] - ordered[:, :k, k:n] @ theta[:, noisy[:-1], None]
        theta[:, exact] = np.linalg.solve(ordered[:, :k, :k], right)[..., 0]
    return np.where((smallest < 0.9 * singular[:, -1:]) & np.isfinite(unweighted), theta, np.nan)


def _is_strong(
    instruments: Stack, cross: Stack, gram: Stack, rows: int, noise: Float[np.ndarray, "p n_plus_1"] | None
) -> Bool[np.ndarray, " trials"]:
    """Whether instruments are strong by a margin, and no noise is overstated."""
    available, count = cross.shape[1:]
    degrees = available - count + 1
    covariance = np.zeros(cross.shape[1:]) if noise is None else noise[:, :-1]
    if degrees < 1 or rows <= available:
        return np.zeros(len(cross), dtype=np.bool_)
    powers = np.diagonal(instruments, axis1=1, axis2=2)
    scale = np.sqrt(powers)[:, :, None]
    whitened = np.linalg.inv(instruments / (scale * scale.swapaxes(1, 2)))
    spread = np.trace(whitened, axis1=1, axis2=2)
    corrected, noises = (cross - covariance) / scale, covariance / scale
    projected = corrected.swapaxes(1, 2) @ whitened
    inverse = np.linalg.inv(projected @ corrected)
    explained = 1.0 / np.diagonal(inverse, axis1=1, axis2=2)
    total, mixed = (
        np.diagonal(inverse @ middle @ inverse, axis1=1, axis2=2) * explained**2
        for middle in (gram, projected @ noises)
    )
    unexplained = total - explained - 2.0 * mixed
    strong = explained / degrees > (1.0 + MARGIN) * STRONG_FIRST_STAGE * unexplained / (rows - available)
    squares = powers[:, :, None] * np.diagonal(gram, axis1=1, axis2=2)[:, None]
    same = cross**2 >= (1.0 - 2.0 * SAME_COLUMN) * squares
    overstated = same & (covariance * np.sign(cross) >= (1.0 - MARGIN) * np.abs(cross))
    sound = (spread > 0.0) & (spread < PLAIN_CONDITION**2)
    return sound & strong.all(axis=1) & ~overstated.any(axis=(1, 2))


#: Packages whose versions may change the results.
PACKAGES = ("eivor", "numpy", "scipy", "polars")
IDENTITY_FILE = "study.json"
TABLE_FILE = "trials.parquet"

#: The system's error for a file of a study's folder, as one of Eivor's.
report_study_errors = partial(atomic_file.report_system_errors, of="study", kept="Trials that were complete")


@dataclass(frozen=True, slots=True)
class TrialShards:
    """Shards of a study in a folder."""

    study: Study
    folder: Path

    @property
    def count(self) -> int:
        return -(-self.study.runs // self.study.shard_trials)

    def path(self, number: int) -> Path:
        return self.folder / "shards" / f"{number:06d}.parquet"

    def missing(self) -> list[int]:
        """Shards that are not there, or not whole, in order."""
        return [number for number in range(self.count) if not self._is_complete(number)]

    def _is_complete(self, number: int) -> bool:
        """Whether a shard's file holds its trials, to the bit."""
        try:
            return atomic_file.is_sealed(self.path(number).read_bytes(), self._facts(number))
        except OSError:
            return False

    def _facts(self, number: int) -> dict[str, str]:
        trials = shard_trials(self.study, number)
        return {"eivor.study": self.study.identity, "eivor.trials": f"{trials.start} to {trials.stop - 1}"}

    def _read(self, number: int) -> pl.DataFrame:
        content = self.path(number).read_bytes()
        if not atomic_file.is_sealed(content, self._facts(number)):
            remedy = "Something has changed it meanwhile: run the same again, and it is computed anew."
            raise InputError(f"'{self.path(number)}' as it was written", "other bytes", remedy)
        return pl.read_parquet(io.BytesIO(content))

    def write(self, number: int, trials: Sequence[Row]) -> None:
        table = pl.DataFrame(trials, schema=schema(self.study))
        with report_study_errors(self.folder):
            atomic_file.write_atomically(self.path(number), atomic_file.sealed(table, self._facts(number)))

    def consolidate(self) -> pl.DataFrame:
        """Make the table of all trials from the shards."""
        with report_study_errors(self.folder):
            # In two steps: thousands of small tables at once take many times the memory of one large one.
            groups = []
            group_size = atomic_file.GROUP_ROWS // self.study.shard_trials  # a row group's
            for start in range(0, self.count, group_size):
                numbers = range(start, min(self.count, start + group_size))
                groups.append(pl.concat([self._read(number) for number in numbers], rechunk=True))
            table = pl.concat(groups, rechunk=True)
            atomic_file.write_atomically(self.folder / TABLE_FILE, atomic_file.parquet_bytes(table))
        return table


def shard_trials(study: Study, number: int) -> range:
    """Trials of a shard."""
    size = study.shard_trials
    return range(number * size, min(study.runs, (number + 1) * size))


def open_folder(study: Study, folder: Path) -> TrialShards:
    """Folder for a study: new, or one in which this study was begun."""
    shards = TrialShards(study, folder)
    with report_study_errors(folder):
        if folder.exists() and not folder.is_dir():
            raise UsageError("a folder for the study", f"the file '{folder}'", "Choose another.")
        shards.path(0).parent.mkdir(parents=True, exist_ok=True)
        for path in (folder, shards.path(0).parent):
            atomic_file.remove_abandoned(path)
        document = {
            "name": study.name,
            "identity": study.identity,
            "shard_trials": study.shard_trials,
            "runs": study.runs,
            "versions": {package: version(package) for package in PACKAGES},
        }
        stored = _read_document(folder)
        if stored is not None:
            _check_same(shards, document, stored)
            document["versions"] = stored["versions"]  # those that computed the trials, whoever looks at them
        if document != stored:
            atomic_file.write_atomically(
                folder / IDENTITY_FILE, (json.dumps(document, indent=2) + "\n").encode()
            )
    return shards


def _read_document(folder: Path) -> Mapping[str, object] | None:
    path = folder / IDENTITY_FILE
    if not path.exists():
        if (folder / TABLE_FILE).exists() or any((folder / "shards").glob("*.parquet")):
            received = f"'{folder}', which has trials and no {IDENTITY_FILE}"
            raise UsageError("a new folder, or the folder of this study", received, "Choose another folder.")
        return None
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or not {"identity", "runs", "versions"} <= document.keys():
        expected = f"the {IDENTITY_FILE} of a study"
        raise UsageError(expected, f"'{path}', which is another file", "Choose another folder.")
    return document


def _check_same(shards: TrialShards, document: Mapping[str, object], stored: Mapping[str, object]) -> None:
    name = shards.folder
    if any(document[key] != stored.get(key) for key in ("identity", "shard_trials")):
        raise UsageError(
            f"a new folder, or one of the study '{shards.study.name}'",
            f"'{name}', which holds the study '{stored.get('name')}' with another experiment, other methods "
            "or another seed",
            "Choose another folder with --out, or delete this one.",
        )
    begun_runs, runs = stored["runs"], shards.study.runs
    if not isinstance(begun_runs, int) or begun_runs > runs:
        expected = f"at least {begun_runs} runs, as many as '{name}' was begun with"
        raise UsageError(expected, f"{runs}", "Ask for as many or more, or choose another folder.")
    if document["versions"] != stored["versions"] and shards.missing():
        raise InputError(
            f"the versions that '{name}' was begun with: {_versions_text(stored['versions'])}",
            _versions_text(document["versions"]),
            "Trials of different versions need not agree to the bit, so they are never put together. Begin "
            "anew in another folder with --out, delete this one, or install those versions.",
        )


def _versions_text(versions: object) -> str:
    pairs = versions.items() if isinstance(versions, dict) else ()
    return ", ".join(f"{package} {number}" for package, number in pairs)


@dataclass(frozen=True)
class StudyResult:
    """A finished study."""

    study: Study  # What was run
    folder: Path  # Where its files are, see `eivor.lab.study`
    trials: pl.DataFrame  # One row for each trial, in order


def _shard(study: Study, number: int) -> list[Row]:
    """Trials of a shard, in order; fewer of them when nobody waits for them any more."""
    trials: list[Row] = []
    every = shard_trials(study, number)
    step = TRIALS_AT_ONCE if study.shard_trials > SHARD_TRIALS else 1
    for start in range(0, len(every), step):
        if abandoned():
            break
        trials += side_by_side(study, every[start : start + step])
    return trials


#: Trials that take less time [s] in all are computed in this process: others take as long to begin.
WORTH_PROCESSES_S = 5.0


def study_executor(study: Study, workers: int | None) -> Executor:
    """Executor with that many workers, or with as many as the trials are worth."""
    if workers is None:
        for numbers in (range(1), range(min(study.runs, SHARD_TRIALS))):  # the first loads what they need
            start_s = time.perf_counter()
            side_by_side(study, numbers)
            trial_s = (time.perf_counter() - start_s) / len(numbers)
            if trial_s * SHARD_TRIALS > WORTH_PROCESSES_S:
                break
        if trial_s * study.runs < WORTH_PROCESSES_S:
            return InProcess()
    return local_executor(workers, tasks=-(-study.runs // study.shard_trials))


def run_study(
    study: Study, folder: Path, *, executor: Executor | None = None, progress: ItemsDone = no_items_callback
) -> StudyResult:
    """Run the shards of a study that are missing."""
    shards = open_folder(study, folder)
    missing = shards.missing()
    completed = study.runs - sum(len(shard_trials(study, number)) for number in missing)
    progress(completed, study.runs)
    with closing((executor or InProcess()).map(partial(_shard, study), missing)) as results:
        for index, trials in results:
            shards.write(missing[index], trials)
            completed += len(trials)
            progress(completed, study.runs)
    return StudyResult(study, folder, shards.consolidate())


@dataclass(frozen=True, slots=True)
class Share:
    """A share of trials, with its binomial error."""

    hits: int  # Successful trials
    count: int  # All trials
    level: float = 0.95  # Confidence level of the interval

    @property
    def value(self) -> float:
        """Hits per count; NaN without trials."""
        return self.hits / self.count if self.count else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the share, J. Am. Stat. Assoc. 22 (1927); (0, 1) of nothing."""
        if not self.count:
            return 0.0, 1.0
        z, n, p = normal_quantile(self.level), self.count, self.value
        centre = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return max(centre - half, 0.0), min(centre + half, 1.0)


#: What scores of all parameters together are called.
TOGETHER = "together"


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and sample standard deviation over trials; NaN where there are too few values."""

    mean: float
    std: float

    def __format__(self, digits: str) -> str:
        return f"{self.mean:{digits}} ± {self.std:.2g}"


@dataclass(frozen=True, slots=True)
class ParameterScore:
    """Errors of a method in one parameter."""

    name: str
    truth: float
    estimate: Spread
    nrmse: Spread
    bias: float
    rmse: float
    coverage: Share | None


@dataclass(frozen=True, slots=True)
class MethodScore:
    """Errors of a method."""

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
    """NRMSE of each trial in which a method gave an estimate, in percent."""
    truth = dict(result.study.experiment.truth)
    names = tuple(truth) if parameter == TOGETHER else (parameter,)
    solved = result.trials.filter(pl.col(f"{label}.status") != FAILED)
    errors = np.column_stack([solved[f"{label}.{name}"].to_numpy() - truth[name] for name in names])
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
        spread_of(trial_nrmse(result, label)),
    )


def _parameter_score(result: StudyResult, label: str, name: str) -> ParameterScore:
    truth = result.study.experiment.truth[name]
    solved = result.trials.filter(pl.col(f"{label}.status") != FAILED)
    values = solved[f"{label}.{name}"].to_numpy()
    error = spread_of(values - truth)
    coverage = None
    if result.study.intervals:
        low, high = (solved[f"{label}.{name}.{end}"].to_numpy() for end in ("low", "high"))
        coverage = Share(int(((low <= truth) & (truth <= high)).sum()), len(values))
    rmse = float(np.sqrt(np.mean((values - truth) ** 2))) if len(values) else float("nan")
    nrmse = spread_of(trial_nrmse(result, label, name))
    return ParameterScore(name, truth, spread_of(values), nrmse, error.mean, rmse, coverage)


def spread_of(values: Float[np.ndarray, " n"]) -> Spread:
    """Mean and standard deviation of values."""
    mean = float(values.mean()) if values.size else float("nan")
    return Spread(mean, float(values.std(ddof=1)) if values.size > 1 else float("nan"))
