"""Which files a bag is made of: one, or those of a folder."""

from __future__ import annotations

import re
from heapq import nsmallest
from pathlib import Path

from eivor.errors import InputError
from eivor.logs.folders import file_names
from eivor.logs.log_format import FolderParts

ROS1, SQLITE, MCAP = "ros1", "sqlite", "mcap"
MAGICS = {b"#ROSBAG": ROS1, b"SQLite format 3\x00": SQLITE, b"\x89MCAP0\r\n": MCAP}
#: How a file begins that is compressed as a whole.
ZSTD = b"\x28\xb5\x2f\xfd"
#: Ends of the names of a bag's files.
ENDINGS = (".bag", ".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
#: The file that ROS 2 writes beside them.
METADATA = "metadata.yaml"
_PART = re.compile(r"(.*?)(?:_(\d+))?\.(bag|db3|mcap)(?:\.zstd)?")
#: More parts than any bag has.
MAX_PARTS = 10_000


def is_bag_folder(folder: Path) -> bool:
    """Say whether a folder holds files of a bag."""
    return folder.is_dir() and bool(_candidates(folder))


def bag_parts(folder: Path) -> FolderParts:
    """Return the files of a folder that ROS 2 made: it has metadata, or parts that are called like it.

    Bags without either, which were put into one folder, may be of several flights.
    """
    found = _candidates(folder)
    names = {match[1] for file in found if (match := _PART.fullmatch(file.name)) is not None}
    has_metadata = (folder / METADATA).is_file()
    if not found or len(names) > 1 or not (has_metadata or names == {folder.resolve().name}):
        return FolderParts()
    return FolderParts(frozenset((*(file.name for file in found), *([METADATA] if has_metadata else ()))))


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag, in their order.

    Parameters
    ----------
    path : Path
        A file, or a folder of one bag: parts of one name and one kind, with numbers.

    Raises
    ------
    InputError
        When the folder holds several bags.
    """
    if not path.is_dir():
        return [path]
    found = _candidates(path)
    parts = {file: _PART.fullmatch(file.name) for file in found}
    names = {(match[1], match[3]) for match in parts.values() if match is not None}
    if len(names) > 1:
        shown = ", ".join(file.name for file in found[:4]) + (", ..." if len(found) > 4 else "")
        raise InputError(
            "a folder with the files of one bag",
            f"'{path.name}' with those of {len(names)} ({shown})",
            "Give the file or the folder of one bag.",
        )
    return sorted(found, key=lambda file: int((parts[file] or [0, 0, 0])[2] or 0))


def _candidates(folder: Path) -> list[Path]:
    names = (name for name in file_names(folder) if name.endswith(ENDINGS))
    return [folder / name for name in nsmallest(MAX_PARTS, names)]
