"""Logs as given on the command line: checked, read, and told apart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from eivor.asked.flights import check_windows, told_apart
from eivor.asked.words import LogArgument, Window, log_argument, named
from eivor.cli.terminal import step
from eivor.errors import UsageError

if TYPE_CHECKING:
    from eivor.flights.options import FlightOptions
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
    return ChosenLogs(tuple(map(log_argument, texts or ())), example, channel_map)
