"""Logs that were read: told apart, looked at with the options, and identified."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eivor.asked.words import LogArgument, Window, named
from eivor.errors import MissingChannelError, UsageError
from eivor.flights.stages import Progress, silent

if TYPE_CHECKING:
    from eivor.flights.motion import Motion
    from eivor.flights.options import FlightOptions
    from eivor.flights.result import FlightEstimate
    from eivor.signals.recording import Recording


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


def check_named_instruments(recordings: list[Recording], wanted: tuple[str, ...]) -> None:
    """Refuse instruments that a log does not have.

    Raises
    ------
    UsageError
        With the channels that there are.
    """
    for recording in recordings:
        absent = [name for name in wanted if name not in {"references", "lags", *recording.channels}]
        if absent:
            raise UsageError(
                f"channels of {recording.name} as instruments: {', '.join(sorted(recording.channels))}",
                ", ".join(f"'{name}'" for name in absent),
                "Name those, or references, or lags.",
            )


def identified(
    recordings: list[Recording],
    motion: Motion[Any],
    options: FlightOptions,
    windows: list[Window | None],
    progress: Progress = silent,
) -> FlightEstimate:
    """Result of the logs.

    Raises
    ------
    UsageError
        For instruments that a log does not have.
    MissingChannelError
        With what to log so that the channel is there.
    """
    from eivor.motions.identify import identify_flight

    check_named_instruments(recordings, options.instruments)
    try:
        return identify_flight(recordings, options, windows=windows, model=motion, progress=progress)
    except MissingChannelError as error:
        raise MissingChannelError(
            error.expected, error.received, " ".join((error.remedy, *_advice(recordings, motion)))
        ) from error


def _advice(recordings: list[Recording], motion: Motion[Any]) -> tuple[str, ...]:
    from eivor.report.card import logging_advice_for, missing_channels

    sentences = [
        sentence
        for recording in recordings
        for channel in missing_channels(recording, motion)
        for sentence in logging_advice_for(recording, channel)
    ]
    return tuple(dict.fromkeys(sentences))
