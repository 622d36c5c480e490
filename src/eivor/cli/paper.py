"""`eivor paper`: the paper's two examples under every named reading, beside the tables that it prints."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.cli.arguments import PAPER_FILES, STANDARD_OUTPUT, JsonOption, Writes
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import deliver, output_file, write_out, writing
from eivor.cli.terminal import console, show, step
from eivor.errors import InputError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from eivor.studies.paper.examples import PaperResult
    from eivor.studies.paper.readings import Reading

#: The word for every reading.
ALL = "all"
EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 done, whatever came out; 2 wrong usage; 1 a file that cannot be written."
)


@guarded
def paper(
    *,
    runs: Annotated[int, typer.Option(metavar="N", help="Runs of each example.")] = 100,
    out: Annotated[
        str,
        typer.Option(
            metavar="FOLDER",
            help="Write figures 2 to 8 of the nearest reading here, as SVG and PNG.",
            show_default=False,
        ),
        Writes(PAPER_FILES),
    ] = "",
    readings: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Readings with commas between, or all: print their tables in full. Default: run all, and "
            "print the nearest one's tables and an overview.",
            show_default=False,
        ),
    ] = "",
    list_readings: Annotated[
        bool, typer.Option("--list", help="List the readings, what each says, and leave.")
    ] = False,
    workers: Annotated[
        int, typer.Option(metavar="N", help="Processes; default: one for each core.", show_default=False)
    ] = 0,
    json: JsonOption = "",
    page: Annotated[
        str,
        typer.Option(
            metavar="FILE.md", help="Put the tables between the marks of this page.", show_default=False
        ),
        Writes(),
    ] = "",
) -> ExitCode:
    """Run examples 1 and 2 of the paper that Eivor started from, and print measured beside printed.

    The paper: D. Ivanov, A. Zhdanov and I. Sandler, Identification of dynamical systems with time-varying
    disturbances and fractional errors-in-variables. Application example to a drone model (2024).

    Its text can be read in several ways; each is run, and none gives the printed tables.
    """
    from eivor.studies.paper.readings import named_readings

    named = tuple(name.strip() for name in readings.split(",") if name.strip())
    chosen = named_readings(() if named == (ALL,) else named)
    if list_readings:
        _list(chosen)
        return ExitCode.IDENTIFIED
    if runs < 2 or workers < 0:
        raise UsageError(
            "two runs or more, and workers of zero or more",
            f"--runs {runs} --workers {workers}",
            "The paper has 100 runs.",
        )
    folder = _folder(out) if out else None
    if page:
        _page_text(page)
    if folder:
        from eivor.report.paper_figures import figure_files

        for path in figure_files(folder):
            output_file(str(path), option="--out")
    from eivor.studies.paper.examples import run_paper

    begun = time.perf_counter()
    with _bar(2 * len(chosen)) as advance:
        results = []
        for result in run_paper(chosen, runs=runs, workers=workers or None):
            results.append(result)
            advance()
    seconds = time.perf_counter() - begun
    report = partial(_print_report if named else _print_overview, results)
    deliver(*_deliveries(results, seconds, report, json=json, page=page, folder=folder))
    return ExitCode.IDENTIFIED


def _page_text(page: str) -> str:
    """Text of the page that the tables go into.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    try:
        return Path(page).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            "a page with marks for the tables, in UTF-8", f"'{page}', unreadable: {reason}", "Check the name."
        ) from error


def _deliveries(
    results: Sequence[PaperResult],
    seconds: float,
    report: Callable[[], None],
    *,
    json: str,
    page: str,
    folder: Path | None,
) -> Iterator[Callable[[], None]]:
    if json != STANDARD_OUTPUT:
        yield report
    if json:
        yield partial(_write_json, results, seconds, json)
    if page:
        yield partial(_fill_page, results, page)
    if folder:
        yield partial(_draw, results, folder)


def _print_overview(results: Sequence[PaperResult]) -> None:
    from rich.text import Text

    from eivor.report import paper_table

    for part in paper_table.reading_report(paper_table.by_reading(results)[paper_table.nearest(results)]):
        show(part)
    for part in paper_table.overview_report(results):
        show(part)
    show(Text(f"Every reading's tables: eivor paper --readings {ALL}"))


def _print_report(results: Sequence[PaperResult]) -> None:
    from eivor.report import paper_table

    for group in paper_table.by_reading(results).values():
        for part in paper_table.reading_report(group):
            show(part)
    for part in paper_table.overview_report(results):
        show(part)


def _write_json(results: Sequence[PaperResult], seconds: float, place: str) -> None:
    from eivor.report.json_document import json_text
    from eivor.report.paper_table import paper_document

    write_out(json_text(paper_document(results, seconds=seconds)), place)


def _fill_page(results: Sequence[PaperResult], page: str) -> None:
    from eivor.report.paper_table import page_parts
    from eivor.studies.generated_page import page_with

    write_out(page_with(_page_text(page), page_parts(results)), page)


def _draw(results: Sequence[PaperResult], folder: Path) -> None:
    from eivor.report.paper_figures import write_figures
    from eivor.report.paper_table import by_reading, nearest

    with step("Drawing the figures"), writing(folder):
        write_figures(by_reading(results)[nearest(results)], folder)


def _list(readings: Sequence[Reading]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("reading", no_wrap=True)
    table.add_column("what it says", overflow="fold")
    for reading in readings:
        table.add_row(Text(reading.name, style="bold"), Text(reading.sentence))
    show(table)


def _folder(text: str) -> Path:
    """Folder of the figures, made when it is not there.

    Raises
    ------
    InputError
        When it cannot be made.
    """
    folder = Path(text)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            "a folder for the figures",
            f"'{text}', for which the system says: {error.strerror or error}",
            "Choose another.",
        ) from error
    return folder


@contextmanager
def _bar(total: int) -> Iterator[Callable[[], None]]:
    """Bar on standard error, on terminals only."""
    from rich.progress import Progress

    screen = console(error=True)
    with Progress(console=screen, disable=not screen.is_terminal, transient=True) as progress:
        task = progress.add_task("examples", total=total)
        yield lambda: progress.advance(task)
