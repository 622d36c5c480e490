"""A Parquet file is decoded once in a process of its own, before it is decoded in this one.

The decoder trusts the lengths in a page. A damaged one can make it ask for more memory than there is, and
then the whole process is aborted: no exception reaches Python. So a child process decodes the file first,
column by column; when it does not come back well, the file is damaged. Cost: 0.2 s and one decoding.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from eivor.errors import CorruptLogError
from eivor.logs.table_source import corrupt_table

#: Longest time that the child may take [s].
TIMEOUT_S = 300.0
_REFUSED = 3

#: Runs in the child; an import that fails there says nothing about the file, hence leaves with 0.
_CODE = f"""
import sys
try:
    import polars as pl
except ImportError:
    sys.exit(0)
try:
    frame = pl.scan_parquet(sys.stdin.readline().rstrip("\\n"), glob=False, hive_partitioning=False)
    rows = frame.select(pl.len()).collect().item()
    for name in frame.collect_schema() if rows <= int(sys.argv[1]) else ():
        frame.select(pl.col(name)).collect()
except BaseException as error:
    print(type(error).__name__, str(error)[:500])
    sys.exit({_REFUSED})
"""


def probe_parquet(file: Path, max_rows: int) -> None:
    """Decode a Parquet file in a child process.

    Parameters
    ----------
    file : Path
        The file.
    max_rows : int
        Files with more rows are not decoded; the caller refuses them.

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
    try:
        child = subprocess.run(  # noqa: S603 - the program is this interpreter, the path goes to its stdin
            [sys.executable, "-P", "-c", _CODE, str(max_rows)],
            input=f"{file.resolve()}\n".encode("utf-8", "surrogateescape"),
            capture_output=True,
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
        raise _damaged(file, f"makes the decoder fail (exit code {child.returncode})")


def _damaged(file: Path, reason: str) -> CorruptLogError:
    return corrupt_table(
        file.name, f"a Parquet file that {reason}", "The file is damaged or incomplete; write it again."
    )
