"""A document is told by any medium, without a look at the result; JSON says the same."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from coarse_search import coarse
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Reason, Status, Verdict
from eivor.motions.vertical.motion import Vertical
from eivor.report.document import Bullets, Document, Facts, Figure, Part, Statement, TableOf
from eivor.report.flight import document_of, flight_document, flight_report
from eivor.report.inspection import PooledInspection, inspection_document, pooled_documents, pooled_inspection
from eivor.report.json_document import inspection_json, json_document, json_of, json_text
from eivor.signals.recording import Finding, Recording


def markdown(document: Document) -> Iterator[str]:
    """Another medium."""
    yield f"# {document.title}"
    yield f"**{document.status.value if document.status else ''}** {document.about}"
    for section in document.sections:
        yield f"## {section.heading}"
        for part in section.parts:
            yield from _lines(part)


def _lines(part: Part) -> Iterator[str]:
    match part:
        case Facts():
            for fact in part.facts:
                reported = fact.text.sentences if isinstance(fact.text, Bullets) else (fact.text,)
                yield f"*{fact.label}* {'; '.join(reported)}"
        case TableOf():
            yield "|".join(column.title for column in part.columns)
            yield "|".join("--:" if column.right else ":--" for column in part.columns)
            yield from ("|".join(f"{cell.text} {cell.below}".strip() for cell in row) for row in part.rows)
        case Bullets():
            yield from (f"- {sentence}" for sentence in part.sentences)
        case Statement():
            yield f"**{part.text}**{part.more}"
        case Figure():
            yield f"![]({part.name}.svg)"


@pytest.mark.thorough
def test_another_medium_tells_a_result(pool: FlightEstimate) -> None:
    lines = list(markdown(flight_document(pool, card=True)))
    assert lines[0] == "# first, second"
    assert lines[1].startswith(f"**{pool.verdict.status.value}** ")
    quantities = next(line for line in lines if line.startswith("viscous friction|K|"))
    assert quantities.endswith(f"|1/s|{pool.quantities['viscous_friction'].verdict.value}")
    rows = [line for line in lines if line.startswith(tuple(f"{row.label} " for row in pool.comparisons))]
    assert len(rows) == len(pool.comparisons)
    assert "![](flight.svg)" in lines


@pytest.fixture(scope="module")
def inspected(recording: Recording) -> PooledInspection:
    """The inspection of the example flight."""
    with coarse():
        return pooled_inspection([recording], FlightOptions(), [None], Vertical())


@pytest.mark.thorough
def test_another_medium_tells_inspections(recording: Recording, inspected: PooledInspection) -> None:
    result = inspected
    lines = list(markdown(inspection_document(result.logs[0])))
    assert all(any(line.startswith(f"{name} ") for line in lines) for name in recording.channels)
    assert "**identified** (method reference_iv)" in lines
    *logs, together = pooled_documents(result)
    assert [log.title for log in logs] == [recording.name]
    assert [section.heading for section in together.sections] == [
        "What identify says of the 1 logs together (found by running it)"
    ]


@pytest.mark.thorough
def test_what_is_told_is_told_by_every_medium(pool: FlightEstimate) -> None:
    """Whatever the one source says is in the document and in JSON; neither asks the result for it."""
    changed = replace(
        pool,
        verdict=Verdict(Status.WEAK, (Reason(Status.WEAK, "A reason.", "A remedy."),)),
        findings=(Finding("name", "A finding."),),
    )
    flight = flight_report(changed)
    friction = replace(flight.quantities[0], quantity=replace(flight.quantities[0].quantity, value=4321.0))
    row = replace(
        flight.flights[0], label="another log", reasons=("A reason of it.",), quantities=(friction,)
    )
    flight = replace(
        flight,
        quantities=(friction, *flight.quantities[1:]),
        flights=(row,),
        comparisons=(replace(row, label="another method"),),
    )
    displayed = "\n".join(markdown(document_of(flight)))
    written = json_text(json_of(flight))
    for words in (
        "weak",
        "A reason.",
        "A remedy.",
        "4321",
        "A finding.",
        "another log",
        "A reason of it.",
        "another method",
    ):
        assert words in displayed, words
        assert words in written, words


@pytest.mark.thorough
def test_json_and_document_of_an_inspection_take_one_flight(inspected: PooledInspection) -> None:
    (logs,) = inspected.logs
    flight = logs.airborne
    assert flight is not None
    written: dict[str, Any] = inspection_json(logs)
    assert written["airborne"]["segments"] == [list(stretch) for stretch in flight.active]
    (start, end) = flight.active[0]
    assert any(f"{start:.1f} to {end:.1f} s" in line for line in markdown(inspection_document(logs)))


@pytest.mark.parametrize("name", ["fit", pytest.param("pool", marks=pytest.mark.thorough), "still"])
def test_json_and_document_tell_the_same(name: str, request: pytest.FixtureRequest) -> None:
    result: FlightEstimate = request.getfixturevalue(name)
    document, json = flight_document(result), json_document(result)
    assert document.status is Status(json["verdict"])
    sections = {section.heading: section.parts for section in document.sections}
    why = sections["Why"][0] if "Why" in sections else Bullets(())
    remedies = " ".join(sections["What to do"][0].sentences) if "What to do" in sections else ""
    assert isinstance(why, Bullets)
    for sentence, reason in zip(why.sentences, json["reasons"], strict=True):
        assert reason.startswith(sentence)
        assert reason.removeprefix(sentence).strip() in remedies
    table = sections[""][1]
    assert isinstance(table, TableOf)
    reported = json["parameters"] | json["derived"]
    displayed = [reported[key]["verdict"] for key in result.motion.plotted if key in reported]
    assert [row[-1].status for row in table.rows] == [Status(verdict) for verdict in displayed]
    rows = [row["verdict"] for row in (*json["flights"], *json["comparisons"])]
    tables = [
        sections[title][0] for title in ("Flights one by one", "Methods side by side") if title in sections
    ]
    assert [row[0].below for table in tables for row in table.rows] == rows
