"""Logs as given on the command line, and the options of the recipe: checked, read, and told apart."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eivor.cli import arguments, noise_argument
from eivor.cli.arguments import LogArgument, Window, named
from eivor.cli.terminal import step
from eivor.errors import UsageError

if TYPE_CHECKING:
    from eivor.flights.motion import Motion
    from eivor.flights.options import FlightOptions
    from eivor.models.separable import Bounds, Prior
    from eivor.signals.recording import Recording


@dataclass(frozen=True, slots=True)
class ChosenLogs:
    """What to read.

    Parameters
    ----------
    logs : tuple of LogArgument
        Each with its own window, where it has one.
    example : bool
        The bundled example instead.
    channel_map : str
        Of tables; empty for none.

    Raises
    ------
    UsageError
        When there is nothing to read, both logs and the example, or a map for the example.
    """

    logs: tuple[LogArgument, ...]
    example: bool
    channel_map: str

    def __post_init__(self) -> None:
        if self.example == bool(self.logs):
            raise UsageError(
                "one or more logs, or --example",
                "both" if self.example else "neither",
                "Name a file such as flight.ulg, or try the command with --example.",
            )
        if self.example and self.channel_map:
            raise UsageError(
                "--map with a log",
                f"--example with --map {self.channel_map}",
                "Leave the map out: the example has canonical channels.",
            )

    @property
    def files(self) -> dict[str, list[Path]]:
        """Files that are read, by what they are called in messages."""
        return {
            "the logs": [log.path for log in self.logs],
            "the channel map": [Path(self.channel_map)] if self.channel_map else [],
        }

    def read(self, options: FlightOptions) -> tuple[list[Recording], list[Window | None]]:
        """Recordings, and the window of each that has one of its own; those of one file name told apart.

        A log of which several windows are given is read once: standard input cannot be read again.

        Raises
        ------
        UsageError
            When a window lies outside its log.
        InputError
            With the name of the log that cannot be read.
        """
        if self.example:
            from eivor.logs.example import example_flight

            recordings = [example_flight()]
        else:
            read = {path: self._recording(path) for path in dict.fromkeys(log.path for log in self.logs)}
            recordings = told_apart(self.logs, [read[log.path] for log in self.logs])
        own = [log.window for log in self.logs] or [None]
        check_windows(recordings, [window or options.window for window in own])
        return recordings, own

    def _recording(self, path: Path) -> Recording:
        from eivor.logs import read_log

        with step(f"Reading {path.name}"), named(str(path), several=len(self.logs) > 1):
            return read_log(path, channel_map=self.channel_map or None)


def chosen_logs(texts: list[str] | None, *, example: bool, channel_map: str) -> ChosenLogs:
    """Logs of what was typed, see `ChosenLogs`.

    Raises
    ------
    UsageError
        See there, and when a window is none.
    """
    return ChosenLogs(tuple(map(arguments.log_argument, texts or ())), example, channel_map)


def named_motion(name: str, vehicle: str = "") -> Motion[Any]:
    """Return the motion of a name, of a vehicle where one is given; its channels are known from then on.

    Raises
    ------
    UsageError
        With the motions that there are; and when the motion does not ask what flies.
    """
    from eivor.motions import motion_by_name

    motion = motion_by_name(name)
    return motion.of_vehicle(vehicle) if vehicle else motion


def flight_options(
    motion: Motion[Any],
    *,
    window: str = "",
    max_tilt: float | None = None,
    input_channel: str = "",
    input_map: str = "",
    accelerometer_bias: float | None = None,
    instruments: str = "",
    method: str = "reference_iv",
    compare: bool = False,
    lag: str = "",
    lag_from: str = "",
    align: bool = False,
    pool_friction: str = "auto",
    terms: Sequence[str] = (),
    rotor_radius: float | None = None,
    noise: Sequence[str] = (),
) -> FlightOptions:
    """Options of the library, checked before any log is read.

    Raises
    ------
    UsageError
        When one of them does not exist or makes no sense.
    """
    from eivor.estimation.methods import by_name
    from eivor.flights.options import ACCELEROMETER_BIAS, FIT_MAP, FlightOptions
    from eivor.flights.terms import check_options

    chosen = by_name(method)
    if instruments and not (compare or chosen.of_flights.needs_instruments):
        raise UsageError(
            "--instruments with a method that has instruments, or with --compare",
            f"--instruments {instruments} with --method {method}",
            f"Leave them out: {method} uses none.",
        )
    if max_tilt is not None and not math.isfinite(max_tilt):
        max_tilt = 0.0  # refused below, in the library's words
    if accelerometer_bias is not None and input_map != FIT_MAP:
        raise UsageError(
            "--accelerometer-bias with --input-map fit, which rests on it",
            f"--input-map {input_map}" if input_map else "it alone",
            "Leave it out.",
        )
    options = FlightOptions(
        window=arguments.window(window) if window else None,
        input=input_channel,
        input_map=input_map,
        instruments=arguments.names(instruments) if instruments else (),
        method=method,
        compare=compare,
        lag=given_lag(lag, lag_from),
        align=align,
        accelerometer_bias=ACCELEROMETER_BIAS if accelerometer_bias is None else accelerometer_bias,
        pool_friction=pool_friction,
        terms=tuple(terms),
        rotor_radius=rotor_radius,
        noise=noise_argument.noise(noise),
    )
    check_options(motion, options)
    return options if max_tilt is None else replace(options, max_tilt_deg=max_tilt)


def given_lag(text: str, file: str) -> Prior | Bounds | None:
    """Return what is known of the lag: as typed, or from another flight's JSON; None for nothing.

    Raises
    ------
    UsageError
        When both are given, or the other flight could not tell its lag.
    InputError
        When the file is no result.
    """
    from eivor.models.separable import Prior

    if text and file:
        raise UsageError("--lag or --lag-from", "both", "Leave out one of them.")
    if text:
        return arguments.lag(text)
    if not file:
        return None
    from eivor.flights.estimated import EFFECTIVE_LAG
    from eivor.inference.verdict import Status
    from eivor.report.read_fit import load_fit

    found = load_fit(file).quantities.get(EFFECTIVE_LAG)
    if found is None or found.verdict is Status.REFUSED or not 0.0 < found.half_width < math.inf:
        raise UsageError(
            f"a result in '{file}' that tells the effective lag",
            "one without" if found is None else f"one whose lag is {found.verdict.value}",
            "Give the lag by --lag MS:STD, or the result of a flight that tells it.",
        )
    # half a 95 % interval, the choice of the delay included, is two standard deviations at most
    return Prior(found.value, max(found.half_width / 2.0, found.std_error))


def told_apart(given: Sequence[LogArgument], recordings: list[Recording]) -> list[Recording]:
    """Recordings of one file name renamed: to their paths, and to path and window for parts of one log."""
    paths: dict[str, set[Path]] = {}
    parts: Counter[Path] = Counter()
    for log, recording in zip(given, recordings, strict=True):
        paths.setdefault(recording.name, set()).add(log.path)
        parts[log.path] += 1
    renamed = []
    for log, recording in zip(given, recordings, strict=True):
        name = str(log.path) if len(paths[recording.name]) > 1 else recording.name
        if parts[log.path] > 1 and log.window is not None:
            name += f"@{log.window[0]:g}:{log.window[1]:g}"
        renamed.append(recording if name == recording.name else replace(recording, name=name))
    return renamed


def check_windows(recordings: list[Recording], windows: Sequence[Window | None]) -> None:
    """Refuse windows outside their logs, and name the log.

    Raises
    ------
    UsageError
        For the first one.
    """
    from eivor.signals.recording import interval_within

    for recording, window in zip(recordings, windows, strict=True):
        if window is not None:
            with named(recording.name, several=len(recordings) > 1):
                interval_within(window, recording.span_s)
