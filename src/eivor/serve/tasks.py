"""What worker processes are asked to do. Tasks are pickled: nothing heavy is imported with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from eivor.process_pool import ProgressCallback
from eivor.serve.asked_json import AskedJob
from eivor.serve.refusals import Told

#: Files of a result in the folder of its job.
RESULT, REPORT = "result.json", "report.html"


@dataclass(frozen=True, slots=True)
class KeptLog:
    """A log on the disk."""

    path: Path  # where it is; its name there says nothing
    name: str  # what its user calls it
    size: int  # bytes


@dataclass(frozen=True, slots=True)
class Begin:
    """Say what may be chosen."""


@dataclass(frozen=True, slots=True)
class Choices:
    """What may be chosen, as the page is given it."""

    known: Mapping[str, object]  # see `eivor.serve`


@dataclass(frozen=True, slots=True)
class Identify:
    """Identify logs, and write result and report into a folder; progress is stages and the verdict."""

    asked: AskedJob  # what of them
    logs: Mapping[str, KeptLog]  # by identifier
    folder: Path  # of the job


@dataclass(frozen=True, slots=True)
class Supply:
    """What is known beside the flight, as words."""

    mass: str = ""  # as on the command line
    vehicle: str = ""  # by its name, or as the text of a file
    priors: tuple[str, ...] = ()  # as on the command line


@dataclass(frozen=True, slots=True)
class ListExports:
    """Say of every target whether it can be written, and what stands in the way."""

    folder: Path  # of the job
    supply: Supply  # what is known beside
    stem: str  # what the files are called


@dataclass(frozen=True, slots=True)
class Export:
    """Write what a target takes, as a `File`."""

    folder: Path
    supply: Supply
    stem: str
    target: str  # its word


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan the flight that would tell, and write it as a `File`."""

    folder: Path
    stem: str
    form: str  # word of the kind of file
    home: str = ""  # place of a mission, as words
    target: str = ""  # what the flight is to tell; empty for what the result could not


@dataclass(frozen=True, slots=True)
class File:
    """A file that is sent."""

    name: str  # what it is called
    text: str  # content


@dataclass(frozen=True, slots=True)
class Stage:
    """Told on the way: what begins."""

    name: str


@dataclass(frozen=True, slots=True)
class Found:
    """Told on the way: the result is written, and its verdict."""

    status: str


@dataclass(frozen=True, slots=True)
class Refused:
    """In place of a result: the error that came instead."""

    status: int  # of the answer
    told: Told = field(default_factory=dict)  # parts of the error


Task = Begin | Identify | ListExports | Export | Plan
Outcome = Choices | File | Refused | list[dict[str, object]] | None
WorkFunction = Callable[[Task, ProgressCallback], Outcome]


@dataclass(frozen=True, slots=True)
class Work:
    """The function of worker processes: a task to its outcome.

    A process that unpickles it loads everything that tasks need: neither time nor memory of the first task.
    """

    def __call__(self, item: Task, report: ProgressCallback) -> Outcome:
        """Outcome of a task."""
        from eivor.serve.working import outcome_of

        return outcome_of(item, report)

    def __reduce__(self) -> tuple[Callable[[], Work], tuple[()]]:
        return _loaded, ()


def _loaded() -> Work:
    import eivor.serve.working  # noqa: F401

    return Work()
