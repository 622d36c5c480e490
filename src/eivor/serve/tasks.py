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
    """A log on the disk.

    Parameters
    ----------
    path : Path
        Where it is; its name there says nothing.
    name : str
        What its user calls it.
    size : int
        Bytes.
    """

    path: Path
    name: str
    size: int


@dataclass(frozen=True, slots=True)
class Begin:
    """Say what may be chosen."""


@dataclass(frozen=True, slots=True)
class Choices:
    """What may be chosen, as the page is given it.

    Parameters
    ----------
    known : mapping of str to object
        See `eivor.serve`.
    """

    known: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Identify:
    """Identify logs, and write result and report into a folder; stages and the verdict are told on the way.

    Parameters
    ----------
    asked : AskedJob
        What of them.
    logs : mapping of str to KeptLog
        By identifier.
    folder : Path
        Of the job.
    """

    asked: AskedJob
    logs: Mapping[str, KeptLog]
    folder: Path


@dataclass(frozen=True, slots=True)
class Supply:
    """What is known beside the flight, as words.

    Parameters
    ----------
    mass, vehicle : str
        As on the command line, the vehicle by its name or as the text of a file.
    priors : tuple of str
        Likewise.
    """

    mass: str = ""
    vehicle: str = ""
    priors: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ListExports:
    """Say of every target whether it can be written, and what stands in the way.

    Parameters
    ----------
    folder : Path
        Of the job.
    supply : Supply
        What is known beside.
    stem : str
        What the files are called.
    """

    folder: Path
    supply: Supply
    stem: str


@dataclass(frozen=True, slots=True)
class Export:
    """Write what a target takes, as a `File`.

    Parameters
    ----------
    folder, supply, stem
        As of `ListExports`.
    target : str
        Its word.
    """

    folder: Path
    supply: Supply
    stem: str
    target: str


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan the flight that would tell, and write it as a `File`.

    Parameters
    ----------
    folder, stem
        As of `ListExports`.
    form : str
        Word of the kind of file.
    home : str
        Place of a mission, as words.
    target : str
        What the flight is to tell; empty for what the result could not.
    """

    folder: Path
    stem: str
    form: str
    home: str = ""
    target: str = ""


@dataclass(frozen=True, slots=True)
class File:
    """A file that is sent.

    Parameters
    ----------
    name : str
        What it is called.
    text : str
        Content.
    """

    name: str
    text: str


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
    """In place of a result: the error that came instead.

    Parameters
    ----------
    status : int
        Of the answer.
    told : dict of str to str
        Parts of the error.
    """

    status: int
    told: Told = field(default_factory=dict)


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
