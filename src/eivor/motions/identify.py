"""Identification of a flight by the name of a motion, and the signals of a log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from os import PathLike
from types import NoneType
from typing import Any, TypedDict, Unpack

from eivor import checks
from eivor.errors import UsageError, did_you_mean
from eivor.flights.identify import identified, with_coupled_axes
from eivor.flights.motion import Motion, of_vehicle
from eivor.flights.options import FlightOptions, check_window
from eivor.flights.prepare import prepare
from eivor.flights.prepared import mask_of
from eivor.flights.references import Declared
from eivor.flights.result import FlightEstimate
from eivor.models.separable import Bounds, Prior
from eivor.motions.table import DEFAULT, motion_by_name
from eivor.signals.recording import Recording
from eivor.signals.signals import Signals
from eivor.tools import Progress, no_stage_callback

# -- Identify --

#: What to say to those who give something else than recordings.
READ_FIRST = 'Read the file first: ev.identify_flight(ev.read_log("flight.ulg")).'


class OptionChoices(TypedDict, total=False):
    """Fields of `FlightOptions`, named one by one."""

    window: tuple[float, float]
    max_tilt_deg: float
    input: str
    input_map: str
    instruments: tuple[str, ...]
    method: str
    compare: bool
    lag: Prior | Bounds | None
    align: bool
    accelerometer_bias: float
    pool_friction: str
    pool_anyway: bool
    terms: tuple[str, ...]
    rotor_radius: float | None
    controller_rate_hz: float | None
    noise: Mapping[str, Declared] | str | None


def identify_flight(
    recordings: Recording | Sequence[Recording],
    options: FlightOptions | None = None,
    *,
    windows: Sequence[tuple[float, float] | None] | None = None,
    model: str | Motion[Any] = DEFAULT,
    vehicle: str | PathLike[str] = "",
    progress: Progress = no_stage_callback,
    **choices: Unpack[OptionChoices],
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
    model : str or Motion
        What to identify: "vertical", "rates", "rigid-body", the name of a motion that another package
        brings, or a motion itself.
    vehicle : str or path, optional
        What flies, for motions that ask: the name of a shipped vehicle, or a vehicle file.
    progress : callable
        Called with what begins: "preparing", "identifying", "diagnosing".
    **choices
        Fields of `FlightOptions`, one by one: ``window=(20, 80)``, ``max_tilt_deg=15``, ``input=``,
        ``input_map=``, ``instruments=``, ``method=``, ``compare=``, ``lag=``, ``align=``,
        ``accelerometer_bias=``, ``pool_friction=``, ``terms=("quadratic-drag",)``, ``rotor_radius=``,
        ``controller_rate_hz=``, ``noise={"velocity_z": 0.02}``.

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
    given = [recordings] if isinstance(recordings, Recording | str) else recordings
    checks.kind("recordings", given, Iterable, "a Recording or several", READ_FIRST)
    logs = list(given)
    if not all(isinstance(log, Recording) for log in logs):
        raise UsageError("recordings", ", ".join(sorted({type(log).__name__ for log in logs})), READ_FIRST)
    if not logs:
        raise UsageError("at least one recording", "none", "Give one or several.")
    motion = motion_by_name(model) if isinstance(model, str) else model
    if not isinstance(motion, Motion):
        raise UsageError(
            "the name of a motion, or a motion", f"{type(motion).__name__}", 'The default is "vertical".'
        )
    checks.kind("vehicle", vehicle, (str, PathLike), "the name of a vehicle, or a file", "Name one.")
    if not callable(progress):
        raise UsageError("a function of what begins", checks.described(progress), "Give progress=print.")
    if vehicle:
        motion = of_vehicle(motion, str(vehicle))
    chosen = _chosen(options, choices)
    if windows is None:
        windows = [None] * len(logs)
    elif "window" in choices:
        raise UsageError("one window, or a window for each log", "both", "Give either window= or windows=.")
    checks.items("windows", windows, (tuple, list, NoneType), "windows", "Give (START, END), or None.")
    for window in windows:
        if window is not None:
            check_window(window)
    others = tuple(motion_by_name(name) for name in motion.abilities.lag_from)
    result = identified(logs, motion, chosen, list(windows), others, progress=progress)
    neighbours = {
        coupled_axis.motion: motion_by_name(coupled_axis.motion)
        for coupled_axis in motion.abilities.coupled_axes
    }
    return with_coupled_axes(result, neighbours, logs, list(windows))


def _chosen(options: FlightOptions | None, choices: OptionChoices) -> FlightOptions:
    start = FlightOptions() if options is None else options
    checks.kind("options", start, FlightOptions, "FlightOptions", "Give ev.FlightOptions(...), or nothing.")
    known = {field.name: field.default for field in fields(FlightOptions)}
    unknown = [name for name in choices if name not in known]
    if unknown:
        raise UsageError(
            f"choices out of {', '.join(known)}",
            ", ".join(f"'{name}'" for name in unknown),
            did_you_mean(unknown[0], known, "Name one of them."),
        )
    twice = [name for name in choices if getattr(start, name) != known[name]]
    if twice:
        raise UsageError(
            "each choice once", f"{', '.join(twice)} in options= and by name", "Leave out one of them."
        )
    return replace(start, **choices)


# -- Log signals --


def log_signals(
    log: Recording,
    *,
    actuator_lag: float = 0.0,
    delay: float = 0.0,
    model: str = DEFAULT,
    **choices: Unpack[OptionChoices],
) -> Signals:
    """The log on one grid, z up, as its flight is identified from, for work in Python.

    Parameters
    ----------
    log : Recording
        What `eivor.read_log` returns.
    actuator_lag, delay : float
        Of the actuators [s], put into the channel `input`: the mean of the mapped commands times the
        cosine of tilt. A measured state of the actuators has no lag.
    model : str
        Motion whose channels are wanted.
    **choices
        Fields of `FlightOptions`: ``window=``, ``max_tilt_deg=``, ``input=``, ``input_map=``,
        ``noise={"velocity_z": 0.02}``.

    Returns
    -------
    Signals
        Samples that the flight cannot use are not valid. Noises are those that are declared, and of other
        channels those that their fastest part shows; commands are exact.

    Raises
    ------
    InputError
        When a channel that the motion needs is absent.
    UsageError
        For choices that do not fit.
    """
    checks.kind("log", log, Recording, "a recording", READ_FIRST)
    for name, value in {"actuator_lag": actuator_lag, "delay": delay}.items():
        checks.number(name, value)
        if not 0.0 <= value <= 1.0:
            raise UsageError(f"a {name} between 0 and 1 s", f"{value:g}", "Give it in seconds.")
    motion = motion_by_name(model)
    flight = prepare(log, motion, FlightOptions(**choices))
    used = mask_of(flight.runs, flight.usable.size) & flight.usable
    made = motion.abilities.signals
    signals = flight.signals if made is None else made(flight, actuator_lag, delay)
    return replace(signals, valid=used)
