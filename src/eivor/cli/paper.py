"""`eivor paper`: the paper's two examples under every named reading, beside the tables that it prints."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eivor.cli.arguments import STANDARD_OUTPUT, JsonOption, output_file, writing
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.terminal import console, show, step, write
from eivor.errors import InputError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from eivor.studies.paper import PaperResult
    from eivor.studies.paper_readings import Reading

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
    ] = "",
    readings: Annotated[
        str,
        typer.Option(metavar="NAMES", help="Readings with commas between; default: all.", show_default=False),
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
    ] = "",
) -> ExitCode:
    """Run examples 1 and 2 of the paper, under each way to read it, and print measured beside printed."""
    from eivor.studies.paper_readings import named_readings

    chosen = named_readings(tuple(name.strip() for name in readings.split(",") if name.strip()))
    if list_readings:
        _list(chosen)
        return ExitCode.IDENTIFIED
    if runs < 2 or workers < 0:
        raise UsageError(
            "two runs or more, and workers of zero or more",
            f"--runs {runs} --workers {workers}",
            "The paper has 100 runs.",
        )
    for option, text in (("--json", json), ("--page", page)):
        if text not in ("", STANDARD_OUTPUT):
            output_file(text, option=option, logs=[])
    folder = _folder(out) if out else None
    from eivor.studies.paper import run_paper

    begun = time.perf_counter()
    with _bar(2 * len(chosen)) as advance:
        results = []
        for result in run_paper(chosen, runs=runs, workers=workers or None):
            results.append(result)
            advance()
    seconds = time.perf_counter() - begun
    _deliver(results, seconds, json=json, page=page, folder=folder)
    return ExitCode.IDENTIFIED


def _deliver(
    results: Sequence[PaperResult], seconds: float, *, json: str, page: str, folder: Path | None
) -> None:
    from eivor.report import paper_table

    if folder:
        from eivor.report.paper_figures import write_figures

        shown = paper_table.by_reading(results)[paper_table.nearest(results)]
        with step("Drawing the figures"), writing(folder):
            write_figures(shown, folder)
    if page:
        from eivor.studies.generated_page import page_with

        parts = paper_table.page_parts(results)
        with writing(Path(page)):
            text = Path(page).read_text(encoding="utf-8")
            Path(page).write_text(page_with(text, parts), encoding="utf-8")
    if json:
        from eivor.report.json_document import json_text

        text = json_text(paper_table.paper_document(results, seconds=seconds))
        if json == STANDARD_OUTPUT:
            write(text)
            return
        with writing(Path(json)):
            Path(json).write_text(text, encoding="utf-8")
    for group in paper_table.by_reading(results).values():
        for part in paper_table.reading_report(group):
            show(part)
    for part in paper_table.overview_report(results):
        show(part)


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
