"""Requests that are refused, and errors as the page is told them."""

from __future__ import annotations

from http import HTTPStatus

from eivor.errors import EivorError, NotIdentifiedError

#: Parts of an error: what was expected, what came, what to do, and all of it as a sentence.
Told = dict[str, str]


class RefusedError(EivorError):
    """A request that is not done."""

    def __init__(self, status: HTTPStatus, expected: str, received: str, remedy: str) -> None:
        super().__init__(expected, received, remedy)
        self.status = status

    def __reduce__(self) -> tuple[type[EivorError], tuple[str, str, str]]:
        return EivorError, (self.expected, self.received, self.remedy)


def told(error: EivorError) -> Told:
    """Parts of an error."""
    return {
        "expected": error.expected,
        "received": error.received,
        "advice": error.remedy,
        "sentence": str(error),
    }


def status_of(error: EivorError) -> HTTPStatus:
    """Status of the answer that tells an error."""
    if isinstance(error, RefusedError):
        return error.status
    return HTTPStatus.CONFLICT if isinstance(error, NotIdentifiedError) else HTTPStatus.BAD_REQUEST


def absent(what: str, name: str) -> RefusedError:
    """Error of something that is not there, or not any more."""
    return RefusedError(
        HTTPStatus.NOT_FOUND,
        f"{what} that is there",
        f"'{name[:100]}'",
        "What is an hour old is forgotten: drop the log again.",
    )
