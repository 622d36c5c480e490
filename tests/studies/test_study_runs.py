"""Folders of studies: what is written, what is refused, what survives, and the metrics of it."""

from __future__ import annotations

import json
import os
import shutil
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from eivor.atomic_file import ABANDONED_S, PREFIX, SUFFIX
from eivor.errors import InputError, UsageError
from eivor.lab.study import PARTS, Row, Share, StudyResult, run_study, schema, scores, trial_nrmse
from eivor.process_pool import Executor
from studies.study_parts import METHODS, content, small_study


@dataclass(frozen=True)
class Recorder(Executor):
    """In this process, backwards, keeping a list of what was asked for."""

    asked: list[int] = field(default_factory=list)
    stop_after: int = 1000

    def map(self, function, items):
        for count, (entry, item) in enumerate(reversed(list(enumerate(items)))):
            if count == self.stop_after:
                raise KeyboardInterrupt
            self.asked.append(item)
            yield entry, function(item)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run_study(small_study(), tmp_path_factory.mktemp("finished"))


@pytest.mark.thorough
def test_interrupted_and_resumed(finished, tmp_path):
    first = Recorder(stop_after=1)
    with pytest.raises(KeyboardInterrupt):
        run_study(small_study(), tmp_path, executor=first)
    second = Recorder()
    seen: list[tuple[int, int]] = []
    run_study(small_study(), tmp_path, executor=second, progress=lambda *now: seen.append(now))
    assert (first.asked, second.asked) == ([2], [1, 0])
    assert seen == [(10, 60), (35, 60), (60, 60)]
    assert content(tmp_path) == content(finished.folder)
    third = Recorder()
    run_study(small_study(), tmp_path, executor=third)
    assert third.asked == []


@pytest.mark.thorough
@pytest.mark.parametrize("part", np.linspace(0.0, 1.0, 12))
def test_a_flipped_byte_is_mended(finished, tmp_path, part):
    """Wherever it is in a shard, the next run computes that shard anew, and the table is the same."""
    shutil.copytree(finished.folder, tmp_path, dirs_exist_ok=True)
    shard = tmp_path / "shards" / "000001.parquet"
    damaged = bytearray(shard.read_bytes())
    damaged[int(part * (len(damaged) - 1))] ^= 0x10
    shard.write_bytes(damaged)
    recorder = Recorder()
    assert run_study(small_study(), tmp_path, executor=recorder).trials.equals(finished.trials)
    assert recorder.asked == [1]
    assert content(tmp_path) == content(finished.folder)


def test_a_decoders_panic_is_told(tmp_path, monkeypatch):
    """It is no Exception, and would end the program with a traceback."""

    def panic(*parts, **options):
        raise pl.exceptions.PanicException("index out of bounds")

    run_study(small_study(30), tmp_path)
    monkeypatch.setattr(pl, "read_parquet", panic)
    with pytest.raises(InputError, match="what the system says: index out of bounds"):
        run_study(small_study(30), tmp_path)


def test_another_study_is_refused(tmp_path):
    run_study(small_study(5), tmp_path)
    before = content(tmp_path)
    with pytest.raises(
        UsageError, match=r"received .* which holds the study 'small' with another experiment"
    ):
        run_study(small_study(5, seed=8), tmp_path)
    assert content(tmp_path) == before


@pytest.mark.thorough
def test_folders_that_are_not_a_studys(tmp_path):
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(UsageError, match="Expected a folder for the study; received the file"):
        run_study(small_study(5), tmp_path / "file")
    with pytest.raises(InputError, match="what the system says: Not a directory"):
        run_study(small_study(5), tmp_path / "file" / "folder")
    other = tmp_path / "other"
    other.mkdir()
    (other / "trials.parquet").write_bytes(b"precious")
    with pytest.raises(UsageError, match=r"which has trials and no study.json"):
        run_study(small_study(5), other)
    assert (other / "trials.parquet").read_bytes() == b"precious"
    for text in ("[]", "[" * 100_000, "1" * 5000, '"x'):
        (other / "study.json").write_text(text, encoding="utf-8")
        with pytest.raises(UsageError, match=r"Expected the study.json of a study"):
            run_study(small_study(5), other)


def of_another_version(folder):
    """Say in a study's folder that another version has made it; returns what its study.json says then."""
    path = folder / "study.json"
    document: dict[str, object] = json.loads(path.read_text(encoding="utf-8"))
    document["versions"] = dict(document["versions"]) | {"eivor": "0.0.9"}  # type: ignore[call-overload]
    path.write_text(json.dumps(document), encoding="utf-8")
    return document


def test_what_another_version_finished_is_looked_at_and_never_mixed(finished, tmp_path):
    """The folder goes on saying who made it, so that more runs are refused the second time as well."""
    shutil.copytree(finished.folder, tmp_path, dirs_exist_ok=True)
    another_version = of_another_version(tmp_path)
    recorder = Recorder()
    for name in ("small", "renamed"):
        result = run_study(small_study(name=name), tmp_path, executor=recorder)
        assert result.trials.equals(finished.trials)
    assert recorder.asked == []
    assert json.loads((tmp_path / "study.json").read_text(encoding="utf-8")) == another_version | {
        "name": "renamed"
    }
    kept = content(tmp_path)
    with pytest.raises(InputError, match=r"the versions that .* eivor 0\.0\.9, .*never put together"):
        run_study(small_study(90), tmp_path)
    assert content(tmp_path) == kept
    shard = tmp_path / "shards" / "000001.parquet"
    shard.write_bytes(shard.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"the versions that .* eivor 0\.0\.9, .*never put together"):
        run_study(small_study(), tmp_path)


def test_scores_by_hand():
    """Three trials with errors that can be reckoned in the head: truth (0.5, 2)."""
    study = small_study(4, methods=METHODS[:1], intervals=True)
    estimates = [(0.6, 2.0), (0.5, 1.8), (0.45, 2.4)]
    label = study.methods[0].label
    trials: list[Row] = [{"trial": 3, f"{label}.status": "failed", f"{label}.error": "EstimationError"}]
    for index, (a, b) in enumerate(estimates):
        row: Row = {"trial": index, f"{label}.status": "weak" if index else "identified"}
        numbers = [(a, 0.1, a - 0.1, a + 0.1), (b, 0.1, b - 0.1, b + 0.3)]
        for name, values in zip(study.parameters, numbers, strict=True):
            row |= {f"{label}.{name}{part}": value for part, value in zip(PARTS, values, strict=True)}
        trials.insert(index, row)
    result = StudyResult(study, Path(), pl.DataFrame(trials, schema=schema(study)))
    (results,) = scores(result)
    a, b = results.parameters
    assert (results.trials, results.failed, results.weak, results.first_failure) == (4, 1, 2, 3)
    assert a.nrmse.mean == pytest.approx(np.mean([20, 0, 10]))
    assert a.nrmse.std == pytest.approx(10.0)
    assert (a.bias, a.rmse) == pytest.approx((0.05 / 3, np.sqrt((0.1**2 + 0.05**2) / 3)))
    assert (b.bias, b.estimate.mean) == pytest.approx((0.2 / 3, 6.2 / 3))
    assert (a.coverage, b.coverage) == (Share(3, 3), Share(2, 3))
    length = np.hypot(0.5, 2.0)
    expected = 100.0 * np.hypot([0.1, 0.0, -0.05], [0.0, -0.2, 0.4]) / length
    np.testing.assert_allclose(trial_nrmse(result, "least_squares"), expected)
    assert (results.together.mean, results.together.std) == pytest.approx(
        (expected.mean(), expected.std(ddof=1))
    )


def test_what_a_killed_run_left_is_removed(tmp_path):
    """Half a file under a hidden name belongs to nobody; one that is being written is younger than that."""
    shards = tmp_path / "shards"
    shards.mkdir()
    left = [folder / f"{PREFIX}left{SUFFIX}" for folder in (tmp_path, shards)]
    young = shards / f"{PREFIX}young{SUFFIX}"
    for path in (*left, young):
        path.write_bytes(b"half")
    past = time.time() - 2.0 * ABANDONED_S
    for path in left:
        os.utime(path, (past, past))
    run_study(small_study(5), tmp_path)
    assert [path for path in (*left, young) if path.exists()] == [young]
