"""Identification of a flight by the name of a motion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from functools import cache
from os import PathLike
from types import MappingProxyType, NoneType
from typing import Any

from eivor import checks
from eivor.errors import EivorError, InputError, PoolingError, UsageError
from eivor.flights.estimate import FlightState
from eivor.flights.identify import identified, with_coupled_axes
from eivor.flights.motion import Motion, of_vehicle
from eivor.flights.options import FlightOptions, check_window
from eivor.flights.prepare import Window
from eivor.flights.result import FlightEstimate, LogEstimate
from eivor.motions.table import DEFAULT, USUAL_MOTIONS, motion_by_name
from eivor.signals.recording import Recording
from eivor.tools import Progress, no_stage_callback

READ_FIRST = 'Read the file first: ev.identify_flight(ev.read_log("flight.ulg")).'


def identify_flight(
    recordings: Recording | Sequence[Recording],
    options: FlightOptions | None = None,
    *,
    windows: Sequence[tuple[float, float] | None] | None = None,
    model: str | PathLike[str] | Motion[Any] = DEFAULT,
    vehicle: str | PathLike[str] = "",
    progress: Progress = no_stage_callback,
    **choices: Any,
) -> FlightEstimate:
    """Identify a motion from a flight, or from several flights of one vehicle together.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        From `read_log`. Several are pooled: gain and lag are shared; friction and intercepts are not.
        A log given twice is used once.
    options : FlightOptions, optional
        Default: the recipe's.
    windows : sequence of (start, end) or None, optional
        A window [s] for each recording, in place of the options' for those that have one.
    model : str, path or Motion
        What to identify: "vertical", "rates", "rigid-body", the name of a motion that another package
        brings, a machine's file, or a motion itself.
    vehicle : str or path, optional
        What flies, for motions that ask: the name of a shipped vehicle, or a vehicle file.
    progress : callable
        Called with what begins: "preparing", "identifying", "diagnosing".
    **choices
        Fields of `FlightOptions`, one by one: ``window=(20, 80)``, ``max_tilt_deg=15``, ``input=``,
        ``input_map=``, ``instruments=``, ``method=``, ``compare=``, ``lag=``, ``align=``,
        ``accelerometer_bias=``, ``pool_friction=``, ``terms=("quadratic-drag",)``, ``rotor_radius=``,
        ``controller_rate_hz=``, ``order=``, ``noise={"velocity_z": 0.02}``.

    Returns
    -------
    FlightEstimate
        Also when the flight cannot identify: see its verdict.

    Raises
    ------
    InputError
        When a channel that is needed is absent.
    UsageError
        For options that do not fit, windows outside a log among them, for unknown motions, and for a
        choice that is given twice.
    PoolingError
        When the flights are of vehicles with different input maps or parameters.
    """
    motion = motion_by_name(model) if isinstance(model, str | PathLike) else model
    checks.kind("model", motion, Motion, "the name of a motion, or a motion", 'The default is "vertical".')
    checks.kind("vehicle", vehicle, (str, PathLike), "the name of a vehicle, or a file", "Name one.")
    if vehicle:
        motion = of_vehicle(motion, str(vehicle))
    return _result(motion, _task(recordings, options, windows, progress, choices))


def identify_log(
    recordings: Recording | Sequence[Recording],
    options: FlightOptions | None = None,
    *,
    windows: Sequence[tuple[float, float] | None] | None = None,
    models: Sequence[str | PathLike[str] | Motion[Any]] = (),
    vehicle: str | PathLike[str] = "",
    progress: Progress = no_stage_callback,
    **choices: Any,
) -> LogEstimate:
    """Identify every motion that a log supports, or several flights of one vehicle together.

    Parameters
    ----------
    recordings, options, windows, progress, **choices
        As of `identify_flight`.
    models : sequence of str, path or Motion, optional
        What to identify; default: the vertical motion, turning, and with a vehicle the rigid body.
    vehicle : str or path, optional
        What flies: the name of a shipped vehicle, or a vehicle file.

    Returns
    -------
    LogEstimate
        The result of each motion, and of every other why the log, or an option, does not support it.

    Raises
    ------
    InputError, UsageError
        As of `identify_flight` for the first motion, when no motion is supported.
    PoolingError
        When the flights are of different vehicles.
    """
    checks.kind("vehicle", vehicle, (str, PathLike), "the name of a vehicle, or a file", "Name one.")
    motions = motions_of(models, str(vehicle))
    task = _task(recordings, options, windows, progress, choices)
    results: dict[str, FlightEstimate] = {}
    errors: dict[str, EivorError] = {}
    states: dict[str, FlightState] = {}
    for motion in motions:
        try:
            results[motion.name] = _result(motion, task, results, states)
        except PoolingError:
            raise
        except (InputError, UsageError) as error:
            errors[motion.name] = error
    if not results:
        raise next(iter(errors.values()))
    return LogEstimate(results, {name: str(error) for name, error in errors.items()})


def motions_of(
    models: Sequence[str | PathLike[str] | Motion[Any]], vehicle: str = ""
) -> tuple[Motion[Any], ...]:
    """Motions that are named, else the usual ones; of a vehicle those that depend on it."""
    checks.items(
        "models", models, (str, PathLike, Motion), "names of motions, or motions", 'Give ("vertical",).'
    )
    named = models or (USUAL_MOTIONS if not vehicle else (*USUAL_MOTIONS, "rigid-body"))
    motions = [motion_by_name(model) if isinstance(model, str | PathLike) else model for model in named]
    if vehicle and all(motion.abilities.vehicle is None for motion in motions):
        of_vehicle(motions[0], vehicle)  # refuses
    return tuple(of_vehicle(m, vehicle) if vehicle and m.abilities.vehicle else m for m in motions)


#: Flights that are identified, how, and whom to say what begins; checked.
Task = tuple[list[Recording], FlightOptions, list[Window], Progress]


def _result(
    motion: Motion[Any],
    task: Task,
    known: Mapping[str, FlightEstimate] = MappingProxyType({}),
    states: dict[str, FlightState] | None = None,
) -> FlightEstimate:
    """Result of a motion, with what is known and begun of others."""
    logs, options, windows, progress = task
    others = tuple(motion_by_name(name) for name in motion.abilities.lag_from)
    result = identified(logs, motion, options, windows, others, (), progress, states)
    coupled = {axis.motion: motion_by_name(axis.motion) for axis in motion.abilities.coupled_axes}
    return with_coupled_axes(result, coupled, logs, windows, known)


def _task(
    recordings: Any,
    options: FlightOptions | None,
    windows: Any,
    progress: Progress,
    choices: Mapping[str, Any],
) -> Task:
    items = [recordings] if isinstance(recordings, Recording | str) else recordings
    checks.kind("recordings", items, Iterable, "a Recording or several", READ_FIRST)
    logs = list(items)
    if not all(isinstance(log, Recording) for log in logs):
        raise UsageError("recordings", ", ".join(sorted({type(log).__name__ for log in logs})), READ_FIRST)
    if not logs:
        raise UsageError("at least one recording", "none", "Give one or several.")
    checks.function("a function of what begins", progress, "Give progress=print.")
    chosen = _chosen(options, choices)
    if windows is None:
        windows = [None] * len(logs)
    elif "window" in choices:
        raise UsageError("one window, or a window for each log", "both", "Give either window= or windows=.")
    checks.items("windows", windows, (tuple, list, NoneType), "windows", "Give (START, END), or None.")
    for window in (item for item in windows if item is not None):
        check_window(window)
    return logs, chosen, list(windows), cache(progress)  # each stage is reported once


def _chosen(options: FlightOptions | None, choices: Mapping[str, Any]) -> FlightOptions:
    base = FlightOptions() if options is None else options
    checks.kind("options", base, FlightOptions, "FlightOptions", "Give ev.FlightOptions(...), or nothing.")
    known = {field.name: field.default for field in fields(FlightOptions)}
    for name in choices:
        checks.index_of("choices", name, known)
    twice = ", ".join(name for name in choices if getattr(base, name) != known[name])
    if twice:
        raise UsageError("each choice once", f"{twice} in options= and by name", "Leave out one of them.")
    return replace(base, **choices)
