"""The needed columns of a Parquet file are decoded once in a process of its own, before they are in this one.

Cost: 0.2 s and one decoding.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from eivor.logs.table.child import BEGINNING, REFUSED, decode_in_child

#: Longest time that the child may take [s].
TIMEOUT_S = 300.0

#: Runs in the child; an import that fails there says nothing about the file, hence leaves with 0.
_CODE = f"""{BEGINNING}
try:
    import polars as pl
except ImportError:
    sys.exit(0)
try:
    frame = pl.scan_parquet(asked["path"], glob=False, hive_partitioning=False)
    for pattern in asked["patterns"]:
        frame.select(pl.col(pattern)).collect()
except BaseException as error:
    print(type(error).__name__, str(error)[:500])
    sys.exit({REFUSED})
"""


def exactly(column: str) -> str:
    """Return the pattern of polars that means the column of this very name ("*" and "^a$" mean others)."""
    letters = "".join(f"\\x{{{ord(letter):x}}}" for letter in column)
    return f"^{letters}$"


def probe_parquet(file: Path, columns: Sequence[str], max_bytes: int) -> None:
    """Decode columns of a Parquet file in a child process; `decode_in_child` says what it raises.

    Parameters
    ----------
    file : Path
        The file.
    columns : sequence of str
        The columns that are needed.
    max_bytes : int
        Memory that the child may use [bytes].
    """
    asked = {"patterns": [*map(exactly, columns)]}
    decode_in_child(file, _CODE, asked, max_bytes=max_bytes, timeout_s=TIMEOUT_S, kind="a Parquet file")
