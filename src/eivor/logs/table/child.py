"""A file is decoded once in a process of its own, before it is in this one.

Decoders of binary tables trust the lengths in a file. A damaged one can make them ask for more memory than
there is, or end the process: no exception reaches Python. So a child process, which may have so much memory
and no more, decodes first; when it does not come back well, the file is damaged.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eivor.errors import CorruptLogError
from eivor.logs.table.source import corrupt_table
from eivor.process_pool import SANDBOX

#: What a child leaves with that refuses a file, having printed why.
REFUSED = 3
#: What a child begins with: `asked` is what it is given, and it may use so many bytes.
#: Where the system cannot limit memory, it is not limited.
BEGINNING = """
import json, sys
asked = json.load(sys.stdin)
try:
    import resource
    resource.setrlimit(resource.RLIMIT_DATA, (asked["bytes"], asked["bytes"]))
except (ImportError, ValueError, OSError):
    pass
"""


def decode_in_child(
    file: Path, code: str, asked: Mapping[str, Any], *, max_bytes: int, timeout_s: float, kind: str
) -> None:
    """Decode a file in a child process, and refuse one that the child refuses, dies of or does not finish.

    The program `code` begins with `BEGINNING` and leaves with `REFUSED` for a damaged file. Nothing is
    decoded where no interpreter can be started (frozen or embedded programs), nor in a sandbox.
    """
    if SANDBOX in os.environ:
        return
    if not sys.executable or getattr(sys, "frozen", False):
        return
    told = {"path": str(file.resolve()), "bytes": max_bytes, **asked}
    try:
        child = subprocess.run(  # noqa: S603 - the program is this interpreter, the path goes to its stdin
            [sys.executable, "-P", "-c", code],
            input=json.dumps(told).encode(),
            capture_output=True,
            # each thread has a stack and arenas of its own, which count as memory
            env=os.environ | {"POLARS_MAX_THREADS": "1"},
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise _damaged(file, f"{kind} that is not decoded within {timeout_s:.0f} s") from error
    except OSError:
        return
    if child.returncode == REFUSED:
        said = child.stdout.decode("utf-8", "replace").strip()
        raise _damaged(file, f"{kind} that cannot be decoded: {said}")
    if child.returncode != 0:
        limit = f"exit code {child.returncode}; it may use {max_bytes >> 20} MiB"
        raise _damaged(file, f"{kind} that makes the decoder fail ({limit})")


def _damaged(file: Path, reason: str) -> CorruptLogError:
    return corrupt_table(file.name, reason, "The file is damaged or incomplete; write it again.")
