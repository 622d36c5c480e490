"""Status of a verdict."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import msgspec


class Status(Enum):
    """How far an estimate may be trusted, best first."""

    IDENTIFIED = "identified"
    WEAK = "weak"
    PROVISIONAL = "provisional"
    REFUSED = "refused"

    @property
    def label(self) -> str:
        """How screens and pages say it; documents have the value."""
        return _SHOWN[self]


_SHOWN = {
    Status.IDENTIFIED: "identified",
    Status.WEAK: "rough",
    Status.PROVISIONAL: "not identified (provisional)",
    Status.REFUSED: "not identified",
}


class Cause(Enum):
    """What a reason is about, in words that quantities share; without words the sentence says it."""

    OTHER = ""
    CONTRADICTION = "contradiction"  # No longer interval mends it, nor another flight
    ZERO = "not distinguished from zero"
    WIDE = "the interval is too wide"
    EXCITATION = "the references moved too little"
    INSTRUMENT = "no instrument, so that disturbances bias it"


@dataclass(frozen=True, slots=True)
class Reason:
    """A reason for a verdict."""

    status: Status  # The best that it allows
    sentence: str
    remedy: str = ""  # What to fly or log instead
    cause: Cause = Cause.OTHER


class Verdict(msgspec.Struct, frozen=True):
    """Status and the reasons for it."""

    status: Status
    reasons: tuple[Reason, ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        return tuple(f"{reason.sentence} {reason.remedy}".strip() for reason in self.reasons)


def verdict(reasons: list[Reason]) -> Verdict:
    """Return the verdict that a list of reasons amounts to."""
    order = list(Status)
    ranked = sorted(reasons, key=lambda reason: -order.index(reason.status))
    return Verdict(ranked[0].status if ranked else Status.IDENTIFIED, tuple(ranked))
