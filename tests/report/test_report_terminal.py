from __future__ import annotations

import io
import re
from collections import Counter
from dataclasses import replace

import pytest
from rich.console import Console

from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.motions.vertical.motion import Vertical
from eivor.report.document import TableOf
from eivor.report.flight import flight_card, flight_document
from eivor.report.inspection import inspection, inspection_document
from eivor.report.terminal import COLOURS, on_terminal
from eivor.signals.recording import Finding, Recording

HOSTILE = "[red]x[/] [link=http://a]y[/link]\x1b[2J\n$z$"


def _text(report: object, width: int, *, colour: bool = False) -> str:
    stream = io.StringIO()
    system = "truecolor" if colour else None
    Console(file=stream, width=width, force_terminal=colour, color_system=system).print(report)  # type: ignore[arg-type]
    return stream.getvalue()


def _lines(text: str) -> list[str]:
    return [line.rstrip() for line in text.splitlines()]


@pytest.mark.thorough
@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_nothing_is_cut_off(pool: FlightEstimate, width: int) -> None:
    text = _text(on_terminal(flight_document(pool)), width)
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
    document = flight_document(request.getfixturevalue(name))
    text = _text(on_terminal(document), width)
    tables = [part for section in document.sections for part in section.parts if isinstance(part, TableOf)]
    cells = [cell for table in tables for row in table.rows for cell in row]
    numbers = [part for cell in cells for part in (cell.text, cell.below) if re.search(r"\d", part)]
    assert len(numbers) >= (0 if name == "still" else 14)
    pieces = numbers if width < 72 else [word for part in numbers for word in part.split()]
    counter, needed = Counter(" ".join(text.split("\n")).split()), Counter(" ".join(pieces).split())
    assert needed <= counter
    assert all(any(piece in line for line in text.splitlines()) for piece in pieces)


@pytest.mark.thorough
@pytest.mark.parametrize("width", [40, 60])
def test_columns_fold_into_rows_where_their_numbers_would_break(pool: FlightEstimate, width: int) -> None:
    lines = _lines(_text(on_terminal(flight_document(pool)), width))
    row = lines.index("Flights one by one") + 1
    assert lines[row].split() == ["first", pool.flights[0].verdict.value]
    assert lines[row + 1].startswith("  K [1/s]")


@pytest.mark.thorough
def test_a_long_word_folds_and_its_row_stays(pool: FlightEstimate) -> None:
    long = replace(pool.flights[0], label="a_log_with_a_very_long_name_that_no_window_holds.csv")
    text = _text(on_terminal(flight_document(replace(pool, flights=(long,)))), 40)
    assert max(len(line) for line in text.splitlines()) <= 40
    assert long.label in "".join(text.split())


def test_the_verdict_is_in_words_and_in_colour(fit: FlightEstimate) -> None:
    assert "IDENTIFIED" in _text(on_terminal(flight_document(fit)), 80)
    assert "\x1b[1;32mIDENTIFIED" in _text(on_terminal(flight_document(fit)), 80, colour=True)


def test_every_verdict_has_a_colour_and_a_meaning() -> None:
    assert set(COLOURS) == set(Vertical.words.meanings) == set(Status)


def test_a_result_without_estimate_says_why_and_what_to_fly(still: FlightEstimate) -> None:
    text = _text(on_terminal(flight_document(still, card=True)), 80)
    assert "The input is constant" in text
    assert "Flight card" in text
    assert "--card" not in text
    assert "nan" not in text
    assert "inf" not in text.replace("information", "")


def test_the_card_is_for_flights_that_are_not_identified(fit: FlightEstimate, still: FlightEstimate) -> None:
    assert flight_card(fit) == ()
    assert [section.title for section in flight_card(still)] == ["Fly", "Log", "Setpoints"]


def test_a_refusal_is_short_and_says_where_the_card_is(still: FlightEstimate) -> None:
    lines = _lines(_text(on_terminal(flight_document(still)), 80))
    assert "Flight card" not in lines
    assert lines[1].startswith("REFUSED")
    assert sum("--card" in line for line in lines) == 1
    why, remedy = lines.index("Why"), lines.index("What to do")
    assert lines.index("quantity                 value  95 % interval  unit  verdict") < why < remedy
    assert len(lines) < 30


def test_a_reason_is_no_finding_besides(still: FlightEstimate) -> None:
    reason = still.verdict.reasons[0].sentence
    document = flight_document(replace(still, findings=(Finding("no_flight", reason),)))
    assert str(document).count(reason) == 1


@pytest.mark.thorough
def test_what_is_said_of_every_log_is_said_once(pool: FlightEstimate) -> None:
    findings = tuple(
        Finding("no_attitude", f"{flight.recording.name}: No attitude.") for flight in pool.prepared
    )
    text = _text(on_terminal(flight_document(replace(pool, findings=findings))), 80)
    assert "Every log: No attitude." in text
    assert "first: No attitude." not in text


def test_strings_of_a_log_are_shown_and_not_obeyed(fit: FlightEstimate) -> None:
    flight = fit.prepared[0]
    hostile = replace(
        fit,
        prepared=(replace(flight, recording=replace(flight.recording, name=HOSTILE)),),
        findings=(Finding("x", HOSTILE),),
    )
    text = _text(on_terminal(flight_document(hostile)), 80)
    assert "\x1b" not in text
    assert text.count("[red]x[/] [link=http://a]y[/link]\\x1b[2J\\n$z$") == 2


@pytest.mark.thorough
def test_an_inspection_shows_hostile_sources(recording: Recording) -> None:
    channels = {**recording.channels}
    channels["velocity_z"] = replace(channels["velocity_z"], source=HOSTILE)
    result = inspection(
        replace(recording, channels=channels, parameters={"MPC_THR_HOVER": 0.35}), _options(), Vertical()
    )
    text = _text(on_terminal(inspection_document(result)), 120)
    assert "\x1b" not in text
    assert "[red]x[/]" in text
    assert "MPC_THR_HOVER = 0.35" in text


@pytest.mark.thorough
@pytest.mark.parametrize("width", [40, 60, 80])
def test_no_number_of_an_inspection_is_broken(recording: Recording, width: int) -> None:
    result = inspection(recording, _options(), Vertical())
    text = _text(on_terminal(inspection_document(result)), width)
    assert max(map(len, text.splitlines())) <= width
    words = Counter(text.split())
    rates = Counter(f"{summary.rate_hz:.1f}" for summary in result.channels)
    ends = Counter(f"{end:.4g}" for summary in result.channels for end in (summary.lowest, summary.highest))
    assert rates + ends <= words


@pytest.mark.thorough
def test_a_source_is_not_broken_where_it_fits(recording: Recording) -> None:
    """A name of PX4's that is longer than a third of the window can still be copied whole."""
    source = "sensor_combined.accelerometer_m_s2[0]"
    channels = {
        name: replace(channel, source=source, delay_s=0.0025) for name, channel in recording.channels.items()
    }
    result = inspection(replace(recording, channels=channels), _options(), Vertical())
    text = _text(on_terminal(inspection_document(result)), 80)
    assert max(map(len, text.splitlines())) <= 80
    assert text.split().count(source) == len(channels)


@pytest.mark.thorough
def test_what_is_logged_now_and_then_has_a_rate(recording: Recording) -> None:
    result = inspection(recording, _options(), Vertical())
    seldom = replace(result, channels=tuple(replace(channel, rate_hz=0.0137) for channel in result.channels))
    words = _text(on_terminal(inspection_document(seldom)), 80).split()
    assert words.count("0.014") == len(result.channels)


def _options() -> object:
    from eivor.flights.options import FlightOptions

    return FlightOptions()
