"""What a format of logs is: told by its content, read into a `Recording`, advised on."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from eivor.signals.recording import Recording

#: Bytes of a file's start that `LogFormat.sniff` is given.
HEAD_BYTES = 65536


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What a reader is told beside the file.

    Parameters
    ----------
    channel_map : str or path, optional
        A channel map (TOML), or the name of a shipped one; only for formats that take one.
    sha256 : str
        Hash of the file's bytes, for the Recording.
    """

    channel_map: str | os.PathLike[str] | None = None
    sha256: str = ""


def begins_with(magic: bytes) -> Callable[[bytes, Path], bool]:
    """Return the `LogFormat.sniff` of a format whose files begin with these bytes."""
    return lambda head, _file: head.startswith(magic)


def no_advice(_channel: str) -> tuple[str, ...]:
    """Return the `LogFormat.advice` of a format about which nothing is known."""
    return ()


@dataclass(frozen=True, slots=True)
class FolderParts:
    """Files of a folder that are no logs themselves.

    Parameters
    ----------
    members : frozenset of str
        Names of those that are one log together: the folder is the log.
    derived : frozenset of str
        Names of those that were made of logs that lie beside them.
    """

    members: frozenset[str] = frozenset()
    derived: frozenset[str] = frozenset()


def no_parts(_folder: Path) -> FolderParts:
    """Return the `LogFormat.parts` of a format whose logs are files."""
    return FolderParts()


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A format of logs, one row of the table in `eivor.logs.formats`.

    Parameters
    ----------
    name : str
        The word of `Recording.format`: "ulog".
    label : str
        What people call it: "ULog".
    sniff : callable
        Says whether a file is of this format, from its first `HEAD_BYTES` (or all of it) and, for formats
        that are told by more, the file. Its name says nothing.
    read : callable
        Reads a file with `ReadOptions` into a Recording, or raises an `InputError` with the reason and what
        to do. What it needs beyond NumPy it imports when it is called.
    is_read : bool
        False for a format that is recognised only to say what to do with such a file.
    takes_map : bool
        True when columns may have any name, so that a channel map can say what they are.
    advice : callable
        Sentences that say what to log, the most important first: for a canonical channel, or for the whole
        flight when it is given an empty name.
    setpoints : str
        Sentence that names the setpoints and commands to log; empty when nothing special is known.
    endings : tuple of str
        How names of such logs end, in small letters: a file of such a name is taken for a log in a folder of
        many, whatever is in it.
    parts : callable
        Says which files of a folder are one log of this format together.
    """

    name: str
    label: str
    sniff: Callable[[bytes, Path], bool]
    read: Callable[[Path, ReadOptions], Recording]
    is_read: bool = True
    takes_map: bool = False
    advice: Callable[[str], tuple[str, ...]] = no_advice
    setpoints: str = ""
    endings: tuple[str, ...] = ()
    parts: Callable[[Path], FolderParts] = no_parts
