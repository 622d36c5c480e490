"""Tables as Parquet with a seal: the checksum of the file's own bytes, and what the table is of.

The seal stands in the file's metadata, so the file stays one that every reader of Parquet takes. The
checksum is that of all bytes, with zeros in its own place; it is compared before a byte is decoded, since
a decoder may make other numbers of damaged bytes, or crash.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import polars as pl

from eivor.errors import InputError

#: Key of the checksum in the metadata, and how it is written there: Thrift's header of 64 bytes of text.
SEAL_KEY = "eivor.sha256"
SEAL_MARK = SEAL_KEY.encode() + b"\x18\x40"
SEAL_BYTES = 64
#: Rows of a row group.
GROUP_ROWS = 10_000


def sealed(table: pl.DataFrame, facts: Mapping[str, str]) -> bytes:
    """Parquet of a table, sealed. Equal tables and facts give equal bytes.

    Parameters
    ----------
    table : polars.DataFrame
        What to keep.
    facts : mapping of str to str
        What it is of, kept beside the seal.
    """
    content = parquet_bytes(table, {SEAL_KEY: "0" * SEAL_BYTES, **facts})
    place = content.rindex(SEAL_MARK) + len(SEAL_MARK)
    return content[:place] + _checksum(content, place) + content[place + SEAL_BYTES :]


def is_sealed(content: bytes, facts: Mapping[str, str]) -> bool:
    """Whether these are the bytes that `sealed` made, of a table of these facts. Decodes no table."""
    place = content.rfind(SEAL_MARK) + len(SEAL_MARK)
    if place < len(SEAL_MARK) or content[place : place + SEAL_BYTES] != _checksum(content, place):
        return False
    found = pl.read_parquet_metadata(io.BytesIO(content))
    return all(found.get(key) == value for key, value in facts.items())


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


def _checksum(content: bytes, place: int) -> bytes:
    """Hexadecimal digest of a file whose seal begins at `place`."""
    digest = hashlib.sha256(content[:place])
    digest.update(b"0" * SEAL_BYTES)
    digest.update(content[place + SEAL_BYTES :])
    return digest.hexdigest().encode()


@contextmanager
def system_errors_told(folder: Path, *, of: str, kept: str) -> Iterator[None]:
    """Turn the system's error for a file of a folder of tables into one of Eivor's.

    Parameters
    ----------
    folder : Path
        The folder.
    of : str
        What its tables are of.
    kept : str
        What was written before and stays.

    Raises
    ------
    InputError
        When a file could not be read or written.
    """
    try:
        yield
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"a folder '{folder}' that the {of} can be written to",
            f"what the system says: {reason}",
            f"{kept} are kept: make room, or repair it, and run the same again.",
        ) from error
