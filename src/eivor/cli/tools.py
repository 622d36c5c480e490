"""Inspect, plan, vehicle and example; the work of track, validate and frequency-response."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer

from eivor import checks
from eivor.cli import outputs as cli
from eivor.cli import parsing
from eivor.cli.options import DEFAULT_MODEL, NO_TEXTS, FlightWords, LogWords, parse_pair
from eivor.cli.results import figure_part
from eivor.errors import CorruptLogError, InputError, UsageError
from eivor.flights.options import FlightOptions
from eivor.flights.track import track as tracked_parameter
from eivor.motions.declaration import load_machine, machine_text, shipped_machines
from eivor.motions.rigid_body import vehicle as vehicle_files
from eivor.planning.plan import WRITTEN, MachinePlan
from eivor.planning.vehicle import ROUGH, FlightLimits, VehicleGuess
from eivor.report import frequency_responses, inspection
from eivor.report.json_document import json_text
from eivor.report.other_results import plan as planned
from eivor.report.other_results import plan_document, plan_json, track_document, track_figure, track_json
from eivor.report.outputs import saved_of
from eivor.report.saved_fit import fit_among, load_fits
from eivor.report.terminal import on_terminal
from eivor.report.validation import validate as validated
from eivor.report.validation import validation_document
from eivor.strict_toml import ENDING, package_tables

#: Folder of the downloads, in place of the user's cache folder.
CACHE_VARIABLE = "EIVOR_CACHE"
TIMEOUT_S = 30.0


@dataclass(frozen=True, slots=True)
class PublicLog:
    """A real log that others published."""

    name: str
    url: str
    sha256: str
    about: str
    licence: str

    @property
    def file_name(self) -> str:
        return self.url.rpartition("/")[2]


def public_logs() -> Mapping[str, PublicLog]:
    """Every public log by name, in the order of the registry."""
    logs = {}
    for source in package_tables("eivor.data", "public_logs.toml")["source"]:
        for entry in source["log"]:
            name, url = entry["name"], f"{source['base']}/{entry['file']}"
            logs[name] = PublicLog(name, url, entry["sha256"], entry["about"], source["licence"])
    return logs


def local_file(log: PublicLog, *, folder: Path) -> Path:
    """Local file of a public log; downloaded when it is not there yet, its hash checked in any case."""
    import pooch

    pooch.get_logger().setLevel("ERROR")
    target = folder / log.file_name
    try:
        to = {"fname": log.file_name, "path": folder}
        patient = pooch.HTTPDownloader(timeout=TIMEOUT_S)
        result = pooch.retrieve(log.url, f"sha256:{log.sha256}", **to, downloader=patient)
    except ValueError as error:
        expected = f"'{log.file_name}' with the SHA-256 {log.sha256[:12]}..."
        remedy = "Try again later; nothing was kept. If it persists, the file has changed at its origin."
        raise CorruptLogError(expected, f"another content from {log.url}", remedy) from error
    except OSError as error:  # every error of requests is one
        wrong = f"; and '{target}' is there with another content" if target.is_file() else ""
        remedy = f"Check the network, or put the file there yourself; {CACHE_VARIABLE} names another folder."
        raise InputError(f"a download of {log.url} to {folder}", f"{_cause(error)}{wrong}", remedy) from error
    return Path(result)


def _cause(error: OSError) -> str:
    """What went wrong, in a few words: libraries' messages about networks go on for lines."""
    import requests

    if isinstance(error, requests.Timeout):
        return f"no answer within {TIMEOUT_S:.0f} s"
    if isinstance(error, requests.HTTPError) and error.response is not None:
        return f"the answer {error.response.status_code} {error.response.reason}"
    if isinstance(error, requests.RequestException):
        return "no connection"
    return error.strerror or str(error)


example = cli.group("example", "The example flight that comes with Eivor, and public real logs to try it on.")


@cli.command(example, "list")
def list_logs() -> None:
    """List the public real logs that can be fetched."""
    logs = public_logs().values()
    cli.show_table(("name", "what it is", "licence"), ((log.name, log.about, log.licence) for log in logs))


@cli.command(example)
def fetch(name: Annotated[str, cli.option("example fetch name")]) -> None:
    """Download a public real log, check it, and print its path. A second time it works without a network.

    The folder is the user's cache; EIVOR_CACHE names another one.
    """
    logs = public_logs()
    checks.index_of("a log", name, logs, "See: eivor example list")
    log = logs[name]
    import pooch

    folder = Path(os.environ.get(CACHE_VARIABLE) or pooch.os_cache("eivor")).expanduser()
    with cli.step(f"Downloading {log.file_name}"):
        path = local_file(log, folder=folder)
    cli.write(f"{path}\n")


@cli.guarded
@cli.with_options(
    LogWords,
    FlightWords,
    only=(
        *("example", "window", "max_tilt", "input_channel", "input_map"),
        *("model", "vehicle", "machine", "channel_map"),
    ),
)
def inspect(
    log: Annotated[str, cli.option("inspect log"), cli.Reads(cli.log_paths)] = "",
    *,
    json: cli.JsonOption = "",
    calibration: Annotated[bool, cli.option("inspect calibration")] = False,
    **given: Any,
) -> None:
    """List what a log holds: channels, flight, references; and what identify would say."""
    logs = parsing.words_of(LogWords, given | {"logs": [log] if log else None})
    model = logs.model or ("" if logs.machine else DEFAULT_MODEL)
    (motion,) = motions = parsing.named_motions(model, logs.vehicle, logs.machine)
    options = parsing.flight_options(motions, parsing.words_of(FlightWords, given))
    (recording,), (window,) = parsing.read_logs(logs, options)
    with cli.step(f"Inspecting {recording.name}"):
        part = options if window is None else replace(options, window=window)
        inspected = inspection.inspection(recording, part, motion)
    make = inspection.calibration_document if calibration else inspection.inspection_document
    cli.deliver_result(
        lambda: on_terminal(make(inspected)), lambda: json_text(inspection.inspection_json(inspected)), json
    )


@cli.guarded
def plan(
    source: Annotated[str, cli.option("plan source"), cli.Reads()] = "",
    *,
    for_what: Annotated[str, cli.option("plan for_what")] = "",
    hover: Annotated[float | None, cli.option("plan hover")] = None,
    friction: Annotated[float | None, cli.option("plan friction")] = None,
    lag: Annotated[float | None, cli.option("plan lag")] = None,
    gusts: Annotated[float | None, cli.option("plan gusts")] = None,
    height: Annotated[str, cli.option("plan height")] = "3:8",
    speed: Annotated[float, cli.option("plan speed")] = 2.0,
    acceleration: Annotated[float, cli.option("plan acceleration")] = 3.0,
    tilt: Annotated[float, cli.option("plan tilt")] = 20.0,
    limit: Annotated[list[str], cli.option("plan limit")] = NO_TEXTS,
    time: Annotated[float, cli.option("plan time")] = 60.0,
    shape: Annotated[str, cli.option("plan shape")] = "",
    seed: Annotated[int, cli.option("plan seed")] = 0,
    csv: Annotated[str, cli.option("plan csv"), cli.Writes()] = "",
    mavsdk: Annotated[str, cli.option("plan mavsdk"), cli.Writes()] = "",
    qgc: Annotated[str, cli.option("plan qgc"), cli.Writes()] = "",
    home: Annotated[str, cli.option("plan home")] = "",
    rotorpy: Annotated[str, cli.option("plan rotorpy"), cli.Writes()] = "",
    json: cli.JsonOption = "",
) -> cli.ExitCode:
    """Plan the flight that would identify what another one could not, and say how well it will."""
    lag_s = None if lag is None else 1e-3 * lag
    rough = {"hover": hover, "friction": friction, "lag": lag_s, "gusts": gusts}
    files = {"csv": csv, "mavsdk": mavsdk, "qgc": qgc, "rotorpy": rotorpy}
    parsing.check_mission(qgc, home, shape)
    vehicle = _vehicle(source, rough)
    fit = None if isinstance(vehicle, VehicleGuess) else saved_of(vehicle, "", "", preferred=("vertical",))
    of_machine = fit is not None and fit.fitted.machine is not None
    # an option of the other kind of plan would be thought to count
    others = {"limit": bool(limit)}
    if of_machine:
        others = {"height": height != "3:8", "speed": speed != 2.0, "acceleration": acceleration != 3.0}
        others |= {"tilt": tilt != 20.0, "mavsdk": bool(mavsdk), "qgc": bool(qgc), "rotorpy": bool(rotorpy)}
    strange = [name for name, given in others.items() if given]
    if strange:
        which = "a machine" if of_machine else "a flight of the vertical motion"
        raise UsageError(f"options of a plan of {which}", f"--{strange[0]}", "Leave it out.")
    limits: FlightLimits | dict[str, tuple[float, ...]] = parsing.channel_limits(limit)
    if not of_machine:
        low, high = parse_pair(height)
        if not -math.inf < low < high < math.inf:
            expected = "--height LOW:HIGH with both ends, LOW below HIGH"
            raise UsageError(expected, f"'{height}'", "Such as 3:8, in metres above the place of take-off.")
        limits = FlightLimits((low, high), speed, acceleration, tilt, time)
    shape = shape or ("steps" if qgc else "")
    with cli.step("Planning"):
        result = planned(fit or vehicle, target=for_what, limits=limits, shape=shape, seed=seed, seconds=time)
    position = parsing.position_of(home) if home else None
    if isinstance(result, MachinePlan):
        texts = {csv: result.csv_text()} if csv else {}
    else:
        texts = {files[name]: WRITTEN[name].text(result, position) for name in WRITTEN if files.get(name)}
    cli.deliver_result(
        lambda: on_terminal(plan_document(result)),
        lambda: json_text(plan_json(result)),
        json,
        *(partial(cli.write_out, text, path) for path, text in texts.items()),
    )
    if not result.is_informative:
        remedy = "Give it more time, or wider limits."
        cli.complain("The plan is not identified in most of its simulations, or by the formula.", remedy)
    return cli.ExitCode.IDENTIFIED if result.is_informative else cli.ExitCode.NOT_IDENTIFIED


def _vehicle(source: str, rough: dict[str, float | None]) -> VehicleGuess | Path:
    typed = {name: value for name, value in rough.items() if value is not None}
    if source and typed:
        received = f"'{source}' and {', '.join(f'--{name}' for name in typed)}"
        raise UsageError("a result, or rough numbers as options", received, "Leave out one of them.")
    numbers: dict[str, Any] = {ROUGH[name]: value for name, value in typed.items()}
    return Path(source) if source else VehicleGuess(**numbers)


NEW_FILE = cli.option("all new_file")


def _shipped_group(
    noun: str,
    about: str,
    titles: tuple[str, ...],
    rows: Callable[[], Iterable[tuple[str, ...]]],
    load: Callable[[str], object],
    text: Callable[[str], str],
) -> typer.Typer:
    app, option = cli.group(noun, about), cli.option(f"{noun} show")

    @cli.command(app, "list", f"List the {noun}s that come with Eivor.")
    def list_shipped() -> None:
        cli.show_table(titles, rows())

    @cli.command(app, about=f"Check a {noun}'s file, and print it.")
    def show(file: Annotated[str, cli.Reads()] = option) -> None:
        load(file)
        cli.write(text(file))

    return app


def _write_template(noun: str, text: str, file: str) -> None:
    is_file = file != cli.STANDARD_OUTPUT
    if is_file and Path(file).suffix != ENDING:
        raise UsageError(f"{noun} file that ends in {ENDING}", f"'{file}'", "Add the ending.")
    if is_file and os.path.lexists(file):
        received = f"'{file}', which would be lost"
        raise UsageError("a file that does not exist yet", received, "Choose another name.")
    cli.write_out(text, file)
    if is_file:
        cli.write(f"{file}: fill in what you know\n")


vehicle = _shipped_group(
    "vehicle",
    "Vehicle files: what is known of a vehicle before its flight is identified.",
    ("name", "what it is"),
    lambda: ((name, vehicle_files.load_vehicle(name).name) for name in vehicle_files.shipped_vehicles()),
    vehicle_files.load_vehicle,
    vehicle_files.vehicle_text,
)


@cli.command(vehicle, "new")
def new_vehicle(file: Annotated[str, NEW_FILE, cli.Writes()] = cli.STANDARD_OUTPUT) -> None:
    """Write a vehicle file to begin with: every key, with what it means."""
    _write_template("a vehicle", vehicle_files.vehicle_template(), file)


machine = _shipped_group(
    "machine",
    "Machines: equations whose parameters are identified from logs.",
    ("name", "what it is", "equation"),
    lambda: (
        (name, item.title, item.equation[0]) for name in shipped_machines() for item in [load_machine(name)]
    ),
    load_machine,
    machine_text,
)


@cli.command(machine, "new")
def new_machine(
    file: Annotated[str, NEW_FILE, cli.Writes()] = cli.STANDARD_OUTPUT,
    *,
    like: Annotated[str, cli.option("machine new like")] = "rover",
) -> None:
    """Write a machine's file to begin with: a shipped one, to be changed."""
    checks.index_of("a machine", like, shipped_machines())
    _write_template("a machine", machine_text(like), file)


def track(typed: SimpleNamespace) -> cli.ExitCode:
    """Do what `eivor.cli.options.track` declares."""
    motions = parsing.named_motions("" if typed.machine else DEFAULT_MODEL, machine=typed.machine)
    picture, bias = cli.figure_file(typed.figure), typed.accelerometer_bias
    words = parsing.words_of(FlightWords, vars(typed) | {"accelerometer_bias": None})
    options = parsing.flight_options(motions, words)
    if bias is not None:
        options = replace(options, accelerometer_bias=bias)
    logs = parsing.words_of(LogWords, vars(typed) | {"logs": [typed.log] if typed.log else None})
    result = parsing.pooled_result(motions, options, logs)
    with cli.step("Following it over the log"):
        tracked = tracked_parameter(result.first, typed.memory, typed.parameter)
    cli.deliver_result(
        lambda: on_terminal(track_document(tracked)),
        lambda: json_text(track_json(tracked)),
        typed.json,
        figure_part(picture, lambda: track_figure(tracked)),
    )
    return cli.ExitCode.IDENTIFIED if tracked.precise_moments else cli.ExitCode.NOT_IDENTIFIED


def validate(typed: SimpleNamespace) -> cli.ExitCode:
    """Do what `eivor.cli.options.validate` declares."""
    picture = cli.figure_file(typed.figure)
    options = FlightOptions(window=parsing.parse_window(typed.window) if typed.window else None)
    fits = load_fits(typed.fit)
    result = fit_among(fits, typed.model, preferred=tuple(fits))
    others = [name for name, other in fits.items() if other is not result and other.estimated is not None]
    if others and not typed.model:
        sentence = f"compared is the first motion of {typed.fit.name}; others: --model {' or '.join(others)}"
        cli.complain(sentence)
    if result.document.prediction is not None:
        _ = result.motion  # whose channels the log may have
    logs = LogWords(logs=[typed.log], channel_map=typed.channel_map)
    (recording,), (own_window,) = parsing.read_logs(logs, options)
    with cli.step(f"Predicting {recording.name}"):
        window = own_window or options.window
        validation = validated(result, recording, window=window, max_tilt_deg=typed.max_tilt)
    cli.deliver_result(
        lambda: on_terminal(validation_document(validation)),
        validation.to_json,
        typed.json,
        figure_part(picture, validation.plot),
    )
    return cli.ExitCode.IDENTIFIED if validation.agrees else cli.ExitCode.NOT_IDENTIFIED


def frequency_response(typed: SimpleNamespace) -> cli.ExitCode:
    """Do what `eivor.cli.options.frequency_response` declares."""
    picture = cli.figure_file(typed.figure)
    declared_machine = load_machine(typed.machine) if typed.machine else None
    paths = frequency_responses.response_paths(typed.axis, declared_machine)
    motions, words = tuple(path.motion for path in paths.values()), parsing.words_of(FlightWords, vars(typed))
    options = parsing.flight_options(motions, words)
    recordings, windows = parsing.read_logs(parsing.words_of(LogWords, vars(typed)), options)
    with cli.step("Estimating the frequency response"):
        results = frequency_responses.log_responses(recordings, options, windows, paths, typed.reference)
    cli.deliver_result(
        lambda: on_terminal(*map(frequency_responses.response_document, results)),
        lambda: json_text(frequency_responses.responses_json(results)),
        typed.json,
        figure_part(picture, lambda: frequency_responses.response_figure(results)),
    )
    any_shown = any(item.response.is_shown.any() and not item.response.is_provisional for item in results)
    return cli.ExitCode.IDENTIFIED if any_shown else cli.ExitCode.NOT_IDENTIFIED
