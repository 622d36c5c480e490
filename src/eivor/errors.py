"""Errors and warnings: what was expected, what was received, and what to do."""

from __future__ import annotations

from collections.abc import Iterable


class EivorError(Exception):
    """Anything that Eivor refuses to do."""

    def __init__(self, expected: str, received: str, remedy: str) -> None:
        self.expected = expected  # What would have been accepted
        self.received = received  # What came instead
        self.remedy = remedy  # What the caller can do, as one or more whole sentences
        super().__init__(f"Expected {expected}; received {received}. {remedy}")

    def __reduce__(self) -> tuple[type[EivorError], tuple[str, str, str]]:
        return type(self), (self.expected, self.received, self.remedy)


def did_you_mean(name: str, known: Iterable[str], otherwise: str, *, most: int = 1) -> str:
    """Remedy for a name that is not known: at most so many that are near it, or what to say else."""
    near = nearest_names(name, known, most)
    return f"Did you mean {' or '.join(repr(str(item)) for item in near)}?" if near else otherwise


def nearest_names(name: str, known: Iterable[str], most: int = 1) -> list[str]:
    """At most so many of the known names: written like `name`, abbreviated by it, or with it as a word."""
    from difflib import get_close_matches

    names = list(known)
    words = {item: item.replace("-", "_").split("_") for item in names}
    abbreviated = [
        item
        for item, (*first, last) in words.items()
        if name.lower()
        in ("".join(word[:1] for word in (*first, last)), "".join(w[:1] for w in first) + last)
    ]
    named = [item for item in names if get_close_matches(name.lower(), words[item], cutoff=0.8)]
    return (get_close_matches(name, names, n=most) or abbreviated or named)[:most]


class WeakInstrumentsWarning(UserWarning):
    """Instruments that hardly move what they are to identify; the estimate's status is weak."""


class FallbackWarning(UserWarning):
    """A method could not give its own answer and gave that of the one it begins with; its reasons say why."""


class UsageError(EivorError):
    """The call is wrong: an option, a name or a combination that does not exist."""


class ParameterError(UsageError):
    """A number or a name that describes a model, a noise or a scenario, outside what it may be."""


class PoolingError(UsageError):
    """Flights that cannot share one set of parameters were given as one pool."""


class InputError(EivorError):
    """The input cannot be read or does not hold what is needed."""


class UnknownFormatError(InputError):
    """The file's content is that of no supported log format."""


class MissingReaderError(InputError):
    """The format is known, but its reader is not installed or not written yet."""


class CorruptLogError(InputError):
    """The file begins like a log of its format and cannot be read as one."""


class EmptyLogError(InputError):
    """The file, or every channel in it, is empty."""


class LogTooLargeError(InputError):
    """The file is larger than the stated limit."""


class MissingChannelError(InputError):
    """A channel that the task needs is not in the log."""


class ChannelMapError(InputError):
    """A channel map is not valid, or does not fit the table it is used on."""


class DataError(EivorError):
    """Arrays that cannot be used: wrong shape, not finite, too short."""


class ShapeError(DataError):
    """Arrays whose shapes do not fit each other."""


class NonFiniteError(DataError):
    """NaN or infinity where a number is needed."""


class TooFewSamplesError(DataError):
    """Fewer rows than the estimate needs."""


class EstimationError(EivorError):
    """The equations have no solution that deserves the name."""


class NotIdentifiedError(EstimationError):
    """A quantity that is needed was not identified, and nothing was given in its place."""


class CollinearError(EstimationError):
    """Columns of which one is a combination of the others."""


class NoUniqueSolutionError(EstimationError):
    """A total least squares problem without a (unique) solution."""


class ConvergenceError(EstimationError):
    """An iteration that does not settle."""


class MissingNoiseError(EstimationError):
    """A compensated method needs the noise of a channel that nothing is declared of."""


class CovarianceError(EstimationError):
    """A covariance matrix that is not symmetric, or not positive semidefinite."""


class InstrumentError(EstimationError):
    """Instruments that are missing, constant, or too few."""
