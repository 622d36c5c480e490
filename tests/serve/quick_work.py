"""What worker processes do in tests: what the log says, at once."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from http import HTTPStatus
from typing import Any

from eivor.serve.jobs import REPORT, RESULT, File
from eivor.serve.requests import RefusedError


def _refused(status, text):
    return RefusedError(HTTPStatus(status), text, text, text)


class QuickWork:
    """Does what a log says: sleep, die, take memory, be refused, or else be its own result."""

    def __call__(self, item, tell):
        """Outcome of a task."""
        given: dict[str, Any] = dict(item.arguments)
        if item.name == "choices":
            return {"models": [{"name": "vertical", "words": "up and down"}]}
        if item.name == "identify":
            return self._identified(given["logs"], given["folder"], tell)
        stem, words = given["stem"], given["words"]
        if item.name == "list_exports":
            return [{"name": "px4", "file": f"{stem}-px4.params", "reason": words["mass"]}]
        if item.name == "export":
            said = ", ".join(f"{name}={words[name]!r}" for name in ("mass", "vehicle", "prior"))
            return File(f"{stem}-{words['target']}.txt", said)
        return _refused(409, words["form"])

    def _identified(self, logs, folder, tell):
        tell({"stage": "reading"})
        decode = b" ".join(log.path.read_bytes() for log in logs.values()).decode()
        tell({"stage": "identifying"})
        if "child" in decode:
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            (folder / "child").write_text(str(child.pid), encoding="ascii")
        if "sleep" in decode:
            (folder / "pid").write_text(str(os.getpid()), encoding="ascii")
            tell({"stage": "sleeping"})
            time.sleep(600.0)
        if "die" in decode:
            os._exit(7)
        if "memory" in decode:
            len(bytearray(10**10))
        if "refuse" in decode:
            return _refused(400, decode)
        if "once" in decode and not (folder / "died").exists():
            (folder / "died").touch()
            os._exit(9)
        (folder / RESULT).write_text(decode, encoding="utf-8")
        tell({"done": {"status": "identified"}})
        if "unreported" in decode:
            return _refused(500, decode)
        (folder / REPORT).write_text(f"<p>{decode}", encoding="utf-8")
        return None
