"""What worker processes do in tests: what the log says, at once."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import Any

from eivor.process_pool import ProgressCallback
from eivor.serve.jobs import (
    REPORT,
    RESULT,
    Begin,
    Choices,
    Export,
    File,
    Found,
    Identify,
    ListExports,
    Plan,
    Refused,
    Stage,
)


class QuickWork:
    """Does what a log says: sleep, die, take memory, be refused, or else be its own result."""

    def __call__(self, item: Any, tell: ProgressCallback) -> Any:
        """Outcome of a task."""
        if isinstance(item, Begin):
            return Choices({"models": [{"name": "vertical", "words": "up and down"}]})
        if isinstance(item, Identify):
            return self._identified(item, tell)
        if isinstance(item, ListExports):
            return [{"name": "px4", "file": f"{item.stem}-px4.params", "reason": item.supply.mass}]
        if isinstance(item, Export):
            return File(f"{item.stem}-{item.target}.txt", repr(item.supply))
        assert isinstance(item, Plan)
        return Refused(409, dict.fromkeys(("expected", "received", "advice", "sentence"), item.form))

    def _identified(self, item: Identify, tell: ProgressCallback) -> Refused | None:
        tell(Stage("reading"))
        said = b" ".join(log.path.read_bytes() for log in item.logs.values()).decode()
        tell(Stage("identifying"))
        if "child" in said:
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            (item.folder / "child").write_text(str(child.pid), encoding="ascii")
        if "sleep" in said:
            (item.folder / "pid").write_text(str(os.getpid()), encoding="ascii")
            tell(Stage("sleeping"))
            time.sleep(600.0)
        if "die" in said:
            os._exit(7)
        if "memory" in said:
            len(bytearray(10**10))
        if "refuse" in said:
            return Refused(400, {"sentence": f"It is {said}."})
        if "once" in said and not (item.folder / "died").exists():
            (item.folder / "died").touch()
            os._exit(9)
        (item.folder / RESULT).write_text(said, encoding="utf-8")
        tell(Found("identified"))
        if "unreported" in said:
            return Refused(500, dict.fromkeys(("expected", "received", "advice", "sentence"), said))
        (item.folder / REPORT).write_text(f"<p>{said}", encoding="utf-8")
        return None
