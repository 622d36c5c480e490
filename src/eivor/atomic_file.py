"""Files that are written whole or not at all, and Parquet tables that are sealed."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import stat
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from eivor.errors import InputError

if TYPE_CHECKING:
    import polars as pl


# -- Folder lock --

#: File that is locked; it stays, empty.
LOCK = ".lock"


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a folder for the block."""
    descriptor = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR)
    try:
        try:
            _take(descriptor)
        except BlockingIOError as error:
            expected = "a folder that no other run works on"
            received = f"'{folder}', on which one works now"
            raise InputError(expected, received, "Wait for it, or choose another folder with -o.") from error
        yield
    finally:
        os.close(descriptor)


def _take(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError from error
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


# -- Atomic writes --

#: How files that are being written are called: hidden, and of nobody else's making.
PREFIX, SUFFIX = ".eivor-", ".part"
#: A file that nobody has written to for so long [s] belongs to a process that was killed.
ABANDONED_S = 60.0


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """File to write to, which takes its place when the block ends without an error."""
    mode = _mode(path)
    if mode is not None and not stat.S_ISREG(mode):
        with path.open("wb") as device:
            yield device
        return
    target, temporary = _positions(path)
    try:
        with temporary.open("xb") as file:
            if mode is not None:
                temporary.chmod(stat.S_IMODE(mode))
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write a file at once, see `atomic_write`; text in UTF-8."""
    with atomic_write(path) as file:
        file.write(content.encode("utf-8") if isinstance(content, str) else content)


def check_writable(path: Path) -> None:
    """Find out whether `atomic_write` could begin: a file appears beside the place and goes again."""
    mode = _mode(path)
    if mode is not None and not stat.S_ISREG(mode):
        return
    _, temporary = _positions(path)
    temporary.open("xb").close()
    temporary.unlink()


def remove_abandoned(folder: Path) -> None:
    """Remove what killed processes left in a folder; a file that is being written is younger than that."""
    oldest = time.time() - ABANDONED_S
    for path in folder.glob(f"{PREFIX}*{SUFFIX}"):
        with suppress(FileNotFoundError):
            if path.stat().st_mtime < oldest:
                path.unlink()


def _mode(path: Path) -> int | None:
    """Kind and permissions of what is there; None when there is nothing."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    return mode


def _positions(path: Path) -> tuple[Path, Path]:
    """Where the file goes once links are followed, and a new name beside it."""
    target = Path(os.path.realpath(path))
    return target, target.with_name(f"{PREFIX}{os.urandom(8).hex()}{SUFFIX}")


# -- Sealed table --

#: Key of the checksum in the metadata, and how it is written there: Thrift's header of 64 bytes of text.
SEAL_KEY = "eivor.sha256"
SEAL_MARK = SEAL_KEY.encode() + b"\x18\x40"
SEAL_BYTES = 64
#: Rows of a row group.
GROUP_ROWS = 10_000


def sealed(table: pl.DataFrame, facts: Mapping[str, str]) -> bytes:
    """Parquet of a table, sealed. Equal tables and facts give equal bytes."""
    content = parquet_bytes(table, {SEAL_KEY: "0" * SEAL_BYTES, **facts})
    position = content.rindex(SEAL_MARK) + len(SEAL_MARK)
    return content[:position] + _checksum(content, position) + content[position + SEAL_BYTES :]


def is_sealed(content: bytes, facts: Mapping[str, str]) -> bool:
    """Whether these are the bytes that `sealed` made, of a table of these facts. Decodes no table."""
    position = content.rfind(SEAL_MARK) + len(SEAL_MARK)
    if position < len(SEAL_MARK) or content[position : position + SEAL_BYTES] != _checksum(content, position):
        return False
    import polars as pl

    result = pl.read_parquet_metadata(io.BytesIO(content))
    return all(result.get(key) == value for key, value in facts.items())


def parquet_bytes(table: pl.DataFrame, metadata: Mapping[str, str] | None = None) -> bytes:
    """Parquet with settings that are all fixed, so that equal tables give equal bytes."""
    buffer = io.BytesIO()
    table.write_parquet(
        buffer,
        compression="zstd",
        compression_level=3,
        statistics=False,
        row_group_size=GROUP_ROWS,
        metadata=dict(metadata) if metadata else None,
    )
    return buffer.getvalue()


def _checksum(content: bytes, position: int) -> bytes:
    digest = hashlib.sha256(content[:position])
    digest.update(b"0" * SEAL_BYTES)
    digest.update(content[position + SEAL_BYTES :])
    return digest.hexdigest().encode()


@contextmanager
def report_system_errors(folder: Path, *, of: str, kept: str) -> Iterator[None]:
    """Turn the system's error for a file of a folder of tables into one of Eivor's."""
    import polars as pl

    try:
        yield
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        reason = getattr(error, "strerror", None) or str(error)
        expected = f"a folder '{folder}' that the {of} can be written to"
        remedy = f"{kept} are kept: make room, or repair it, and run the same again."
        raise InputError(expected, f"what the system says: {reason}", remedy) from error
