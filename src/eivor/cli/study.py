"""`eivor study`: run a Monte Carlo study, or go on with one, and say how the methods did."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.cli.arguments import STANDARD_OUTPUT, STUDY_FILES, JsonOption, Reads, WorkersOption, Writes
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import deliver, keep_inputs, write_out, writing
from eivor.cli.terminal import complain, console, show, step
from eivor.errors import UsageError

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from eivor.process_pool import Executor
    from eivor.studies.metrics import MethodScore, Spread
    from eivor.studies.run import Progress, StudyResult
    from eivor.studies.study import Study

SCHEMA = "eivor.study/1"
EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 the study is complete; 2 wrong usage, such as a folder that holds another "
    "study; 1 a study that cannot be read, a file that cannot be written, a worker that was lost, or no "
    "estimate in any trial; 130 interrupted. Complete trials are kept: the same command goes on."
)


@guarded
def study(
    study_file: Annotated[
        str,
        typer.Argument(metavar="STUDY.toml", help="The study: scenario, methods, runs, seed."),
        Reads(),
    ],
    *,
    out: Annotated[
        str,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the trials; default: the study's file name with -study, here.",
            show_default=False,
        ),
        Writes(STUDY_FILES, default=lambda values: f"{Path(values['study_file']).stem}-study"),
    ] = "",
    runs: Annotated[
        int | None,
        typer.Option(metavar="N", help="Trials, in place of the study's own number.", show_default=False),
    ] = None,
    workers: WorkersOption = None,
    dask: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Use the workers of a Dask scheduler, such as tcp://host:8786.",
            show_default=False,
        ),
    ] = "",
    figures: Annotated[
        bool,
        typer.Option(
            "--figures",
            help="Draw histograms of NRMSE and, with intervals, their coverage into the folder.",
            show_default=False,
        ),
    ] = False,
    json: JsonOption = "",
) -> ExitCode:
    """Run a Monte Carlo study, or go on with one that was interrupted, and tell how well each method did."""
    if workers is not None and dask:
        raise UsageError("--workers or --dask", "both", "A Dask cluster brings its own workers.")
    from eivor.studies.study_file import study_from_table
    from eivor.toml_table import read_toml

    table = read_toml(Path(study_file), "a study")
    chosen = study_from_table(table)
    if runs is not None:
        chosen = replace(chosen, runs=runs)
    executor = _executor(chosen, workers, dask)
    folder = Path(out) if out else Path(f"{Path(study_file).stem}-study")
    keep_inputs(Path(study_file).name, table.files)
    from eivor.studies.metrics import scores
    from eivor.studies.run import run_study

    try:
        with _bar(chosen.name) as progress:
            result = run_study(chosen, folder, executor=executor, progress=progress)
    except KeyboardInterrupt:
        complain("interrupted", f"Complete trials are in {folder}. Run the same command again to go on.")
        return ExitCode.INTERRUPTED
    found = scores(result)
    deliver(*_deliveries(result, found, json, figures=figures))
    return ExitCode.FAILED if all(one.failed == one.trials for one in found) else ExitCode.IDENTIFIED


def _executor(study: Study, workers: int | None, dask: str) -> Executor:
    from eivor.process_pool import local_executor
    from eivor.studies.trial_shards import SHARD_TRIALS

    if dask:
        from eivor.studies.dask_executor import DaskCluster

        return DaskCluster(dask)
    return local_executor(workers, tasks=-(-study.runs // SHARD_TRIALS))


@contextmanager
def _bar(name: str) -> Iterator[Progress]:
    """Bar on standard error, when that is a terminal."""
    screen = console(error=True)
    if not screen.is_terminal:
        from eivor.studies.run import no_progress

        yield no_progress
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from eivor.report.printable import printable

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, transient=True) as bar:
        task = bar.add_task(printable(name), total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _deliveries(
    result: StudyResult, found: tuple[MethodScore, ...], json: str, *, figures: bool
) -> Iterator[Callable[[], None]]:
    if json != STANDARD_OUTPUT:
        yield lambda: show(_report(result, found))
    if json:
        yield partial(_write_json, result, found, json)
    if figures:
        yield partial(_draw, result)


def _write_json(result: StudyResult, found: tuple[MethodScore, ...], place: str) -> None:
    from eivor.report.json_document import json_text

    write_out(json_text(_document(result, found)), place)


def _draw(result: StudyResult) -> None:
    from eivor.report.study_pictures import write_study_figures

    with step("Drawing the figures"), writing(result.folder):
        write_study_figures(result)


def _report(result: StudyResult, found: tuple[MethodScore, ...]) -> RenderableType:
    from rich.console import Group
    from rich.text import Text

    from eivor.report.printable import printable
    from eivor.studies.trial import failure

    study = result.study
    truth = ", ".join(f"{name} = {value:g}" for name, value in study.experiment.truth.items())
    parts: list[RenderableType] = [
        Text(f"{printable(study.name)}: {study.runs} trials, seed {study.seed}", style="bold"),
        Text(f"truth: {truth}"),
        _table(found),
        *((_coverage_table(found, study.level),) if study.intervals else ()),
    ]
    for one in found:
        if one.first_failure is not None:
            said = printable(failure(study, one.first_failure, one.label))
            parts.append(
                Text(
                    f"{one.label} failed in {one.failed} of {one.trials} trials; {one.first_failure}: {said}"
                )
            )
    parts.append(Text(f"Every trial: {printable(str(result.folder / 'trials.parquet'))}", style="dim"))
    return Group(*parts)


def _table(found: tuple[MethodScore, ...]) -> Table:
    from rich.text import Text

    from eivor.studies.metrics import TOGETHER

    table = _columns("", "mean ± SD", "NRMSE, %", "bias", "RMSE")
    for number, one in enumerate(found):
        if number:
            table.add_row()
        notes = [f"{count} {word}" for count, word in ((one.failed, "failed"), (one.weak, "weak")) if count]
        table.add_row(Text(one.label, style="bold"), ", ".join(notes))
        for score in one.parameters:
            cells = [f"  {score.name}", _pair(score.estimate, 4), _pair(score.nrmse, 3)]
            table.add_row(*cells, f"{score.bias:.2g}", f"{score.rmse:.2g}")
        table.add_row(f"  {TOGETHER}", "", _pair(one.together, 3))
    return table


def _coverage_table(found: tuple[MethodScore, ...], level: float) -> Table:
    """How often intervals held the truth: a row for each method and parameter."""
    table = _columns(f"{100 * level:g} % intervals", "held the truth", "95 % range of this share")
    for one in found:
        for score in one.parameters:
            if score.coverage is not None:
                low, high = score.coverage.interval
                share = f"{100 * score.coverage.value:.1f} %"
                table.add_row(f"{one.label}, {score.name}", share, f"{100 * low:.1f} to {100 * high:.1f} %")
    return table


def _columns(first: str, *numbers: str) -> Table:
    """Empty table: words that may be folded, and numbers that are never cut."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(first, overflow="fold")
    for title in numbers:
        table.add_column(title, justify="right", no_wrap=True)
    return table


def _pair(spread: Spread, digits: int) -> str:
    return f"{spread.mean:.{digits}g} ± {spread.std:.2g}"


def _document(result: StudyResult, found: tuple[MethodScore, ...]) -> dict[str, object]:
    from importlib.metadata import version

    study = result.study
    return {
        "schema": SCHEMA,
        "study": {
            "name": study.name,
            "identity": study.identity,
            "runs": study.runs,
            "seed": study.seed,
            "level": study.level if study.intervals else None,
        },
        "truth": dict(study.experiment.truth),
        "methods": [_method(one) for one in found],
        "trials": str(result.folder / "trials.parquet"),
        "provenance": {"version": version("eivor")},
    }


def _method(one: MethodScore) -> dict[str, object]:
    from eivor.report.json_document import number

    parameters = {}
    for score in one.parameters:
        coverage = score.coverage
        parameters[score.name] = {
            "mean": number(score.estimate.mean),
            "std": number(score.estimate.std),
            "bias": number(score.bias),
            "rmse": number(score.rmse),
            "nrmse_percent": _spread(score.nrmse),
            "coverage": None
            if coverage is None
            else {
                "share": number(coverage.value),
                "bounds": list(coverage.interval),
                "count": coverage.count,
            },
        }
    return {
        "label": one.label,
        "trials": one.trials,
        "failed": one.failed,
        "weak": one.weak,
        "parameters": parameters,
        "together": {"nrmse_percent": _spread(one.together)},
    }


def _spread(spread: Spread) -> dict[str, object]:
    from eivor.report.json_document import number

    return {"mean": number(spread.mean), "std": number(spread.std)}
