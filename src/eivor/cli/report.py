"""`eivor report`: logs in; one page out, which opens in any browser without a network."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from eivor.asked.options import flight_options, named_motion
from eivor.cli.arguments import STANDARD_OUTPUT, Writes
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.identify import exit_code, identify, result_of, write_page
from eivor.cli.recordings import chosen_logs
from eivor.cli.terminal import show
from eivor.errors import UsageError

EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 identified; 3 weak, provisional or refused (the page is written all the "
    "same); 2 wrong usage; 1 a log that cannot be read, or a page that cannot be written.\n\n"
    "The page holds the JSON of `eivor identify --json` too, and saves it."
)

#: What `identify` writes and this command does not.
NOT_HERE = ("json", "figure", "html", "card")

OutOption = Annotated[
    str,
    typer.Option("--out", "-o", metavar="FILE", help="The page, such as flight.html.", show_default=False),
    Writes(),
]


@guarded
def report(*, out: str = "", **asked: Any) -> ExitCode:
    """Write what eivor identify finds as one page to look at and to send: verdict, numbers, pictures."""
    motion = named_motion(asked.pop("model"), asked.pop("vehicle"))
    logs, example, channel_map = (asked.pop(name) for name in ("logs", "example", "channel_map"))
    chosen = chosen_logs(logs, example=example, channel_map=channel_map)
    if not out:
        raise UsageError("a file for the page", "none", "Add -o flight.html, for example.")
    terms, noise = asked.pop("term") or (), asked.pop("noise") or ()
    result = result_of(chosen, motion, flight_options(motion, terms=terms, noise=noise, **asked))
    write_page(result, out)
    if out != STANDARD_OUTPUT:
        from eivor.report.document import Document, Fact, Facts, Section
        from eivor.report.terminal import on_terminal
        from eivor.report.told import told_flight

        told = told_flight(result)
        size = f"{Path(out).stat().st_size / 1e6:.2f} MB"
        where = Section("", (Facts((Fact("page", f"{out} ({size})"),)),))
        show(on_terminal(Document(", ".join(told.logs), told.verdict.status, told.meaning, (where,))))
    return exit_code(result)


def _signature() -> inspect.Signature:
    """Arguments and options of `identify`, with the page's in place of what that command writes."""
    known = get_type_hints(identify, include_extras=True)
    kept = [
        one.replace(annotation=known[name])
        for name, one in inspect.signature(identify).parameters.items()
        if name not in NOT_HERE
    ]
    page = inspect.Parameter("out", inspect.Parameter.KEYWORD_ONLY, default="", annotation=OutOption)
    return inspect.Signature([kept[0], page, *kept[1:]])


vars(report)["__signature__"] = _signature()
