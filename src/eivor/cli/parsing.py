"""Parsing of command line and page options into library objects."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from types import SimpleNamespace
from typing import Any, TypeVar

import msgspec

from eivor import checks
from eivor.cli.options import NEEDS, FlightWords, LogWords, parse_pair
from eivor.cli.outputs import step
from eivor.errors import EivorError, MissingChannelError, UsageError, did_you_mean
from eivor.estimation.methods import by_name
from eivor.flights.lag_prior import EFFECTIVE_LAG, NO_LAG, TYPICAL_LAGS
from eivor.flights.motion import Motion
from eivor.flights.options import ACCELEROMETER_BIAS, FIT_MAP, FlightOptions
from eivor.flights.prepare import check_options
from eivor.flights.references import ESTIMATE, Declared
from eivor.flights.result import LogEstimate
from eivor.inference.verdict import Status
from eivor.logs import read_log
from eivor.logs.common import UNITS, unit_fits
from eivor.logs.read import EXAMPLE_FLIGHT, example_flight, here, path_of
from eivor.models.separable import Bounds, Prior
from eivor.motions.declaration import load_machine
from eivor.motions.identify import identify_log, motions_of
from eivor.report.flight import logging_advice_for, missing_channels
from eivor.signals.channels import canonical_channel, family_members
from eivor.signals.recording import DataSheet, Recording, interval_within
from eivor.tools import Progress, no_stage_callback

Window = tuple[float, float]
Words = TypeVar("Words", bound=msgspec.Struct)


def log_argument(text: str) -> tuple[Path, Window | None]:
    """Path and window of ``LOG`` or ``LOG@START:END``; a file that exists under the whole name wins."""
    name, index, tail = text.rpartition("@")
    if not index or not name or ":" not in tail or os.path.lexists(text):
        return path_of(text), None
    return path_of(name), parse_window(tail)


def parse_window(text: str) -> Window:
    """Window of ``START:END`` in seconds; an end left out is that of the log."""
    start, end = parse_pair(text)
    if not start < end:
        remedy = "Give both in seconds from the log's start, such as 4:67; one of them may be left out."
        raise UsageError("a window START:END with START before END", f"'{text}'", remedy)
    return start, end


#: What a class of vehicles stands behind.
TYPICAL = "typical:"


def parse_lag(text: str) -> Prior | Bounds:
    """What is known of a lag [s], of ``MS:STD``, ``LOW..HIGH``, ``typical:CLASS`` or ``none``."""
    if text.strip().lower() == "none":
        return NO_LAG
    if text.startswith(TYPICAL):
        name = text.removeprefix(TYPICAL)
        checks.index_of("a class of vehicles", name, TYPICAL_LAGS, "Or give the lag: --lag 70:15.")
        return TYPICAL_LAGS[name]
    bounded = ".." in text
    numbers = parse_pair(text, ".." if bounded else ":", (math.nan, math.nan))
    first, second = (1e-3 * number for number in numbers)
    if 0.0 < (second if bounded else first) < 1e-3:  # no actuator is so quick
        likely = (".." if bounded else ":").join(f"{1e3 * number:g}" for number in numbers)
        raise UsageError("a lag in milliseconds", f"'{text}', less than one", f"Of seconds: --lag {likely}.")
    if bounded and 0.0 <= first <= second < math.inf:
        return Bounds(first, second)
    if not bounded and 0.0 < first < math.inf and 0.0 < second < math.inf:
        return Prior(first, second)
    raise UsageError(
        "a lag MS:STD, mean and standard deviation in milliseconds, both above zero; or bounds LOW..HIGH; or "
        "typical:CLASS; or none",
        f"'{text}'",
        "Give 70:15 or 50..90, for example.",
    )


def parse_names(text: str) -> tuple[str, ...]:
    """Names of a list with commas."""
    result = tuple(name.strip() for name in text.split(",") if name.strip())
    if not result or (len(result) > 1 and {"references", "lags"} & set(result)):
        expected = "instruments: references, lags, or names of channels with commas between them"
        remedy = "Give references or lags alone. `eivor inspect LOG` lists the channels."
        raise UsageError(expected, f"'{text}'", remedy)
    return result


@contextmanager
def named(name: str, *, several: bool) -> Iterator[None]:
    """Say in an error which of several logs it is about, unless it does so already."""
    try:
        yield
    except EivorError as error:
        if not several or Path(name).name in str(error):
            raise
        raise type(error)(error.expected, f"{error.received}, in {name}", error.remedy) from error


def named_flights(
    paths: Sequence[Path],
    windows: Sequence[Window | None],
    recordings: Sequence[Recording],
    options: FlightOptions,
) -> list[Recording]:
    """Recordings of one file name named by paths, and parts of a log by windows; these are checked."""
    of_name = {recording.name: set[Path]() for recording in recordings}
    for path, recording in zip(paths, recordings, strict=True):
        of_name[recording.name].add(path)
    renamed = []
    for path, window, recording in zip(paths, windows, recordings, strict=True):
        name = str(path) if len(of_name[recording.name]) > 1 else recording.name
        if paths.count(path) > 1 and window is not None:
            name += f"@{window[0]:g}:{window[1]:g}"
        renamed.append(recording if name == recording.name else replace(recording, name=name))
        used = window or options.window
        if used is not None:
            with named(name, several=len(recordings) > 1):
                interval_within(used, recording.span_s)
    return renamed


def identified(
    recordings: list[Recording],
    motions: Motions,
    options: FlightOptions,
    windows: list[Window | None],
    progress: Progress = no_stage_callback,
) -> LogEstimate:
    """Results of the logs."""
    for recording in recordings:
        allowed = {"references", "lags", *recording.channels}
        absent = ", ".join(f"'{name}'" for name in options.instruments if not family_members(name, allowed))
        if absent:
            remedy = "Name some that eivor inspect lists, or references, or lags."
            remedy = did_you_mean(absent.strip("'"), allowed, remedy)
            raise UsageError(f"channels of {recording.name} as instruments", absent, remedy)
    try:
        return identify_log(recordings, options, windows=windows, models=motions, progress=progress)
    except MissingChannelError as error:
        missing = ((log, channel) for log in recordings for channel in missing_channels(log, motions[0]))
        advice = (sentence for log, channel in missing for sentence in logging_advice_for(log, channel))
        remedy = " ".join((error.remedy, *dict.fromkeys(advice)))
        raise MissingChannelError(error.expected, error.received, remedy) from error


def words_of(kind: type[Words], given: Mapping[str, Any]) -> Words:
    """Options of one kind among those that were typed."""
    return kind(**{name: value for name, value in given.items() if name in kind.__struct_fields__})


def read_logs(words: LogWords, options: FlightOptions) -> tuple[list[Recording], list[Window | None]]:
    """Recordings of what was typed, and the window of each that has one of its own."""
    logs, channel_map = [log_argument(text) for text in words.logs or ()], words.channel_map
    windows = [window for _, window in logs] or [None]
    if words.example == bool(logs):
        remedy = "Name a file such as flight.ulg, or try the command with --example."
        raise UsageError("one or more logs, or --example", "both" if words.example else "neither", remedy)
    if words.example and channel_map:
        remedy = "Leave the map out: the example has canonical channels."
        raise UsageError("--map with a log", f"--example with --map {channel_map}", remedy)
    loaded, paths = {}, [path for path, _ in logs]
    for path in dict.fromkeys(paths):
        typed = str(path)
        with step(f"Reading {path.name}"), named(typed, several=len(logs) > 1), here(typed) as file:
            loaded[path] = read_log(file, channel_map=channel_map or None)
    recordings = [loaded[path] for path in paths]
    if words.example:
        paths, recordings = [Path(EXAMPLE_FLIGHT)], [example_flight()]
    return named_flights(paths, windows, recordings, options), windows


def result_of(typed: SimpleNamespace) -> tuple[LogEstimate, tuple[str, ...]]:
    """Read logs and identify them, as typed; and what is needed."""
    logs, words = words_of(LogWords, vars(typed)), words_of(FlightWords, vars(typed))
    motions = named_motions(logs.model, logs.vehicle, logs.machine)
    options, needed = flight_options(motions, words), parse_needs(typed.needs, motions)
    return pooled_result(motions, options, logs), needed


def pooled_result(motions: Motions, options: FlightOptions, logs: LogWords) -> LogEstimate:
    """Read logs and identify them with options of the library."""
    recordings, windows = read_logs(logs, options)
    several = len(recordings) > 1
    with step(f"{len(recordings)} flights together" if several else recordings[0].name) as progress:
        return identified(recordings, motions, options, windows, progress)


_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf))\s*(.*)", re.IGNORECASE)
_SHEET = ("density", "bandwidth", "step")
_REMEDY = (
    "Give --noise velocity_z=0.02, with a unit where it is not SI (2cm/s), --noise "
    "velocity_z=density:0.002,bandwidth:50,step:0.01, or --noise estimate."
)


def declared_noise(texts: Iterable[str]) -> Mapping[str, Declared] | str | None:
    """Noise by channel of ``NAME=STD``, ``NAME=density:D,bandwidth:HZ,step:S``, or ``estimate``."""
    entries, noises = [text.strip() for text in texts], dict[str, Declared]()
    if entries == [ESTIMATE]:
        return ESTIMATE
    if ESTIMATE in entries:
        raise UsageError("--noise estimate alone", f"{len(entries)} of --noise", "Leave out the others.")
    for text in entries:
        name, values = (part.strip() for part in text.partition("=")[::2])
        if name in noises:
            raise UsageError("the noise of a channel once", f"{name} twice", "Leave out one of them.")
        if not name or not values:
            raise UsageError("a noise NAME=STD", f"'{text}'", _REMEDY)
        noises[name] = _declared(name, [value.strip() for value in values.split(",")])
    return noises or None


def _declared(name: str, values: list[str]) -> Declared:
    if len(values) == 1 and ":" not in values[0]:
        return _size(name, values[0], "standard deviation")
    sheet: dict[str, float] = {}
    for value in values:
        word, _, number = value.partition(":")
        if word not in _SHEET:
            remedy = did_you_mean(word, _SHEET, _REMEDY)
            raise UsageError(f"of the data sheet of {name}: {', '.join(_SHEET)}", f"'{value}'", remedy)
        if word == "bandwidth":
            sheet["bandwidth_hz"] = _number(name, number.strip().removesuffix("Hz"), "bandwidth in Hz")[0]
        else:
            sheet[word] = _size(name, number, word)
    if not (sheet.get("density") or sheet.get("step")):
        expected = f"a noise density or a quantisation step above zero of the data sheet of {name}"
        raise UsageError(expected, f"'{','.join(values)}'", _REMEDY)
    return DataSheet(**sheet)


def _number(name: str, text: str, kind: str) -> tuple[float, str]:
    matched = _NUMBER.fullmatch(text)
    if matched is None or not 0.0 <= float(matched[1]) < math.inf:
        raise UsageError(f"a {kind} of zero or more for {name}", f"'{text}'", _REMEDY)
    return float(matched[1]), matched[2].strip()


def _size(name: str, text: str, kind: str) -> float:
    """A size in the channel's SI unit; a noise density may be in its unit over the root of a hertz."""
    value, unit = _number(name, text, kind)
    if kind == "density":
        unit = unit.removesuffix("/sqrt(Hz)").removesuffix("/rtHz")
    if not unit:
        return value
    channel = canonical_channel(name)
    si_unit, to_si = UNITS.get(unit, ("", math.nan))
    if math.isnan(to_si) or (channel is not None and not unit_fits(channel, si_unit)):
        expected = f"{channel.unit}, or a unit of that kind" if channel and channel.unit else "its unit"
        remedy = f"Units are {', '.join(word for word in UNITS if word)}."
        raise UsageError(f"a {kind} of {name} in {expected}", f"'{text}', in {unit}", remedy)
    return value * to_si


Motions = Sequence[Motion[Any]]


def named_motions(name: str, vehicle: str = "", machine: str = "") -> tuple[Motion[Any], ...]:
    """Return the motion of a name or a machine, else the usual ones, of a vehicle where one is given."""
    if not machine:
        return motions_of((name,) if name else (), vehicle)
    if name or vehicle:
        typed = f"--vehicle {vehicle}" if vehicle else f"--model {name}"
        raise UsageError("--machine alone", f"--machine {machine} with {typed}", "Leave out one of them.")
    return (load_machine(machine),)


def parse_needs(text: str, motions: Motions) -> tuple[str, ...]:
    """What must be identified, as typed for --for: words of needs and names of quantities."""
    needs = tuple(need.strip() for need in text.split(",")) if text else ()
    every = [(motion.name, name, spec) for motion in motions for name, spec in motion.quantities.items()]
    quantities = {key: spec for model, name, spec in every for key in (name, f"{model}.{name}")}
    words = dict.fromkeys(need for need in NEEDS if any(spec.need == need for spec in quantities.values()))
    for need in needs:
        if need not in (*words, *quantities):
            remedy = did_you_mean(need, (*words, *quantities), "Quantities are those of the JSON.")
            raise UsageError(f"--for {', '.join(words)}, or names of quantities", f"'{need}'", remedy)
    return needs


def flight_options(motions: Motions, words: FlightWords) -> FlightOptions:
    """Options of the library, checked before any log is read."""
    chosen = by_name(words.method)
    if words.instruments and not (words.compare or chosen.of_flights.needs_instruments):
        expected = "--instruments with a method that has instruments, or with --compare"
        remedy = f"Leave them out: {words.method} uses none."
        raise UsageError(expected, f"--instruments {words.instruments} with --method {words.method}", remedy)
    if words.accelerometer_bias is not None and words.input_map != FIT_MAP:
        received = f"--input-map {words.input_map}" if words.input_map else "it alone"
        remedy = "Leave it out."
        raise UsageError("--accelerometer-bias with --input-map fit, which rests on it", received, remedy)
    bias = ACCELEROMETER_BIAS if words.accelerometer_bias is None else words.accelerometer_bias
    options = FlightOptions(
        window=parse_window(words.window) if words.window else None,
        input=words.input_channel,
        input_map=words.input_map,
        instruments=parse_names(words.instruments) if words.instruments else (),
        method=words.method,
        compare=words.compare,
        lag=lag_prior(words.lag, words.lag_from),
        align=words.align,
        accelerometer_bias=bias,
        pool_friction=words.pool_friction,
        pool_anyway=words.pool_anyway,
        terms=tuple(words.terms),
        rotor_radius=words.rotor_radius,
        controller_rate_hz=words.controller_rate,
        order=None if words.order == "auto" else int(words.order),
        noise=declared_noise(words.noise),
    )
    _check_for_any(motions, options)
    if words.max_tilt is None:
        return options
    # what is not finite is refused in the library's words
    return replace(options, max_tilt_deg=words.max_tilt if math.isfinite(words.max_tilt) else 0.0)


def _check_for_any(motions: Motions, options: FlightOptions) -> None:
    errors = []
    for motion in motions:
        try:
            check_options(motion, options)
        except UsageError as error:
            errors.append(error)
    if len(errors) == len(motions):
        raise errors[0]


def lag_prior(text: str, file: str) -> Prior | Bounds | None:
    """Return what is known of the lag: as typed, or from another flight's JSON; None for nothing."""
    if text and file:
        raise UsageError("--lag or --lag-from", "both", "Leave out one of them.")
    if text:
        return parse_lag(text)
    if not file:
        return None
    # an entry point of the report: most flights are identified without another's result
    fits = resolve_name("eivor.report.saved_fit:load_fits")(file).values()
    lags = [fit.quantities[EFFECTIVE_LAG] for fit in fits if EFFECTIVE_LAG in fit.quantities]
    result = max(lags, key=lambda lag: lag.verdict is Status.IDENTIFIED, default=None)
    if result is None or result.verdict is Status.REFUSED or not 0.0 < result.half_width < math.inf:
        received = "one without" if result is None else f"one whose lag is {result.verdict.value}"
        remedy = "Give the lag by --lag MS:STD, or the result of a flight that identifies it."
        raise UsageError(f"a result in '{file}' that identifies the effective lag", received, remedy)
    # half a 95 % interval, the choice of the delay included, is two standard deviations at most
    return Prior(result.value, max(result.half_width / 2.0, result.std_error))


def check_mission(qgc: str, home: str, shape: str) -> None:
    """Refuse a mission without a place, a place without a mission."""
    if bool(qgc) != bool(home):
        remedy = "A mission of QGroundControl is at a place: --qgc flight.plan --home 47.3977,8.5456."
        raise UsageError("--qgc FILE.plan together with --home LAT,LON", "one without the other", remedy)
    if qgc and shape not in ("", "steps"):
        raise UsageError("--shape steps with --qgc", f"--shape {shape}", "A mission has levels only.")


def position_of(text: str) -> tuple[float, float]:
    """Place of ``LAT,LON`` [deg]."""
    position = parse_pair(text, ",", (math.nan, math.nan))
    if any(map(math.isnan, position)):
        raise UsageError("--home LAT,LON in degrees", f"'{text}'", "Such as 47.3977,8.5456.")
    return position


def channel_limits(texts: list[str]) -> dict[str, tuple[float, ...]]:
    """Limits of a planned machine of ``NAME=SIZE[:RATE[:ACCELERATION]]``."""
    results = {}
    for text in texts:
        name, _, numbers = text.partition("=")
        try:
            results[name.strip()] = tuple(map(float, numbers.split(":")))
        except ValueError:
            remedy = "Such as reference_heading=0.5."
            raise UsageError("a limit NAME=SIZE[:RATE[:ACCELERATION]]", f"'{text}'", remedy) from None
    return results
