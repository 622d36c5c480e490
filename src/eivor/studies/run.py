"""Running a study: shards that are missing are computed, kept, and in the end gathered into one table."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from eivor.process_pool import Executor, InProcess, abandoned
from eivor.studies.study import Study
from eivor.studies.trial import TrialRecord, trial
from eivor.studies.trial_shards import open_folder, shard_trials

#: Called with the number of trials that are done, and that of all.
Progress = Callable[[int, int], None]


def no_progress(_done: int, _total: int, /) -> None:
    """Tell nobody how much is done."""


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
        for place, trials in results:
            shards.write(missing[place], trials)
            done += len(trials)
            progress(done, study.runs)
    return StudyResult(study, folder, shards.consolidate())
