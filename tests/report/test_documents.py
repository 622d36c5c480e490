"""Documents of results and inspections: on the terminal, in any medium, and the words of their numbers."""

from __future__ import annotations

import io
import re
from collections import Counter
from dataclasses import replace

import pytest
from rich.console import Console

from eivor.flights.options import FlightOptions
from eivor.flights.quantity import Quantity, QuantitySpec
from eivor.flights.result import FlightEstimate, LogEstimate
from eivor.inference.verdict import Cause, Reason, Status
from eivor.motions.vertical.motion import Vertical
from eivor.report.document import NO_NUMBER, Bullets, Card, CardLine, Document, Look, QuantityRow, TableOf
from eivor.report.flight import log_documents, result_card
from eivor.report.inspection import inspection, inspection_document
from eivor.report.json_document import json_document
from eivor.report.terminal import on_terminal
from eivor.signals.channels import CurveSide
from eivor.signals.recording import Finding, Recording
from eivor.tools import printable

HOVER = "hover_input"


@pytest.mark.parametrize("name", ["fit", pytest.param("pool", marks=pytest.mark.thorough), "still"])
def test_json_and_document_tell_the_same(name: str, request: pytest.FixtureRequest) -> None:
    result: FlightEstimate = request.getfixturevalue(name)
    document, json = log_documents(LogEstimate({"motion": result}))[0], json_document(result)
    sections = {section.heading: section.parts for section in document.sections}
    assert document.card is not None
    assert document.card.title == json["summary"]
    lines = [line for group in document.card.groups for line in group.lines]
    parts = [part for title in ("Why", "What to do") for part in sections.get(title, ())]
    texts = " ".join(sentence for part in parts if isinstance(part, Bullets) for sentence in part.sentences)
    texts += " ".join(f" {line.text} {line.remark}" for line in lines)
    assert all(reason.split(". ")[0].rstrip(".") in texts for reason in json["reasons"])
    tables = [part for part in sections[""] if isinstance(part, TableOf)]
    in_table = {row[0].text: row[-1].status for table in tables for row in table.rows}
    in_card = {line.quantity: group.look.value for group in document.card.groups for line in group.lines}
    for key, reported in (json["parameters"] | json["derived"]).items():
        words = result.motion.quantities[key].words
        if reported["value"] is not None:
            assert (words in in_table) != (key in in_card)
            assert reported["verdict"] in (in_card.get(key), getattr(in_table.get(words), "value", ""))
    rows = [Status(row["verdict"]).label for row in (*json["flights"], *json["comparisons"])]
    tables = [
        sections[title][0] for title in ("Flights one by one", "Methods side by side") if title in sections
    ]
    assert [row[0].below for table in tables for row in table.rows] == rows


HOSTILE = "[red]x[/] [link=http://a]y[/link]\x1b[2J\n$z$"


def _text(report: object, width: int, *, colour: bool = False) -> str:
    stream = io.StringIO()
    system = "truecolor" if colour else None
    Console(file=stream, width=width, force_terminal=colour, color_system=system).print(report)  # type: ignore[arg-type]
    return stream.getvalue()


@pytest.mark.thorough
@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_nothing_is_cut_off(pool: FlightEstimate, width: int) -> None:
    text = _text(on_terminal(log_documents(LogEstimate({"motion": pool}))[0]), width)
    assert "…" not in text
    assert max(len(line) for line in text.splitlines()) <= width
    assert all(title in text for title in ("K [1/s]", "K_u [m/s²]", "τ + d [ms]"))
    squeezed = "".join(text.split())
    assert "".join(pool.instruments.split()) in squeezed
    for row in (*pool.flights, *pool.comparisons):
        assert row.label in squeezed


@pytest.mark.thorough
@pytest.mark.parametrize("width", [40, 60, 80, 120])
@pytest.mark.parametrize("name", ["fit", "pool", "still"])
def test_no_number_is_broken(name: str, width: int, request: pytest.FixtureRequest) -> None:
    """In narrow windows no interval either."""
    document = log_documents(LogEstimate({"motion": request.getfixturevalue(name)}))[0]
    text = _text(on_terminal(document), width)
    tables = [part for section in document.sections for part in section.parts if isinstance(part, TableOf)]
    cells = [cell for table in tables for row in table.rows for cell in row]
    numbers = [part for cell in cells for part in (cell.text, cell.below) if re.search(r"\d", part)]
    assert document.card is not None
    lines = [line for group in document.card.groups for line in group.lines if line.quantity]
    numbers += [part for line in lines for part in (line.text, line.interval)]
    assert len(numbers) >= (0 if name == "still" else 14)
    pieces = numbers if width < 72 else [word for part in numbers for word in part.split()]
    counter, needed = Counter(" ".join(text.split("\n")).split()), Counter(" ".join(pieces).split())
    assert needed <= counter
    assert all(any(piece in line for line in text.splitlines()) for piece in pieces)


def test_the_card_comes_first_in_words_and_in_colour(fit: FlightEstimate) -> None:
    document = on_terminal(log_documents(LogEstimate({"motion": fit}))[0])
    shown = _text(document, 80).splitlines()
    assert shown[1:4:2] == ["Viscous friction 0.186 [0.136, 0.205] 1/s", "Identified"]
    assert "\x1b[1;32mIdentified" in _text(document, 80, colour=True)


def test_a_result_without_estimate_says_why_and_what_to_fly(still: FlightEstimate) -> None:
    text = _text(on_terminal(log_documents(LogEstimate({"motion": still}), card=True)[0]), 80)
    assert "The input is constant" in text
    assert "Flight card" in text
    assert "--card" not in text
    assert "nan" not in text
    assert "inf" not in text.replace("information", "")


@pytest.mark.thorough
def test_an_inspection_shows_hostile_sources(recording: Recording) -> None:
    channels = {**recording.channels}
    channels["velocity_z"] = replace(channels["velocity_z"], source=HOSTILE)
    log = replace(recording, channels=channels, parameters={"MPC_THR_HOVER": 0.35})
    result = inspection(log, FlightOptions(), Vertical())
    text = _text(on_terminal(inspection_document(result)), 120)
    assert "\x1b" not in text
    assert "[red]x[/]" in text
    assert "MPC_THR_HOVER = 0.35" in text


NAN, INFINITY = float("nan"), float("inf")
PLAIN = QuantitySpec("x", "x", "")


@pytest.mark.parametrize(
    ("value", "low", "high", "shown"),
    [
        (0.18596, 0.1623, 0.2096, ("0.186", "[0.162, 0.210]")),
        (69.29, 64.03, 75.67, ("69.3", "[64.0, 75.7]")),
        (0.119812, 0.115812, 0.1232, ("0.1198", "[0.1158, 0.1232]")),
        (1787.79, 1786.85, 1788.74, ("1787.79", "[1786.85, 1788.74]")),
        (3.068e-6, 3.056e-6, 3.081e-6, ("3.068e-6", "[3.056e-6, 3.081e-6]")),
        (-0.0001, -0.04, 0.04, ("0.000", "[-0.040, 0.040]")),
        (12.0, -5870.0, 7012.0, ("0", "[-5900, 7000]")),
        (0.0, 0.0, 0.0, ("0", "[0, 0]")),
        (0.5, 0.5, 0.5, ("0.5000", "[0.5000, 0.5000]")),
        (NAN, -INFINITY, INFINITY, (NO_NUMBER, NO_NUMBER)),
        (0.5136, -INFINITY, INFINITY, ("0.5136", NO_NUMBER)),
        (2.5e7, 2.4e7, 2.6e7, ("2.50e7", "[2.40e7, 2.60e7]")),
    ],
)
def test_the_interval_decides_the_digits(
    value: float, low: float, high: float, shown: tuple[str, str]
) -> None:
    quantity = Quantity(value, "", NAN, (low, high), verdict=Status.WEAK)
    assert QuantityRow("x", PLAIN, quantity).texts == shown


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("flight.ulg", "flight.ulg"),
        ("Übung 飛行.csv", "Übung 飛行.csv"),
        ("\x1b[31mred", "\\x1b[31mred"),
        ("a\nb\tc\r\x07", "a\\nb\\tc\\r\\x07"),
        ("\u202egnp.exe", "\\u202egnp.exe"),
        ("\udcff", "\\udcff"),
        ("\x9b31m", "\\x9b31m"),
    ],
)
def test_nothing_that_acts_on_a_terminal_passes(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_a_reason_is_no_finding_besides(still: FlightEstimate) -> None:
    reason = still.verdict.reasons[0].sentence
    result = LogEstimate({"motion": replace(still, findings=(Finding("no_flight", reason),))})
    (document,) = log_documents(result)
    assert str(document.sections).count(reason) == 0
    assert str(document.card).count(reason.removesuffix(".")) == 1


OUTSIDE, INSIDE = "0.58 is outside the interval: hover is 11% lower.", "0.52 is inside the interval."
TOGETHER = (
    "Of motor signals, hover and curve are written together or not at all: thrust_curve is not estimated."
)
LINES = [
    (Status.IDENTIFIED, CurveSide.BEFORE, 0.58, "MPC_THR_HOVER 0.58 -> 0.515", OUTSIDE),
    (Status.IDENTIFIED, CurveSide.BEFORE, 0.52, "MPC_THR_HOVER 0.52 -> 0.515", INSIDE),
    (Status.IDENTIFIED, CurveSide.BEHIND, 0.58, "MPC_THR_HOVER is 0.58", TOGETHER),
    (Status.WEAK, CurveSide.BEFORE, 0.58, "MPC_THR_HOVER is 0.58", OUTSIDE),
    (Status.REFUSED, CurveSide.BEFORE, 0.58, "", ""),
]


def card_of(fit: FlightEstimate, quantity: Quantity, side: CurveSide, old: float) -> Card:
    """Card of a result whose log has a hover parameter."""
    flight = fit.prepared[0]
    log = replace(flight.recording, parameters={"MPC_THR_HOVER": old}, format="ulog")
    prepared = (replace(flight, recording=log, curve_side=side),)
    return result_card((replace(fit, prepared=prepared, quantities={**fit.quantities, HOVER: quantity}),))


@pytest.mark.parametrize(("verdict", "side", "old", "setting", "remark"), LINES)
def test_the_card_sets_what_is_identified_and_in_the_terms_of_its_parameter(
    fit, verdict, side, old, setting, remark
):
    hover = Quantity(0.515, "", 0.006, (0.503, 0.527), verdict=verdict)
    card = card_of(fit, hover, side, old)
    lines = [line for group in card.groups for line in group.lines if line.quantity == HOVER]
    assert [(line.setting, line.remark) for line in lines] == ([(setting, remark)] if setting else [])
    commands = [line.command for line in lines if line.command]
    assert commands == (["param set MPC_THR_HOVER 0.515"] if "->" in setting else [])
    if verdict is Status.IDENTIFIED:
        of_parameter = f"Hover throttle 0.515 [0.503, 0.527], MPC_THR_HOVER is {old}"
        assert card.title == (of_parameter if remark != TOGETHER else "Hover input 0.515 [0.503, 0.527]")


def test_a_setting_is_not_broken(fit):
    card = card_of(
        fit, Quantity(0.515, "", 0.006, (0.503, 0.527), verdict=Status.IDENTIFIED), CurveSide.BEFORE, 0.58
    )
    text = _text(on_terminal(Document("flight", "", (), card)), 70)
    assert "MPC_THR_HOVER 0.58 -> 0.515" in map(str.strip, text.splitlines())


def test_a_log_that_is_damaged_says_so_in_red(fit, still):
    damage = Finding("corrupt_parts", "Damaged parts were left out: 12 bytes.")
    for result, title in ((fit, "Viscous friction"), (still, "The log is damaged")):
        flight = result.prepared[0]
        log = replace(flight.recording, findings=(*flight.recording.findings, damage))
        card = result_card((replace(result, prepared=(replace(flight, recording=log),)),))
        group = card.groups[-1]
        assert card.title.startswith(title)
        assert (group.look, group.heading) == (Look.CONTRADICTED, "Damaged")
        assert group.lines[0].text == damage.message


def test_only_a_contradiction_is_red(fit):
    reasons = {
        Look.MISSING: Reason(Status.REFUSED, "The interval is ±9% wide; it needs ±5%.", "Fly.", Cause.WIDE),
        Look.CONTRADICTED: Reason(Status.REFUSED, "It falls upward.", "Turn it.", Cause.CONTRADICTION),
    }
    for look, reason in reasons.items():
        hover = Quantity(0.515, "", 0.006, (0.4, 0.6), reasons=(reason,))
        group = card_of(fit, hover, CurveSide.BEFORE, 0.58).groups[-1]
        why = "the interval is too wide." if look is Look.MISSING else reason.sentence
        assert (group.look, group.lines) == (look, (CardLine("Hover input", why, remark=reason.remedy),))


def test_a_remedy_names_the_profile_that_logs_faster(fit):
    reason = Reason(Status.REFUSED, "It is slow.", "Log both at 50 Hz or more.")
    hover = Quantity(0.515, "", 0.006, (0.4, 0.6), reasons=(reason,))
    (line,) = card_of(fit, hover, CurveSide.BEFORE, 0.58).groups[-1].lines
    assert line.remark == "Log both at 50 Hz or more (SDLOG_PROFILE 25)."
