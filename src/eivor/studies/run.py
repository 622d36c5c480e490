"""Running a study: shards that are missing are computed, kept, and in the end gathered into one table."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from eivor.studies.executors import Executor, InProcess
from eivor.studies.study import Study
from eivor.studies.trial_shards import open_folder, shard_trials

#: Called with the number of trials that are done, and that of all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class StudyResult:
    """A finished study.

    Parameters
    ----------
    study : Study
        What was run.
    folder : Path
        Where its files are, see `eivor.studies.trial_shards`.
    trials : polars.DataFrame
        One row for each trial, in order.
    """

    study: Study
    folder: Path
    trials: pl.DataFrame


def run_study(
    study: Study,
    folder: Path,
    *,
    executor: Executor | None = None,
    progress: Progress = lambda done, total: None,  # noqa: ARG005 - names for readers
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
    with closing((executor or InProcess()).results(study, missing)) as results:
        for result in results:
            shards.write(result.number, result.trials)
            done += len(result.trials)
            progress(done, study.runs)
    return StudyResult(study, folder, shards.consolidate())
