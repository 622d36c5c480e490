"""`eivor inspect`: what logs hold, and what `identify` would say of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

from eivor.asked.options import flight_options, named_motion
from eivor.cli import arguments
from eivor.cli.arguments import STANDARD_OUTPUT
from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.outputs import deliver, write_out
from eivor.cli.recordings import chosen_logs
from eivor.cli.terminal import show, step
from eivor.motions import DEFAULT as DEFAULT_MODEL

if TYPE_CHECKING:
    from eivor.report.inspection import Inspection, PooledInspection

EXIT_CODES = (
    "[bold]Exit codes[/bold]: 0 the logs can be read, whatever identify would say; 2 wrong usage; 1 a log "
    "that cannot be read, or a file that cannot be written (the list is printed all the same)."
)


@guarded
def inspect(
    logs: arguments.LogsArgument = None,
    *,
    example: arguments.ExampleOption = False,
    window: arguments.WindowOption = "",
    max_tilt: arguments.MaxTiltOption = None,
    input_channel: arguments.InputOption = "",
    input_map: arguments.InputMapOption = "",
    model: arguments.ModelOption = DEFAULT_MODEL,
    vehicle: arguments.VehicleOption = "",
    channel_map: arguments.MapOption = "",
    json: arguments.JsonOption = "",
) -> ExitCode:
    """List what logs hold: channels, flight, references; and what identify would say, of each and of all."""
    motion = named_motion(model, vehicle)
    chosen = chosen_logs(logs, example=example, channel_map=channel_map)
    options = flight_options(
        motion, window=window, max_tilt=max_tilt, input_channel=input_channel, input_map=input_map
    )
    recordings, windows = chosen.read(options)

    from eivor.report.inspection import pooled_inspection

    names = ", ".join(recording.name for recording in recordings)
    with step(f"Inspecting {names}"):
        found = pooled_inspection(recordings, options, windows, motion)
    deliver(*_deliveries(found if len(recordings) > 1 else found.logs[0], json))
    return ExitCode.IDENTIFIED


def _deliveries(found: Inspection | PooledInspection, json: str) -> Iterator[Callable[[], None]]:
    if json != STANDARD_OUTPUT:
        yield partial(_print_report, found)
    if json:
        yield partial(_write_json, found, json)


def _print_report(found: Inspection | PooledInspection) -> None:
    from eivor.report.inspection import PooledInspection
    from eivor.report.inspection_document import inspection_document, pooled_documents
    from eivor.report.terminal import on_terminal

    if isinstance(found, PooledInspection):
        show(on_terminal(*pooled_documents(found)))
    else:
        show(on_terminal(inspection_document(found)))


def _write_json(found: Inspection | PooledInspection, place: str) -> None:
    from eivor.report.inspection import PooledInspection
    from eivor.report.json_document import json_text
    from eivor.report.json_inspection import inspection_json, pooled_json

    document = pooled_json(found) if isinstance(found, PooledInspection) else inspection_json(found)
    write_out(json_text(document), place)
