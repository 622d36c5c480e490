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
    Export,
    File,
    Identify,
    ListExports,
    Plan,
    Refused,
)


class QuickWork:
    """Does what a log says: sleep, die, take memory, be refused, or else be its own result."""

    def __call__(self, item: Any, tell: ProgressCallback) -> Any:
        """Outcome of a task."""
        if isinstance(item, Begin):
            return {"models": [{"name": "vertical", "words": "up and down"}]}
        if isinstance(item, Identify):
            return self._identified(item, tell)
        if isinstance(item, ListExports):
            return [{"name": "px4", "file": f"{item.stem}-px4.params", "reason": item.supply.mass}]
        if isinstance(item, Export):
            return File(f"{item.stem}-{item.target}.txt", repr(item.supply))
        assert isinstance(item, Plan)
        return Refused(409, dict.fromkeys(("expected", "received", "advice", "sentence"), item.form))

    def _identified(self, item: Identify, tell: ProgressCallback) -> Refused | None:
        tell({"stage": "reading"})
        decode = b" ".join(log.path.read_bytes() for log in item.logs.values()).decode()
        tell({"stage": "identifying"})
        if "child" in decode:
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            (item.folder / "child").write_text(str(child.pid), encoding="ascii")
        if "sleep" in decode:
            (item.folder / "pid").write_text(str(os.getpid()), encoding="ascii")
            tell({"stage": "sleeping"})
            time.sleep(600.0)
        if "die" in decode:
            os._exit(7)
        if "memory" in decode:
            len(bytearray(10**10))
        if "refuse" in decode:
            return Refused(400, {"sentence": f"It is {decode}."})
        if "once" in decode and not (item.folder / "died").exists():
            (item.folder / "died").touch()
            os._exit(9)
        (item.folder / RESULT).write_text(decode, encoding="utf-8")
        tell({"done": {"status": "identified"}})
        if "unreported" in decode:
            return Refused(500, dict.fromkeys(("expected", "received", "advice", "sentence"), decode))
        (item.folder / REPORT).write_text(f"<p>{decode}", encoding="utf-8")
        return None
