"""Tasks done, in a worker process; imported there only."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from eivor.asked.flights import check_windows, identified, told_apart
from eivor.asked.options import flight_options, named_motion
from eivor.asked.planned import check_mission, place_of
from eivor.asked.supplied import supplied
from eivor.asked.words import LogArgument, named, window
from eivor.errors import EivorError, InputError, UsageError, did_you_mean
from eivor.exports.fitted import Exported, Supplied
from eivor.exports.target import Target
from eivor.exports.targets import TARGETS, target_by_name
from eivor.logs import read_log
from eivor.logs.channel_map import shipped_maps
from eivor.motions.rigid_body.vehicle_file import shipped_vehicles
from eivor.planning.written.formats import WRITTEN
from eivor.process_pool import ProgressCallback
from eivor.report.json_document import json_document, json_text
from eivor.report.page.flight_page import flight_page
from eivor.report.planned import plan
from eivor.report.read_fit import load_fit
from eivor.report.saved_fit import SavedFit
from eivor.serve.choices import choices
from eivor.serve.refusals import status_of, told
from eivor.serve.tasks import (
    REPORT,
    RESULT,
    Begin,
    Choices,
    Export,
    File,
    Found,
    Identify,
    KeptLog,
    ListExports,
    Outcome,
    Plan,
    Refused,
    Stage,
    Supply,
    Task,
)
from eivor.signals.recording import Finding, Recording
from eivor.whole_file import write_whole

#: Names of what comes with Eivor; anything else is the text of a file.
_NAME = re.compile(r"[\w.-]{1,100}")


def outcome_of(task: Task, progress: ProgressCallback) -> Outcome:
    """Outcome of a task: a `Refused` where it cannot be done."""
    try:
        match task:
            case Begin():
                return Choices(choices())
            case Identify():
                with _temporary_files_in(task.folder):
                    _identify(task, progress)
            case ListExports():
                return _list_exports(task)
            case Export():
                return _export(task)
            case Plan():
                return _plan(task)
    except EivorError as error:
        return Refused(int(status_of(error)), told(error))
    return None


@contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    """Let readers have theirs there: what they leave behind when they are killed goes with the folder."""
    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before


def _identify(task: Identify, progress: ProgressCallback) -> None:
    """Identify, write the result, tell it, and write the report."""
    progress(Stage("reading"))
    asked, folder = task.asked, task.folder
    with _vehicle(asked.vehicle, folder) as vehicle:
        motion = named_motion(asked.model, vehicle)
    options = flight_options(motion, **asked.options)
    supplied(asked.mass, (), "")  # exports take it: what it says is told now
    given = [
        LogArgument(Path(name), window(own) if own else None)
        for name, (_, own) in zip(_own_names(task), asked.logs, strict=True)
    ]
    with _as_file(asked.channel_map, folder / "map.toml", shipped_maps(), "map") as channel_map:
        read = {
            log: _recording(task.logs[log], channel_map, several=len(asked.logs) > 1)
            for log in dict.fromkeys(log for log, _ in asked.logs)
        }
    recordings = told_apart(
        given,
        [_called(read[log], one.path.name) for one, (log, _) in zip(given, asked.logs, strict=True)],
    )
    windows = [one.window for one in given]
    check_windows(recordings, [own or options.window for own in windows])
    result = identified(
        recordings, motion, options, windows, progress=lambda stage: progress(Stage(stage.value))
    )
    progress(Stage("writing"))
    write_whole(folder / RESULT, json_text(json_document(result)))
    progress(Found(result.verdict.status.value))
    write_whole(folder / REPORT, flight_page(result))


def _own_names(task: Identify) -> list[str]:
    """What each log is called: several of one name are numbered."""
    ids = list(dict.fromkeys(log for log, _ in task.asked.logs))
    names: dict[str, str] = {}
    seen: Counter[str] = Counter()
    for log in ids:
        name = task.logs[log].name
        seen[name] += 1
        names[log] = name if seen[name] == 1 else f"{name} ({seen[name]})"
    return [names[log] for log, _ in task.asked.logs]


def _recording(log: KeptLog, channel_map: str, *, several: bool) -> Recording:
    """Recording of a log, under its own name wherever the file is named."""
    try:
        with named(log.name, several=several):
            recording = read_log(log.path, channel_map=channel_map or None)
    except EivorError as error:
        raise _retold(error, partial(_own_name, log)) from error
    findings = tuple(Finding(one.name, _own_name(log, one.message)) for one in recording.findings)
    return replace(recording, findings=findings)


def _own_name(log: KeptLog, text: str) -> str:
    return text.replace(str(log.path), log.name).replace(log.path.name, log.name)


def _called(recording: Recording, name: str) -> Recording:
    return replace(recording, name=name)


@contextmanager
def _as_file(text: str, path: Path, shipped: tuple[str, ...], what: str) -> Iterator[str]:
    """A name of what comes with Eivor as it is; other text as a file, whose path is not told."""
    if not text or text in shipped:
        yield text
        return
    if _NAME.fullmatch(text):
        remedy = did_you_mean(text, shipped, f"Name one of them, or give the text of a {what}'s file.")
        raise InputError(f"a shipped {what} ({', '.join(shipped)})", f"'{text}'", remedy)
    write_whole(path, text)
    try:
        yield str(path)
    except EivorError as error:
        raise _retold(error, lambda part: part.replace(str(path), path.name)) from error


def _vehicle(text: str, folder: Path) -> AbstractContextManager[str]:
    return _as_file(text, folder / "vehicle.toml", shipped_vehicles(), "vehicle")


def _retold(error: EivorError, changed: Callable[[str], str]) -> EivorError:
    """The same error in other words."""
    return type(error)(*map(changed, (error.expected, error.received, error.remedy)))


def _supplied(supply: Supply, folder: Path) -> Supplied:
    with _vehicle(supply.vehicle, folder) as vehicle:
        return supplied(supply.mass, supply.priors, vehicle)


def _list_exports(task: ListExports) -> list[dict[str, object]]:
    given, result = _supplied(task.supply, task.folder), load_fit(task.folder / RESULT)
    return [
        {
            "name": name,
            "words": target.words,
            "file": _file_name(task.stem, target),
            **_state(result, name, given),
        }
        for name, target in TARGETS.items()
    ]


def _state(result: SavedFit, name: str, given: Supplied) -> dict[str, object]:
    try:
        return {"reason": "", "left_out": list(_exported(result, name, given).left_out)}
    except EivorError as error:
        return {"reason": str(error), "left_out": []}


def _export(task: Export) -> File:
    target = target_by_name(task.target)
    result = load_fit(task.folder / RESULT)
    made = _exported(result, task.target, _supplied(task.supply, task.folder))
    return File(_file_name(task.stem, target), made.text)


def _exported(result: SavedFit, name: str, given: Supplied) -> Exported:
    """Export; what is known of the vehicle's body goes to those only that have a use for it."""
    try:
        return result.exported(name, given, None, 0)
    except UsageError:
        return result.exported(name, replace(given, mass=None, vehicle=None), None, 0)


def _file_name(stem: str, target: Target) -> str:
    return f"{stem}-{target.name}{target.ending}"


def _plan(task: Plan) -> File:
    if task.form not in WRITTEN:
        remedy = did_you_mean(task.form, WRITTEN, "Name one of them.")
        raise UsageError(f"a plan for {', '.join(WRITTEN)}", f"'{task.form}'", remedy)
    form = WRITTEN[task.form]
    mission = form.of_place is not None
    check_mission("it" if mission else "", task.home if mission else "", "")
    place = place_of(task.home) if mission else None
    made = plan(task.folder / RESULT, target=task.target, shape="steps" if mission else "")
    return File(f"{task.stem}-{form.file}", form.text(made, place))
