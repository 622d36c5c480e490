"""The paper's study: examples 1 and 2 under each named reading, beside the tables that it prints.

Trial `index` draws from the same stream under every reading and in both examples, so that readings differ
by what they say and not by chance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from eivor.errors import UsageError
from eivor.process_pool import in_order, local_executor
from eivor.shapes import Bool, Float
from eivor.studies.metrics import Spread
from eivor.studies.paper.readings import EXAMPLES, METHODS, PRINTED_METHODS, TRUTH, Example, Reading
from eivor.studies.paper.trials import estimates, nrmse, record

SEED = 20240513
#: Standard errors within which a measured mean agrees with a printed one.
AGREEMENT = 3.0
#: Runs behind the printed tables.
PRINTED_RUNS = 100


@dataclass(frozen=True, slots=True)
class PaperResult:
    """What came out of one example under one reading.

    Parameters
    ----------
    reading : Reading
        The reading.
    example : Example
        The example.
    estimates : ndarray, shape (runs, methods, parameters)
        In the order of `METHODS`; NaN where a method gave none.
    weak : ndarray, shape (runs, methods)
        Whether a method's instruments were weak.
    """

    reading: Reading
    example: Example
    estimates: Float[np.ndarray, "runs methods parameters"]
    weak: Bool[np.ndarray, "runs methods"]

    def nrmse(self, method: str) -> Float[np.ndarray, "runs scores"]:
        """NRMSE in percent of each run in which the method gave an estimate, in the order of `SCORES`."""
        found = self.estimates[:, METHODS.index(method)]
        return nrmse(found[np.isfinite(found).all(axis=1)])

    def failed(self, method: str) -> int:
        """Runs in which the method gave no estimate."""
        return len(self.estimates) - len(self.nrmse(method))

    def weak_runs(self, method: str) -> int:
        """Runs in which the method's instruments were weak."""
        return int(self.weak[:, METHODS.index(method)].sum())

    def spreads(self, method: str) -> tuple[Spread, ...]:
        """Mean and SD of each score; NaN where there are too few runs."""
        scores = self.nrmse(method)
        nan = np.full(scores.shape[1], np.nan)
        means = scores.mean(axis=0) if len(scores) else nan
        stds = scores.std(axis=0, ddof=1) if len(scores) > 1 else nan
        return tuple(Spread(float(mean), float(std)) for mean, std in zip(means, stds, strict=True))


@dataclass(frozen=True, slots=True)
class Nearness:
    """How far a reading is from the printed tables.

    Parameters
    ----------
    means, spreads : float
        Typical factor between measured and printed means, and SDs, of NRMSE: exp of the mean of
        |log(measured / printed)| over examples, columns and parameters.
    agreeing, printed : int
        Printed means that the measured ones agree with to `AGREEMENT` standard errors, and how many
        there are.
    """

    means: float
    spreads: float
    agreeing: int
    printed: int


def run_example(reading: Reading, example: Example, runs: int, seed: int = SEED) -> PaperResult:
    """Result of some runs of an example under a reading, on one thread.

    Parameters
    ----------
    reading, example : Reading, Example
        What to run.
    runs : int
        Number of runs.
    seed : int
        Run `index` draws from the seed sequence's child of that number.
    """
    return run_together((reading,), example, runs, seed)[0]


def run_together(
    readings: Sequence[Reading], example: Example, runs: int, seed: int = SEED
) -> list[PaperResult]:
    """Results under readings that have their records in common, see `Reading.records`."""
    theta = np.empty((len(readings), runs, len(METHODS), len(TRUTH)))
    weak = np.empty((len(readings), runs, len(METHODS)), dtype=np.bool_)
    with threadpool_limits(limits=1):
        for index in range(runs):
            signals = record(readings[0], example, trial_generator(index, seed)).signals
            for place, reading in enumerate(readings):
                found = estimates(reading, signals)
                theta[place, index], weak[place, index] = found.theta, found.weak
    return [
        PaperResult(reading, example, *parts) for reading, *parts in zip(readings, theta, weak, strict=True)
    ]


def trial_generator(index: int, seed: int = SEED) -> np.random.Generator:
    """Generator of one run."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(index,))))


def run_paper(
    readings: Sequence[Reading], *, runs: int, seed: int = SEED, workers: int | None = None
) -> Iterator[PaperResult]:
    """Results of every reading in their order, example 1 before example 2, as they are done.

    Parameters
    ----------
    readings : sequence of Reading
        Which.
    runs : int
        Runs of each.
    seed : int
        See `run_example`.
    workers : int, optional
        Processes; default one for each core, and none but this for a single core.

    Raises
    ------
    UsageError
        When there are fewer than two runs: a standard deviation needs two.
    """
    if runs < 2:
        raise UsageError("two runs or more", f"{runs}", "The paper has 100.")
    return _results(readings, runs, seed, workers)


def _results(readings: Sequence[Reading], runs: int, seed: int, workers: int | None) -> Iterator[PaperResult]:
    groups: dict[Reading, list[Reading]] = {}
    for reading in readings:
        groups.setdefault(reading.records, []).append(reading)
    tasks = [(tuple(group), example) for group in groups.values() for example in EXAMPLES]
    waiting = [(reading, example) for reading in readings for example in EXAMPLES]
    done: dict[tuple[str, int], PaperResult] = {}
    computed = local_executor(workers, len(tasks)).map(partial(_run_task, runs=runs, seed=seed), tasks)
    with closing(in_order(computed)) as groups_done:
        for results in groups_done:
            done |= {(result.reading.name, result.example.number): result for result in results}
            while waiting and (waiting[0][0].name, waiting[0][1].number) in done:
                reading, example = waiting.pop(0)
                yield done[reading.name, example.number]


def _run_task(task: tuple[tuple[Reading, ...], Example], runs: int, seed: int) -> list[PaperResult]:
    return run_together(*task, runs, seed)


def nearness(results: Sequence[PaperResult], *, total_least_squares: bool = False) -> Nearness:
    """How far both examples of one reading are from the printed tables.

    Parameters
    ----------
    results : sequence of PaperResult
        Of one reading.
    total_least_squares : bool
        Take the forms of IV and GIV that are solved by total least squares, as the paper proposes; its
        tables do not say which they show.
    """
    pairs = [
        (spread, printed, len(result.nrmse(method)))
        for result in results
        for shown in PRINTED_METHODS.values()
        for method in (solved_by(shown, total_least_squares=total_least_squares),)
        for spread, printed in zip(result.spreads(method)[:2], result.example.printed[shown][:2], strict=True)
    ]
    agreeing = sum(_agrees(spread, printed, runs) for spread, printed, runs in pairs)
    return Nearness(
        _factor([(spread.mean, printed.mean) for spread, printed, _ in pairs]),
        _factor([(spread.std, printed.std) for spread, printed, _ in pairs]),
        agreeing,
        len(pairs),
    )


def solved_by(method: str, *, total_least_squares: bool) -> str:
    """Instrumental method as the tables may mean it; least squares is what it is."""
    return f"{method}_tls" if total_least_squares and method.endswith("_iv") else method


def _agrees(measured: Spread, printed: Spread, runs: int) -> bool:
    error = np.sqrt(measured.std**2 / max(runs, 1) + printed.std**2 / PRINTED_RUNS)
    return bool(abs(measured.mean - printed.mean) <= AGREEMENT * error)


def _factor(pairs: list[tuple[float, float]]) -> float:
    if any(not measured > 0.0 for measured, _ in pairs):
        return float("inf")
    return float(np.exp(np.mean([abs(np.log(measured / printed)) for measured, printed in pairs])))
