"""Tasks of the server as a worker process runs them."""

from __future__ import annotations

import inspect
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from eivor import checks
from eivor.atomic_file import write_atomically
from eivor.cli import parsing
from eivor.cli.export import supplied
from eivor.errors import EivorError, InputError, UsageError, did_you_mean
from eivor.estimation.methods import TABLE
from eivor.exports.fitted import Exported, Supplied, Target
from eivor.exports.simulators import TARGETS, motions_for, target_by_name
from eivor.logs import read_log
from eivor.logs.channel_map import shipped_maps
from eivor.logs.read import FURTHER_ENDINGS, readable_formats
from eivor.logs.rosbag.containers import ENDINGS as BAG_ENDINGS
from eivor.logs.rosbag.containers import METADATA
from eivor.logs.ulog.reader import TOPIC_TABLE, ULOG_ENDINGS
from eivor.motions.rigid_body.vehicle import load_vehicle, shipped_vehicles
from eivor.motions.table import motion_by_name, motion_names
from eivor.planning.plan import WRITTEN, MachinePlan
from eivor.process_pool import ProgressCallback
from eivor.report.flight_page import flight_page
from eivor.report.other_results import plan as planned
from eivor.report.saved_fit import SavedFit, fit_among, load_fits
from eivor.serve.jobs import REPORT, RESULT, File, KeptLog, Outcome, Task
from eivor.serve.requests import MOST_FILES, JobRequest, refusal
from eivor.signals.recording import Finding, Recording


def choices() -> dict[str, object]:
    """Models, methods, maps, vehicles, targets of exports, kinds of plans, and what logs are in folders."""
    endings = {end for readable_format in readable_formats() for end in readable_format.endings}
    return {
        "models": [_choice(name, motion_by_name(name).words.title) for name in motion_names()],
        "methods": [
            _choice(name, (inspect.getdoc(factory) or "").partition("\n")[0].rstrip("."))
            for name, factory in TABLE.items()
        ],
        "maps": [_choice(name, name) for name in shipped_maps()],
        "vehicles": [_choice(name, load_vehicle(name).name) for name in shipped_vehicles()],
        "targets": [
            {**_choice(name, item.words), "file": f"{name}{item.ending}"} for name, item in TARGETS.items()
        ],
        "plans": [
            {**_choice(name, item.words), "file": item.file, "needs": ["home"] * item.is_mission}
            for name, item in WRITTEN.items()
        ],
        "folders": {
            "endings": sorted({*endings, *FURTHER_ENDINGS, ".csv"}),
            "bags": BAG_ENDINGS,
            "metadata": METADATA,
            "tables": TOPIC_TABLE,
            "beside": ULOG_ENDINGS,
            "most": MOST_FILES,
        },
    }


def _choice(name: str, words: str) -> dict[str, object]:
    return {"name": name, "words": words}


#: Names of what comes with Eivor; anything else is the text of a file.
_NAME = re.compile(r"[\w.-]{1,100}")


def outcome_of(task: Task, progress: ProgressCallback) -> Outcome:
    """Outcome of a task: a `RefusedError` where it cannot be done."""
    try:
        if task.name == "identify":
            identify(**task.arguments, progress=progress)
            return None
        return TASKS[task.name](**task.arguments)
    except EivorError as error:
        return refusal(error)


@contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    """Put temporary files into a folder, so that those of killed readers are deleted with it."""
    previous, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = previous


def identify(
    request: JobRequest, logs: Mapping[str, KeptLog], folder: Path, progress: ProgressCallback
) -> None:
    """Identify logs by their identifiers, and write result and report into the folder of the job."""
    with _temporary_files_in(folder):
        progress({"stage": "reading"})
        words = request.options
        with _vehicle(words.vehicle, folder) as vehicle:
            motions = parsing.named_motions(words.model, vehicle)
        options = parsing.flight_options(motions, words)
        supplied(words.mass, (), "")  # exports take it: what it says is reported now
        several, names, counts = len(request.logs) > 1, {}, Counter[str]()
        for log in dict.fromkeys(log for log, _ in request.windows):
            name = logs[log].name
            counts[name] += 1
            names[log] = name if counts[name] == 1 else f"{name} ({counts[name]})"
        with _as_file(words.map, folder / "map.toml", shipped_maps(), "map") as channel_map:
            read = {
                log: replace(_recording(logs[log], channel_map, several=several), name=name)
                for log, name in names.items()
            }
        windows = [parsing.parse_window(window) if window else None for _, window in request.windows]
        paths = [Path(names[log]) for log, _ in request.windows]
        recordings = parsing.named_flights(paths, windows, [read[log] for log, _ in request.windows], options)
        result = parsing.identified(
            recordings, motions, options, windows, progress=lambda stage: progress({"stage": stage.value})
        )
        progress({"stage": "writing"})
        write_atomically(folder / RESULT, result.to_json())
        progress({"done": {"status": result.status.value}})
        write_atomically(folder / REPORT, flight_page(result))


def _recording(log: KeptLog, channel_map: str, *, several: bool) -> Recording:
    try:
        with parsing.named(log.name, several=several):
            recording = read_log(log.path, channel_map=channel_map or None)
    except EivorError as error:
        raise _reword(error, partial(_log_name, log)) from error
    findings = tuple(Finding(finding.name, _log_name(log, finding.message)) for finding in recording.findings)
    return replace(recording, findings=findings)


def _log_name(log: KeptLog, text: str) -> str:
    return text.replace(str(log.path), log.name).replace(log.path.name, log.name)


@contextmanager
def _as_file(text: str, path: Path, shipped: tuple[str, ...], noun: str) -> Iterator[str]:
    """Name of a shipped file unchanged; other text as a file, whose path errors do not name."""
    if not text or text in shipped:
        yield text
        return
    if _NAME.fullmatch(text):
        remedy = did_you_mean(text, shipped, f"Name one of them, or give the text of a {noun}'s file.")
        raise InputError(f"a shipped {noun} ({', '.join(shipped)})", f"'{text}'", remedy)
    write_atomically(path, text)
    try:
        yield str(path)
    except EivorError as error:
        raise _reword(error, lambda part: part.replace(str(path), path.name)) from error


def _vehicle(text: str, folder: Path) -> AbstractContextManager[str]:
    return _as_file(text, folder / "vehicle.toml", shipped_vehicles(), "vehicle")


def _reword(error: EivorError, changed: Callable[[str], str]) -> EivorError:
    return type(error)(*map(changed, (error.expected, error.received, error.remedy)))


#: What is known beside the flight and typed for it, by its name on the page.
WordsOf = Mapping[str, str]


def _supplied(words: WordsOf, folder: Path) -> Supplied:
    priors = tuple(filter(None, words.get("prior", "").split("\n")))
    with _vehicle(words.get("vehicle", ""), folder) as vehicle:
        return supplied(words.get("mass", ""), priors, vehicle)


def list_exports(folder: Path, stem: str, words: WordsOf) -> list[dict[str, object]]:
    """Entry of every target, with the reason if it cannot be written."""
    inputs, fits = _supplied(words, folder), load_fits(folder / RESULT)
    entries = []
    for name, target in TARGETS.items():
        entry = _choice(name, target.words) | {"file": _file_name(stem, target), "reason": "", "left_out": []}
        try:
            exported = _exported(fit_among(fits, "", motions_for(name)), name, inputs)
            entry["left_out"] = [*exported.omitted, *exported.lost]
        except EivorError as error:
            entry["reason"] = str(error)
        entries.append(entry)
    return entries


def export(folder: Path, stem: str, words: WordsOf) -> File:
    """Write what a target takes."""
    target = target_by_name(words["target"])
    result = fit_among(load_fits(folder / RESULT), "", motions_for(target.name))
    return File(_file_name(stem, target), _exported(result, target.name, _supplied(words, folder)).text)


def _exported(result: SavedFit, name: str, inputs: Supplied) -> Exported:
    """Export with mass and vehicle, or without them for targets that refuse them."""
    try:
        return result.exported(name, inputs, None, 0)
    except UsageError:
        return result.exported(name, replace(inputs, mass=None, vehicle=None), None, 0)


def _file_name(stem: str, target: Target) -> str:
    return f"{stem}-{target.name}{target.ending}"


def plan(folder: Path, stem: str, words: WordsOf) -> File:
    """Plan the flight that would identify, and write it in a form."""
    checks.index_of("a plan", words["form"], WRITTEN)
    form, home, position = WRITTEN[words["form"]], words.get("home", ""), None
    if form.is_mission:
        parsing.check_mission("it", home, "")
        position = parsing.position_of(home)
    result = planned(folder / RESULT, target=words.get("for", ""), shape="steps" if form.is_mission else "")
    if isinstance(result, MachinePlan):
        raise UsageError("a result of the vertical motion", "one of a machine", "Plan it with eivor plan.")
    return File(f"{stem}-{form.file}", form.text(result, position))


#: What else a process does, by the name of a `Task`.
TASKS: dict[str, Callable[..., Outcome]] = {
    "choices": choices,
    "list_exports": list_exports,
    "export": export,
    "plan": plan,
}
