"""What a result says of a flight in which the model does not hold: found in its findings and sentences."""

from __future__ import annotations

import re
from collections.abc import Iterator

from eivor.flights.result import FlightEstimate

#: What may have to be said, and how it is told in a result's findings (by name) and sentences.
NAMES: dict[str, re.Pattern[str]] = {
    "thrust curve": re.compile(r"thrust grows as the command to the power"),
    "offset in time": re.compile(r"is [\d.]+ ms (behind|ahead of)"),
    "scale": re.compile(r"scale"),
    "tilt error": re.compile(r"tilt(ed)? (error|by)|degrees"),
    "lag contradicted": re.compile(r"contradict"),
    "lag from the frictions": re.compile(r"differences of"),
}


def named(result: FlightEstimate) -> dict[str, bool]:
    """Say which of `NAMES` a result says, in its sentences, those of its quantities, or its findings."""
    said = "\n".join(_sentences(result))
    return {name: pattern.search(said) is not None for name, pattern in NAMES.items()}


def _sentences(result: FlightEstimate) -> Iterator[str]:
    yield from result.verdict.sentences
    for quantity in result.quantities.values():
        for reason in quantity.reasons:
            yield f"{reason.sentence} {reason.remedy}"
    for finding in result.findings:
        yield f"{finding.name}: {finding.message}"
