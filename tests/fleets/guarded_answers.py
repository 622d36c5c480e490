"""What guarded processes are asked in tests; quick to import."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any


def answered(item: Any) -> Any:
    """What an item asks for: to sleep, to take memory, to end the process, or an answer."""
    if item == "sleep":
        time.sleep(600.0)
    if item == "memory":
        return len(bytearray(10**10))
    if item == "words":
        sys.stderr.write("memory allocation of 9 bytes failed\nnote: run with RUST_BACKTRACE=1\n")
        os._exit(6)
    if item == "die":
        os._exit(7)
    if item == "mistake":
        raise ZeroDivisionError("of all things")
    if item == "once" and not Path("died").exists():
        Path("died").touch()
        os._exit(9)
    sys.stdout.write("what libraries print\n")
    return os.getpid() if item == "pid" else f"<{item}>"
