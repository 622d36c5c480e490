"""The needed columns of a Parquet file are decoded once in a process of its own, before they are in this one.

The decoder trusts the lengths in a page. A damaged one can make it ask for more memory than there is, and
then the whole process is aborted: no exception reaches Python. So a child process, which may have so much
memory and no more, decodes first, column by column; when it does not come back well, the file is damaged.
Cost: 0.2 s and one decoding.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from eivor.errors import CorruptLogError
from eivor.logs.table.source import corrupt_table

#: Longest time that the child may take [s].
TIMEOUT_S = 300.0
_REFUSED = 3

#: Runs in the child; an import that fails there says nothing about the file, hence leaves with 0.
#: Where the system cannot limit memory, it is not limited.
_CODE = f"""
import json, sys
asked = json.load(sys.stdin)
try:
    import resource
    resource.setrlimit(resource.RLIMIT_DATA, (asked["bytes"], asked["bytes"]))
except (ImportError, ValueError, OSError):
    pass
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
    sys.exit({_REFUSED})
"""


def exactly(column: str) -> str:
    """Return the pattern of polars that means the column of this very name ("*" and "^a$" mean others)."""
    letters = "".join(f"\\x{{{ord(letter):x}}}" for letter in column)
    return f"^{letters}$"


def probe_parquet(file: Path, columns: Sequence[str], max_bytes: int) -> None:
    """Decode columns of a Parquet file in a child process.

    Parameters
    ----------
    file : Path
        The file.
    columns : sequence of str
        The columns that are needed.
    max_bytes : int
        Memory that the child may use [bytes].

    Raises
    ------
    CorruptLogError
        When the child refuses the file, does not end, or is killed.

    Notes
    -----
    Where no interpreter can be started (frozen or embedded programs), nothing is probed.
    """
    if not sys.executable or getattr(sys, "frozen", False):
        return
    asked = {"path": str(file.resolve()), "patterns": [*map(exactly, columns)], "bytes": max_bytes}
    try:
        child = subprocess.run(  # noqa: S603 - the program is this interpreter, the path goes to its stdin
            [sys.executable, "-P", "-c", _CODE],
            input=json.dumps(asked).encode(),
            capture_output=True,
            # each thread has a stack and arenas of its own, which count as memory
            env=os.environ | {"POLARS_MAX_THREADS": "1"},
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise _damaged(file, f"is not decoded within {TIMEOUT_S:.0f} s") from error
    except OSError:
        return
    if child.returncode == _REFUSED:
        raise _damaged(file, f"cannot be decoded: {child.stdout.decode('utf-8', 'replace').strip()}")
    if child.returncode != 0:
        limit = f"exit code {child.returncode}; it may use {max_bytes >> 20} MiB"
        raise _damaged(file, f"makes the decoder fail ({limit})")


def _damaged(file: Path, reason: str) -> CorruptLogError:
    return corrupt_table(
        file.name, f"a Parquet file that {reason}", "The file is damaged or incomplete; write it again."
    )
