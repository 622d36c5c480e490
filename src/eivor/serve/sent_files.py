"""What is sent as one log: a file, or the files of a folder, whose names are made plain."""

from __future__ import annotations

import re
from dataclasses import dataclass
from http import HTTPStatus
from urllib.parse import unquote

from eivor.serve.refusals import RefusedError

#: Files of a folder at most, and letters of a name.
MOST_FILES, LONGEST = 500, 120
_ENTRY = re.compile(r"([^/ ]{1,1000})/([0-9]{1,15})")
_OTHER = re.compile(r"[^A-Za-z0-9_.\-\[\]]")


@dataclass(frozen=True, slots=True)
class SentFile:
    """A file of a folder."""

    name: str  # plain: of letters that mean nothing to a file system
    size: int  # bytes


def sent_files(header: str, size: int) -> tuple[SentFile, ...]:
    """Files of a folder, out of their header."""
    if not header:
        return ()
    entries = [_ENTRY.fullmatch(one) for one in header.split(" ")]
    files = [SentFile(plain_name(unquote(one[1], errors="replace")), int(one[2])) for one in entries if one]
    if len(files) < len(entries) or len(files) > MOST_FILES or sum(one.size for one in files) != size:
        raise _wrong(f"at most {MOST_FILES} files of a folder, NAME/BYTES, of {size} bytes", header)
    if len({one.name.casefold() for one in files}) < len(files):
        raise _wrong("files of a folder with different names", header)
    return tuple(files)


def plain_name(name: str) -> str:
    """Name of a file in its folder: other letters than plain ones become ``_``, and it is never hidden."""
    plain = _OTHER.sub("_", name.replace("\\", "/").rpartition("/")[2])[-LONGEST:]
    return f"_{plain}" if plain.startswith(".") or not plain else plain


def _wrong(expected: str, header: str) -> RefusedError:
    return RefusedError(
        HTTPStatus.BAD_REQUEST, expected, f"'{header[:100]}'", "Drop the files of the log one by one."
    )
