"""Work of the commands identify and report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from types import SimpleNamespace
from typing import Any

from eivor.atomic_file import write_atomically
from eivor.cli import outputs as cli
from eivor.cli.parsing import result_of
from eivor.errors import UsageError
from eivor.flights.result import LogEstimate
from eivor.report.document import Facts, Section
from eivor.report.flight import log_documents
from eivor.report.terminal import on_terminal


def figure_part(path: Path | None, make: Callable[[], Any]) -> Callable[[], None]:
    """Drawing of a figure, where one is wanted."""

    def draw() -> None:
        if path is not None:
            with cli.step(f"Drawing {path.name}"), cli.writing(path):
                resolve_name("eivor.report.figures:save_figure")(make(), path)

    return draw


def write_page(result: LogEstimate, position: str) -> None:
    """Write the page of a result to a file, or to standard output where the place is "-"."""
    with cli.step(f"Writing {Path(position).name}"):
        page = resolve_name("eivor.report.flight_page:flight_page")(result)
    cli.write_out(page, position)


def _write_residuals(result: LogEstimate, folder: Path) -> None:
    with cli.step("Writing residuals"), cli.writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in resolve_name("eivor.report.other_results:residual_files")(result.drawn).items():
            write_atomically(folder / name, text)


def identify(typed: SimpleNamespace) -> cli.ExitCode:
    """Do what `eivor.cli.options.identify` declares."""
    picture = cli.figure_file(typed.figure)
    result, needed = result_of(typed)
    cli.deliver_result(
        lambda: on_terminal(*log_documents(result, card=typed.card)),
        result.to_json,
        typed.json,
        figure_part(picture, lambda: resolve_name("eivor.report.flight_figures:flight_figure")(result.drawn)),
        *([partial(write_page, result, typed.html)] if typed.html else []),
        *([partial(_write_residuals, result, Path(typed.residuals))] if typed.residuals else []),
    )
    return cli.ExitCode.IDENTIFIED if result.meets(needed) else cli.ExitCode.NOT_IDENTIFIED


def report(typed: SimpleNamespace) -> cli.ExitCode:
    """Do what `eivor.cli.options.report` declares."""
    out = typed.out
    if not out:
        raise UsageError("a file for the page", "none", "Add -o flight.html, for example.")
    result, needed = result_of(typed)
    write_page(result, out)
    if out != cli.STANDARD_OUTPUT:
        facts = Facts((("page", f"{out} ({Path(out).stat().st_size / 1e6:.2f} MB)"),))
        card = replace(log_documents(result)[0], sections=(Section("", (facts,)),))
        cli.show(on_terminal(card))
    return cli.ExitCode.IDENTIFIED if result.meets(needed) else cli.ExitCode.NOT_IDENTIFIED
