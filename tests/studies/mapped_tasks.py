"""Tasks for executors, in a module of their own: each worker process imports it, and little else."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from eivor.errors import InputError
from eivor.process_pool import abandoned


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


@dataclass(frozen=True)
class Patient:
    """A task in many parts, that is over at once for the first item."""

    folder: Path

    def __call__(self, item):
        end = time.monotonic() + 600.0
        while item and not abandoned() and time.monotonic() < end:
            time.sleep(0.01)
        (self.folder / str(item)).touch()
        return item
