"""Folders of studies: what is written, what is refused, what survives, and the metrics of it."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.stats import binomtest

import eivor as ev
from eivor.atomic_file import ABANDONED_S, PREFIX, SUFFIX
from eivor.dask_executor import DaskCluster
from eivor.errors import InputError, ParameterError, UsageError
from eivor.lab import paper
from eivor.lab import study as lab_study
from eivor.lab.experiments import DifferenceEquation, VerticalExperiment, streams
from eivor.lab.records import Scenario
from eivor.lab.scenario_files import method_choice, read_study, shipped_scenario
from eivor.lab.study import MethodChoice, Regularisation, run_study
from eivor.process_pool import (
    TASKS_PER_WORKER,
    Executor,
    InProcess,
    Limits,
    LocalProcesses,
    LocalThreads,
    local_executor,
)
from eivor.signals.noise import FractionalNoise, WhiteNoise
from eivor.simulation.excitation import PseudoRandomBinary, WhiteDisturbance, WhiteExcitation
from eivor.strict_toml import read_toml
from refusal_rows import calls, rows, table, without
from studies.study_parts import EQUATION, METHODS, Coin, Patient, content, small_study
from validation.coverage.study import read_coverage
from validation.flight_recipe.trials import read_trial_table
from worker_answers import PATIENCE_S, SOURCES, Arriving, answered, refusing, text_of, wait_until


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


def test_another_study_is_refused(tmp_path):
    run_study(small_study(5), tmp_path)
    before = content(tmp_path)
    with pytest.raises(UsageError, match=r"received .* which holds the study 'small' with another exper"):
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
    document = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert document == another_version | {"name": "renamed"}
    kept, refusal = content(tmp_path), r"the versions that .* eivor 0\.0\.9, .*never put together"
    with pytest.raises(InputError, match=refusal):
        run_study(small_study(90), tmp_path)
    assert content(tmp_path) == kept
    shard = tmp_path / "shards" / "000001.parquet"
    shard.write_bytes(shard.read_bytes()[:-1])
    with pytest.raises(InputError, match=refusal):
        run_study(small_study(), tmp_path)


def test_scores_by_hand():
    """Three trials with errors that can be reckoned in the head: truth (0.5, 2)."""
    study = small_study(4, methods=METHODS[:1], intervals=True)
    estimates = [(0.6, 2.0), (0.5, 1.8), (0.45, 2.4)]
    label = study.methods[0].label
    trials: list[lab_study.Row] = [
        {"trial": 3, f"{label}.status": "failed", f"{label}.error": "EstimationError"}
    ]
    for index, (a, b) in enumerate(estimates):
        row: lab_study.Row = {"trial": index, f"{label}.status": "weak" if index else "identified"}
        numbers = [(a, 0.1, a - 0.1, a + 0.1), (b, 0.1, b - 0.1, b + 0.3)]
        for name, values in zip(study.parameters, numbers, strict=True):
            row |= {
                f"{label}.{name}{part}": value for part, value in zip(lab_study.PARTS, values, strict=True)
            }
        trials.insert(index, row)
    result = lab_study.StudyResult(study, Path(), pl.DataFrame(trials, schema=lab_study.schema(study)))
    (results,) = lab_study.scores(result)
    a, b = results.parameters
    assert (results.trials, results.failed, results.weak, results.first_failure) == (4, 1, 2, 3)
    assert (a.nrmse.mean, a.nrmse.std) == (pytest.approx(np.mean([20, 0, 10])), pytest.approx(10.0))
    assert (a.bias, a.rmse) == pytest.approx((0.05 / 3, np.sqrt((0.1**2 + 0.05**2) / 3)))
    assert (b.bias, b.estimate.mean) == pytest.approx((0.2 / 3, 6.2 / 3))
    assert (a.coverage, b.coverage) == (lab_study.Share(3, 3), lab_study.Share(2, 3))
    length = np.hypot(0.5, 2.0)
    expected = 100.0 * np.hypot([0.1, 0.0, -0.05], [0.0, -0.2, 0.4]) / length
    np.testing.assert_allclose(lab_study.trial_nrmse(result, "least_squares"), expected)
    together = results.together
    assert (together.mean, together.std) == pytest.approx((expected.mean(), expected.std(ddof=1)))


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


# Studies, their trials and equations: what they refuse, what a trial depends on, shares of trials.


def test_a_trial_depends_on_study_and_index_only():
    study = small_study()
    first = lab_study.trial(study, 5)
    lab_study.trial(study, 4)
    assert lab_study.trial(study, 5) == first
    assert lab_study.trial(replace(study, runs=1000), 5) == first
    assert lab_study.trial(replace(study, seed=8), 5) != first
    assert lab_study.trial(study, 6) | {"trial": 5} != first


@pytest.mark.parametrize(
    ("choice", "method"),
    [
        (METHODS[2], ev.methods.generalized_iv(ev.methods.TwoStage())),
        (replace(METHODS[2], covariance="classical"), ev.methods.generalized_iv(ev.methods.TwoStage())),
        (
            MethodChoice("generalized_iv", (0, 5), regularisation=Regularisation(0.3)),
            ev.methods.regularised(ev.methods.generalized_iv(), 0.3),
        ),
    ],
)
def test_a_trial_is_what_identify_says(choice, method):
    study = small_study(intervals=True, methods=(*METHODS[:2], choice))
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=(3,))))
    fit = ev.identify(EQUATION.problem(EQUATION.record(rng), ev.lags("input", 0, 5)), method)
    if choice.covariance == "classical":
        fit = fit.with_covariance(ev.covariances.Classical())
    row, label = lab_study.trial(study, 3), study.methods[2].label
    assert row[f"{label}.status"] == fit.status.value == ("weak" if choice.regularisation else "identified")
    for name in fit.names:
        low, high = fit.interval(name)
        numbers = [fit.parameters[name], fit.std_error(name), low, high]
        assert [row[f"{label}.{name}{part}"] for part in lab_study.PARTS] == numbers


@pytest.mark.parametrize("name", lab_study.METHODS)
def test_every_method_on_the_vertical_experiment(name):
    """Without noise each finds the truth, except bias that there is none to compensate."""
    experiment = VerticalExperiment(ev.Scenario(0.293, 0.021, samples=500))
    lagged = None if name in lab_study.DIRECT else (0, 10)
    study = small_study(experiment=experiment, methods=(MethodChoice(name, lagged),))
    row = lab_study.trial(study, 0)
    failed = row[f"{name}.error"]
    if name in {"total_least_squares", "liml", "fuller", "generalized_liml", "generalized_fuller"}:
        # columns that are all exact leave them nothing to do
        assert failed in {None, "NoUniqueSolutionError"}
        return
    if name in {"generalized_iv_unknown_noise", "frisch_scheme"}:
        # without noise their equations are combinations of one another, and the weights have no inverse
        assert failed == "InstrumentError"
        return
    assert failed is None
    found = [row[f"{name}.{parameter}"] for parameter in study.parameters]
    assert found == pytest.approx([0.293, 0.021], rel=1e-8)


def test_noise_that_is_not_known_is_not_used():
    """Generalized IV raises without it, and the trial goes on."""
    giv = MethodChoice("generalized_iv", (0, 5), known_noise=(), label="blind")
    study = small_study(methods=(*METHODS, giv))
    row = lab_study.trial(study, 0)
    blind = {name: value for name, value in row.items() if name.startswith("blind.") and value is not None}
    assert blind == {"blind.status": "failed", "blind.error": "MissingNoiseError"}
    others = {name: value for name, value in row.items() if not name.startswith("blind.")}
    assert others == lab_study.trial(small_study(), 0)
    said = lab_study.failure(study, 0, "blind")
    assert said.startswith("MissingNoiseError: Expected a declared noise of channel 'input'")
    assert lab_study.failure(study, 0, "least_squares") == ""


@dataclass(frozen=True)
class Broken(DifferenceEquation):
    """Fails in some trials."""

    def record(self, rng):
        if rng.random() < 0.5:
            raise ZeroDivisionError("no record")
        return DifferenceEquation.record(self, rng)


def test_broken_records_in_the_middle_of_a_study_stop_nothing(tmp_path):
    """The table has every trial; what broke is counted, named, and told when it is asked for."""
    study = small_study(30, experiment=Broken((0.5,), (2.0,), Coin(), samples=100))
    result = run_study(study, tmp_path)
    label = study.methods[0].label
    broken = result.trials.filter(result.trials[f"{label}.error"] == "ZeroDivisionError")
    assert result.trials.height == 30
    assert 0 < broken.height < 30
    score = lab_study.scores(result)[0]
    assert (score.failed, score.first_failure) == (broken.height, broken["trial"][0])
    assert lab_study.failure(study, broken["trial"][0], label).startswith("ZeroDivisionError: ")


def test_identity():
    study = small_study()
    assert study.identity == replace(study, runs=1, name="other").identity
    others = [
        replace(study, seed=8),
        replace(study, methods=METHODS[:2]),
        replace(study, intervals=True),
        replace(study, experiment=replace(EQUATION, output_coefficients=(np.nextafter(0.5, 1.0),))),
        replace(study, experiment=replace(EQUATION, noise={})),
    ]
    assert len({item.identity for item in [study, *others]}) == 6


def choosing(*given, **options):
    return lambda: MethodChoice(*given, **options)


def choice_of(tmp_path, line, name="generalized_iv"):
    path = tmp_path / "method.toml"
    lags = "" if "squares" in name else "lags = [0, 5]"
    path.write_text(f'name = "{name}"\n{lags}\n{line}\n', encoding="utf-8")
    return method_choice(read_toml(path, "a method"))


def test_every_word_of_a_file(tmp_path):
    for towards in lab_study.TARGETS:
        made = choice_of(tmp_path, f'regularisation = {{ towards = "{towards}" }}')
        assert made.regularisation == Regularisation(None, towards)
        assert made.method.name == "generalized_iv_tikhonov"
    given = choice_of(tmp_path, "regularisation = { parameter = 0.5 }")
    assert given.regularisation == Regularisation(0.5)
    assert choice_of(tmp_path, "strength = 4.0", "fuller").method == ev.methods.fuller(4.0)


def test_a_disturbance_moves_the_machine():
    """Its effect on the output is the recursion of the disturbance itself."""
    parts = ((0.8,), (1.0,), Coin())
    disturbed = DifferenceEquation(*parts, disturbance=WhiteDisturbance(1.0)).record(np.random.default_rng(4))
    free = DifferenceEquation(*parts).record(np.random.default_rng(4))
    effect = disturbed.channel("output") - free.channel("output")
    series = effect - 0.8 * np.concatenate([[0.0], effect[:-1]])
    assert series.std() == pytest.approx(1.0, rel=0.1)
    assert abs(np.corrcoef(series[1:], series[:-1])[0, 1]) < 0.1


@pytest.mark.parametrize("level", [0.95, 0.99])
@pytest.mark.parametrize(
    ("hits", "count"), [(0, 5), (3, 7), (95, 100), (400, 400), (0, 10), (7, 10), (200, 200)]
)
def test_interval_is_that_of_scipy(hits, count, level):
    """Another implementation of Wilson's interval."""
    theirs = binomtest(hits, count).proportion_ci(level, method="wilson")
    np.testing.assert_allclose(
        lab_study.Share(hits, count, level).interval, (theirs.low, theirs.high), atol=1e-12
    )
    assert lab_study.Share(0, 0, level).interval == (0.0, 1.0)


def test_streams_are_those_of_the_seed_sequence():
    numbers = (0, 1, 5, 10_000_000 - 1)
    for seed, place in ((0, 0), (7, 3), (2**31, 1), (2**130 + 5, 2)):
        for number, rng in zip(numbers, streams(seed, numbers, (place,)), strict=True):
            spawned = np.random.Generator(
                np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(number, place)))
            )
            assert (rng.standard_normal(5) == spawned.standard_normal(5)).all()


@pytest.mark.parametrize(
    ("experiment", "alone"),
    [
        (EQUATION, {"extended_iv", "extended_iv_tls"}),  # refused: a noisy regressor's own lag
        (replace(EQUATION, noise={"output": WhiteNoise(0.5)}, excitation=WhiteExcitation(1.0)), set()),
        (replace(EQUATION, noise_to_signal={"output": 0.1}), set(lab_study.PLAIN)),
        (VerticalExperiment(Scenario(0.3, 0.02, samples=400)), set()),
        (replace(EQUATION, excitation=WhiteExcitation(1e-3), noise={"output": WhiteNoise(1.0)}), None),
    ],
)
def test_trials_side_by_side_are_those_of_one_by_one(experiment, alone, monkeypatch):
    """Also where instruments are weak or methods refuse: those are computed one by one."""
    choices = tuple(
        MethodChoice(name, None if name in lab_study.DIRECT else (1, 6)) for name in lab_study.PLAIN
    )
    study = small_study(experiment=experiment, methods=choices, runs=12)
    expected = [lab_study.trial(study, index) for index in range(12)]
    taken, one_by_one = set(), lab_study._estimate

    def estimated(study, choice, signals):
        taken.add(choice.name)
        return one_by_one(study, choice, signals)

    monkeypatch.setattr(lab_study, "_estimate", estimated)
    for row, one in zip(lab_study.side_by_side(study, range(12)), expected, strict=True):
        for key, value in one.items():
            assert row[key] == (pytest.approx(value, rel=1e-12) if isinstance(value, float) else value)
    assert alone is None or taken == alone


def test_processes_are_begun_where_trials_are_worth_them(monkeypatch):
    assert isinstance(lab_study.study_executor(small_study(), None), InProcess)
    assert lab_study.study_executor(small_study(RUNS, intervals=True), 2) == LocalProcesses(2)
    monkeypatch.setattr("eivor.lab.study.WORTH_PROCESSES_S", 0.0)
    assert lab_study.study_executor(small_study(RUNS, intervals=True), None) == local_executor(None, 7)


# Whatever computes a study, and whatever is killed meanwhile: the same bytes.

#: Enough shards that every worker has some and a killed one leaves some.
RUNS = 6 * lab_study.SHARD_TRIALS + 10


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    folder = tmp_path_factory.mktemp("expected")
    run_study(small_study(RUNS), folder, executor=InProcess())
    return content(folder)


def children():
    """Worker processes of this one."""
    below = [
        int(item) for task in Path("/proc/self/task").glob("*/children") for item in task.read_text().split()
    ]
    return [item for item in below if b"process_pool" in Path(f"/proc/{item}/cmdline").read_bytes()]


@pytest.mark.parametrize("executor", [InProcess(), LocalProcesses(2), LocalThreads(2)])
def test_any_function_is_mapped(executor):
    """A flight, a scenario or a study: an executor does not know what a task is."""
    items = ["a", ("b", 1), None, 3.5]
    assert dict(executor.map(text_of, items)) == {index: text_of(item) for index, item in enumerate(items)}
    assert list(executor.map(text_of, [])) == []
    with pytest.raises(InputError, match=r"Expected no 7; received one\. Leave it out"):
        list(executor.map(refusing, [7]))


def test_a_worker_that_begins_is_not_interrupted(capfd):
    """Ctrl-C reaches a worker while it still imports; it is the parent's business all the same."""
    assert dict(LocalProcesses(2).map(Arriving(), [1, 2])) == {0: "<1>", 1: "<2>"}
    assert capfd.readouterr().err == ""


def test_items_are_taken_as_there_is_room():
    """Memory does not grow with their number."""
    taken: list[int] = []
    items = (taken.append(item) or item for item in range(1000))
    with contextlib.closing(LocalProcesses(2).map(text_of, items)) as results:
        next(results)
        assert len(taken) <= 2 * TASKS_PER_WORKER


@pytest.mark.parametrize("executor", [LocalProcesses(1), LocalThreads(1)])
def test_closing_ends_the_work(executor, tmp_path):
    """Workers that nobody waits for end between two parts of a task, and are gone."""
    with contextlib.closing(executor.map(Patient(tmp_path), range(5))) as results:
        assert next(results) == (0, 0)
    assert not children()
    assert not (tmp_path / "4").exists()


@pytest.fixture
def cluster(tmp_path):
    """Address of a Dask scheduler on loopback and its two workers, each a process of its own."""
    scheduler_file = tmp_path / "scheduler.json"
    environment = os.environ | {
        "PYTHONPATH": SOURCES,
        # One that was killed is missed at once all the same; one that still imports is not given up.
        "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "60s",
    }

    def begun(command, *options):
        command = [sys.executable, "-m", f"distributed.cli.dask_{command}", "--no-dashboard", *options]
        command += ["--scheduler-file", str(scheduler_file)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return subprocess.Popen(command, env=environment, cwd=tmp_path, **quiet)

    processes = [begun("scheduler", "--host", "127.0.0.1", "--port", "0")]
    try:
        wait_until(scheduler_file.exists, processes[0])
        options = ("--no-nanny", "--nthreads", "1", "--host", "127.0.0.1")
        processes += [begun("worker", *options) for _ in range(2)]
        yield json.loads(scheduler_file.read_text(encoding="utf-8"))["address"], processes[1:]
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


@pytest.mark.thorough
def test_dask_with_a_worker_killed(expected, cluster, tmp_path):
    """Two workers, one of which is killed in the middle."""
    from distributed import Client

    address, workers = cluster
    killed: list[int] = []

    def kill(done, total):
        if done >= 2 * lab_study.SHARD_TRIALS and not killed:
            workers[0].kill()
            killed.append(done)

    with Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=PATIENCE_S)
    run_study(small_study(RUNS), tmp_path / "study", executor=DaskCluster(address), progress=kill)
    assert killed
    assert workers[0].poll() is not None
    assert workers[1].poll() is None
    assert content(tmp_path / "study") == expected


@pytest.mark.thorough
def test_dask_without_a_scheduler(tmp_path, monkeypatch):
    monkeypatch.setattr("eivor.dask_executor.PATIENCE_S", 0.5)
    with pytest.raises(InputError, match=r"a Dask scheduler at tcp://127\.0\.0\.1:1; received no answer"):
        run_study(small_study(), tmp_path, executor=DaskCluster("tcp://127.0.0.1:1"))


def test_there_are_as_many_workers_as_processors_and_none_for_a_single_task(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    assert local_executor(None, 100) == LocalProcesses(8)
    assert local_executor(5, 1) == local_executor(None, 0) == InProcess()


# Study files: what they may say, and what is said about those that may not.

VERTICAL = """
viscous_friction = 0.3
input_gain = 0.02
samples = 300
"""
STUDY = f"""
runs = 5
seed = 3
[scenario]
{VERTICAL}
[[methods]]
name = "least_squares"
"""
HUGE, ENORMOUS, HEXADECIMAL = "1" + 400 * "0", "1" + 5000 * "0", "0x" + 5000 * "f"
#: Key, what it is in `STUDY`, numbers that no float or array holds, and what is said.
EXTREMES = [
    ("runs", "5", HUGE, "Expected whole numbers of 64 bits at runs of mine.toml; received one of 1330"),
    ("runs", "5", ENORMOUS, "Expected a study in TOML; received .*mine.toml', which is not"),
    ("runs", "5", HEXADECIMAL, "64 bits at runs of mine.toml; received one of 20001"),
    ("seed", "3", "9223372036854775808", "64 bits at seed of mine.toml; received one of 65"),
    ("seed", "3", f"3\nlevel = {HUGE}", "64 bits at level of mine.toml"),
    ("seed", "3", f"3\nx = [1, {{ y = {HUGE} }}]", r"64 bits at x\[2\].y of mine.toml"),
    ("viscous_friction", "0.3", "1e308", "of 1e-30 to 1e.30 in size, at scenario.viscous_friction of mine"),
    ("viscous_friction", "0.3", "1e155", "received 1e.155"),
    ("viscous_friction", "0.3", HUGE, "64 bits at scenario.viscous_friction of mine.toml"),
    ("input_gain", "0.02", "-1e308", "received -1e.308"),
    ("samples", "300", "300\nrate_hz = 1e-308", "at scenario.rate_hz of mine.toml; received 1e-308"),
]


def read(folder, text):
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return read_study(path)


def test_everything_that_a_study_may_say(tmp_path):
    study = read(
        tmp_path,
        """
        name = "all"
        runs = 5
        seed = 3
        intervals = true
        level = 0.9
        [scenario]
        kind = "difference_equation"
        output_coefficients = [0.5, -0.1]
        input_coefficients = [2]
        delay = 2
        samples = 100
        rate_hz = 10
        excitation = { kind = "pseudo_random_binary", amplitude = 1.0, register = 5 }
        disturbance = { kind = "white", std = 0.1 }
        noise.output = { kind = "fractional", order = -0.4, std = 0.2 }
        noise.input = { kind = "white", ratio_to_signal = 0.1 }
        [[methods]]
        name = "extended_iv"
        lags = [1, 4]
        channel = "output"
        weighting = "two_stage"
        known_noise = []
        label = "odd"
        """,
    )
    assert (study.name, study.intervals, study.level) == ("all", True, 0.9)
    assert study.experiment == DifferenceEquation(
        (0.5, -0.1),
        (2.0,),
        PseudoRandomBinary(1.0, 5),
        delay=2,
        samples=100,
        rate_hz=10.0,
        noise={"output": FractionalNoise(0.2, -0.4), "input": WhiteNoise(1.0)},
        noise_to_signal={"input": 0.1},
        disturbance=WhiteDisturbance(0.1),
    )
    assert study.methods == (MethodChoice("extended_iv", (1, 4), "output", "two_stage", (), "odd"),)


def test_a_scenario_of_its_own_file(tmp_path):
    (tmp_path / "flight.toml").write_text(VERTICAL, encoding="utf-8")
    text = STUDY.replace(f"[scenario]\n{VERTICAL}", 'scenario = "flight.toml"')
    assert read(tmp_path, text).identity == read(tmp_path, STUDY).identity
    (tmp_path / "flight.toml").unlink()
    with pytest.raises(InputError, match=r"a scenario in TOML; received .*flight.toml', unreadable: No such"):
        read(tmp_path, text)


LS, IV = '"least_squares"', '"extended_iv"'
FILE_EQUATION = """
kind = "difference_equation"
output_coefficients = [0.5]
input_coefficients = [2.0]
excitation = { kind = "white" }
"""


def of_file(old, new, tmp_path):
    assert old in STUDY
    read(tmp_path, STUDY.replace(old, new))


def of_content(content, tmp_path):
    (tmp_path / "mine.toml").write_bytes(content)
    read_study(tmp_path / "mine.toml")


def panic(*parts, **options):
    raise pl.exceptions.PanicException("index out of bounds")


def of_a_panic(before, read, tmp_path, monkeypatch):
    """Polars' own kind of crash is no Exception, and would end the program with a traceback."""
    before(tmp_path)
    for name in ("read_parquet", "scan_parquet"):
        monkeypatch.setattr(pl, name, panic)
    read(tmp_path)


def tabled(folder):
    pl.DataFrame({"u": [1.0]}).write_parquet(folder / "u.parquet")


STUDIED = partial(run_study, small_study(30))
RICH, DASK = shipped_scenario("rich"), DaskCluster("tcp://127.0.0.1:1")
test_refused = table(
    calls("choice", UsageError,
        (lambda: small_study(0), "Expected runs from 1 to 10000000; received 0"),
        (lambda: small_study(seed=-1), "Expected a seed of zero or more; received -1"),
        (lambda: small_study(level=1.0), "Expected a confidence level between 0 and 1; received 1.0"),
        (lambda: small_study(methods=(MethodChoice("least_squares", label="a.b"),)), "no dot"),
        (choosing("generalized_iv"), r"lags = \[first, last\] for .* received 'generalized_iv' with none"),
        (choosing("extended_iv", (3, 1)), "Expected first <= last"),
        (choosing("extended_iv", (-1, 1)), "a lag of zero or more samples"),
        (choosing("extended_iv_tls", (1, 2), weighting="two_stage"), "extended_iv or generalized_iv only"),
        (lambda: small_study(methods=(MethodChoice("extended_iv", (1, 2), channel="inptu"),)),
            "Did you mean 'input'"),
        (lambda: small_study(methods=(MethodChoice("least_squares", known_noise=("velocity_z",)),)),
            "a channel for 'least_squares' out of output, input; received 'velocity_z'"),
        (lambda: Regularisation(towards="truth"), "a vector to be shrunk towards out of zero"),
        (lambda: Regularisation(-1.0), "a parameter of zero or more"),
        (choosing("generalized_iv", (0, 5), strength=4.0), "a strength for fuller"),
        (choosing("fuller", (1, 5), strength=-4.0), "strength between 0 and"),
        (choosing("spectral_giv", (0, 5), regularisation=Regularisation()), "a regularisation of a linear"),
        (choosing("fuller", (1, 5), regularisation=Regularisation()), "least squares or total least squares"),
        (lambda: LocalProcesses(0), "Expected one worker or more; received 0"),
        (lambda: LocalThreads(0), "Expected one worker or more; received 0"),
        (lambda: local_executor(0, 5), "Expected one worker or more; received 0"),
        (lambda: DaskCluster("somewhere"), "Expected the address of a Dask scheduler; received 'somewhere'"),
        (lambda: Limits(time_s=0.0), r"a limit .* above zero"),
        (lambda: paper.named_readings(("nothing",)), "readings out of ratios-of-std"),
        (lambda: next(paper.run_paper(paper.READINGS, runs=1)), "two runs or more"),
        (without("distributed", lambda folder: run_study(small_study(), folder, executor=DASK)),
            r"Dask, which is needed .*pip install 'eivor\[dask\]'"),
    ),
    rows("decoder's panic", InputError, of_a_panic,
        (STUDIED, STUDIED, "what the system says: index out of bounds"),
        (tabled, lambda at: read_coverage(at / "u.parquet"), "index out of bounds"),
        (tabled, lambda at: read_trial_table(at / "u.parquet"), "index out of bounds"),
    ),
    rows("equation", ParameterError, lambda changes: replace(EQUATION, **changes),
        ({"output_coefficients": (1.0,)}, r"stable equation; received \[1.0\], with a root of modulus 1"),
        ({"input_coefficients": ()}, "at least one input coefficient; received none"),
        ({"input_coefficients": (float("nan"),)}, "a finite coefficient; received coefficient=nan"),
        ({"delay": -1}, "a delay of zero or more samples; received -1"),
        ({"noise_to_signal": {"input": -0.1}}, "noise_to_signal for input of zero or more; received .*=-0.1"),
        ({"noise": {"velocity_z": WhiteNoise(1.0)}}, "of output, input; received noise of 'velocity_z'"),
    ),
    rows("bound", ParameterError, ev.bounds.cramer_rao,
        (shipped_scenario("closed-loop"), "in open loop"),
        (ev.Scenario(0.3, 0.02), "noise of input"),
    ),
    calls("call", None,
        (lambda: ev.bounds.cramer_rao(RICH, runs=0), ParameterError, "1 to 10000 records"),
        (lambda: ev.bounds.cramer_rao(RICH, seed=-1), ParameterError, "a seed of zero or more"),
        (lambda: list(LocalProcesses(1).map(answered, ["a", "die"])), InputError,
            "worker processes that live .* died .*7.*run the same again"),
        (lambda: read_study(Path("mine.toml")), InputError, "unreadable: No such file"),
        (lambda tmp_path: read_study(tmp_path.parent), InputError, "unreadable: Is a directory"),
    ),
    rows("content", InputError, of_content,
        (b"\xff\xfe\x00", "unreadable: "),
        (b"x = " + b"[" * 100_000, r"mine.toml', which is not"),
        (b"#" * 1_000_001, "larger than 1000000 bytes"),
    ),
    rows("file", InputError, of_file,
        ("runs = 5", "", "Expected a whole number at runs of mine.toml; received nothing. Add it."),
        ("runs = 5", "rnus = 5", "Is 'rnus' meant to be it"),
        ("runs = 5", "runs = -5", r"Expected runs from 1 to 10000000 at the top of mine.toml; received -5"),
        ("runs = 5", "runs = true", "Expected a whole number at runs of mine.toml; received True"),
        ("seed = 3", "seed = 3\nsede = 4", r"received the unknown key 'sede'\. Did you mean 'seed'"),
        ("seed = 3", "seed = 3\nlevel = inf", "Expected a finite number at level of mine.toml; received inf"),
        ("seed = 3", "seed = 3 3", "Expected a study in TOML; received .*mine.toml', which is not"),
        ("[[methods]]", "[methods]", "Expected a list of tables at methods of mine.toml"),
        (LS, '"least_square"', r"at methods\[1\] of mine.toml; received 'least_square'.*'least_squares'"),
        (LS, f"{IV}\nlag = [1, 2]", r"received the unknown key 'lag'\. Did you mean 'lags'"),
        (LS, f"{IV}\nlags = [2, 1]", r"Expected \[first, last\].* received \[2, 1\]"),
        (LS, f"{IV}\nlags = [0.5, 1]",
            r"a whole number at methods\[1\].lags\[1\] of mine.toml; received 0.5"),
        (LS, f"{LS}\nknown_noise = 'input'",
            r"texts at methods\[1\].known_noise of mine.toml; received 'input'"),
        ("input_gain", "input_gian", r"at scenario of mine.toml; .* 'input_gian'. Did you mean 'input_gain'"),
        ("samples = 300", 'samples = "x"', "Expected a whole number at scenario.samples"),
        (VERTICAL, 'kind = "vertcal"', "Did you mean 'vertical'"),
        (VERTICAL, FILE_EQUATION.replace("0.5", "1.5"), "a stable equation at scenario of mine.toml"),
        (VERTICAL, FILE_EQUATION.replace("0.5", '"a"'),
            r"a finite number at .*output_coefficients\[1\] .* 'a'"),
        (VERTICAL, f"{FILE_EQUATION}noise.outptu.kind = 'white'", "key 'outptu'.* Did you mean 'output'"),
        (VERTICAL, f"{FILE_EQUATION}noise.input = {{ kind = 'white', std = -1.0 }}", "noise.input .* std=-1"),
        *((f"{key} = {value}", f"{key} = {number}", message) for key, value, number, message in EXTREMES),
        (LS, f"{IV}\nlags = [0, 99999999999]", "10000 lags or fewer at methods.1. of mine"),
        (VERTICAL, FILE_EQUATION + "samples = 99999999999", "50000000 samples or fewer at scenario.samples"),
    ),
)  # fmt: skip
