"""What a result says of a flight in which the model does not hold: found in its findings and sentences."""

from __future__ import annotations

import re
from collections.abc import Iterator

from eivor.flights.result import FlightEstimate
from eivor.motions.vertical.misspecification import MISSED

#: What is told in sentences.
SENTENCES: dict[str, re.Pattern[str]] = {
    "thrust curve": re.compile(r"thrust grows as the command to the power"),
    "accelerometer late": re.compile(r"accelerometer is [\d.]+ ± [\d.]+ ms behind"),
    "velocity late": re.compile(r"velocity is [\d.]+ ± [\d.]+ ms behind"),
    "velocity reads more": re.compile(r"velocity reads [\d.]+ ?% \(± [\d.]+ ?%\) more than"),
    "velocity reads less": re.compile(r"velocity reads [\d.]+ ?% \(± [\d.]+ ?%\) less than"),
    "tilt error": re.compile(r"Attitude and accelerometer differ by"),
    "sideways": re.compile(r"flew sideways at"),
    "voltage": re.compile(r"battery's voltage fell|No battery voltage is logged"),
    "lag contradicted": re.compile(r"contradicts the flight"),
    "lag from the frictions": re.compile(r"the lag rests on the differences of"),
}
#: Terms that are missed, by the p-value of their test.
TESTS = {
    "drag missed": "left_out_quadratic_drag_p_value",
    "ground missed": "left_out_ground_effect_p_value",
    "supply missed": "left_out_supply_p_value",
}
#: All that may be said.
NAMES = (*SENTENCES, *TESTS)


def named(result: FlightEstimate) -> dict[str, bool]:
    """Say which of `NAMES` a result says, in its sentences, those of its quantities, or its findings."""
    text = "\n".join(_sentences(result))
    results = {name: pattern.search(text) is not None for name, pattern in SENTENCES.items()}
    return results | {name: result.diagnostics.get(key, 1.0) < MISSED for name, key in TESTS.items()}


def _sentences(result: FlightEstimate) -> Iterator[str]:
    yield from result.verdict.sentences
    for quantity in result.quantities.values():
        for reason in quantity.reasons:
            yield f"{reason.sentence} {reason.remedy}"
    for finding in result.findings:
        yield f"{finding.name}: {finding.message}"
