"""Functions of worker processes in tests, quick to import; and waiting for processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from eivor.errors import InputError

#: Longest wait for another process [s]: a machine that is busy with other work must not fail a test.
PATIENCE_S = 600.0
ROOT = Path(__file__).parents[1]

#: Where processes that are begun here find this checkout and the parts of its tests.
SOURCES = os.pathsep.join(str(ROOT / folder) for folder in ("src", "tests"))


def answered(item):
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
    if item == "end":
        os._exit(0)
    if item == "refuse":
        raise InputError("no refusal", "one", "Leave it out.")
    if item == "mistake":
        raise ZeroDivisionError("of all things")
    if item == "once" and not Path("died").exists():
        Path("died").touch()
        os._exit(9)
    sys.stdout.write("what libraries print\n")
    return os.getpid() if item == "pid" else f"<{item}>"


def counted(item, report):
    """Report every number below the item; the process dies at the first attempt where there is a file."""
    for number in range(item):
        report(number)
    if Path("die once").exists():
        Path("die once").unlink()
        os._exit(1)
    return item


def always_reporting(item, report):
    """Report for ever."""
    while True:
        report(item)
        time.sleep(0.01)


class Unreadable:
    """A result that can be sent and not read."""

    def __reduce__(self):
        return int, ("no number",)


def unreadable(_item):
    return Unreadable()


def begin_another(item):
    """A process of the worker's own, which does nothing for long."""
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    Path(item).write_text(str(child.pid), encoding="ascii")
    time.sleep(600.0)
    return 0


def text_of(item):
    """Any pure function of a module will do."""
    return f"<{item}>"


def refusing(item):
    raise InputError(f"no {item}", "one", "Leave it out.")


def interrupted_on_the_way():
    """What a worker calls while it takes over its function, before it is set up."""
    os.kill(os.getpid(), signal.SIGINT)
    return text_of


class Arriving:
    """A function that is interrupted where it arrives."""

    def __call__(self, item):
        return text_of(item)

    def __reduce__(self):
        return interrupted_on_the_way, ()


def wait_until(true, process=None, patience_s=PATIENCE_S):
    end = time.monotonic() + patience_s
    while not true():
        assert process is None or process.poll() is None, "the process ended before it was killed"
        assert time.monotonic() < end
        time.sleep(0.005)
