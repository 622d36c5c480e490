from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.report.card import flight_card
from eivor.report.inspection import inspection
from eivor.report.inspection_table import inspection_report
from eivor.report.table import COLOURS, MEANINGS, identification_report
from eivor.signals.recording import Finding, Recording

HOSTILE = "[red]x[/] [link=http://a]y[/link]\x1b[2J\n$z$"


def _text(report: object, width: int, *, colour: bool = False) -> str:
    stream = io.StringIO()
    system = "truecolor" if colour else None
    Console(file=stream, width=width, force_terminal=colour, color_system=system).print(report)  # type: ignore[arg-type]
    return stream.getvalue()


@pytest.mark.parametrize("width", [60, 80, 120])
def test_nothing_is_cut_off(pool: FlightEstimate, width: int) -> None:
    text = _text(identification_report(pool), width)
    assert "…" not in text
    assert max(len(line) for line in text.splitlines()) <= width
    assert all(title in text for title in ("K [1/s]", "K_u [m/s²]", "τ + d [ms]"))
    squeezed = "".join(text.split())
    assert "".join(pool.instruments.split()) in squeezed
    for row in (*pool.flights, *pool.comparisons):
        assert row.label in squeezed


def test_the_verdict_is_in_words_and_in_colour(fit: FlightEstimate) -> None:
    assert "IDENTIFIED" in _text(identification_report(fit), 80)
    assert "\x1b[1;32mIDENTIFIED" in _text(identification_report(fit), 80, colour=True)


def test_every_verdict_has_a_colour_and_a_meaning() -> None:
    assert set(COLOURS) == set(MEANINGS) == set(Status)


def test_a_result_without_estimate_says_why_and_what_to_fly(still: FlightEstimate) -> None:
    text = _text(identification_report(still), 80)
    assert "The input is constant" in text
    assert "Flight card" in text
    assert "nan" not in text
    assert "inf" not in text.replace("information", "")


def test_the_card_is_for_flights_that_are_not_identified(fit: FlightEstimate, still: FlightEstimate) -> None:
    assert flight_card(fit) == ()
    assert [section.title for section in flight_card(still)] == ["Fly", "Log", "Setpoints"]


def test_what_is_said_of_every_log_is_said_once(pool: FlightEstimate) -> None:
    findings = tuple(
        Finding("no_attitude", f"{flight.recording.name}: No attitude.") for flight in pool.prepared
    )
    text = _text(identification_report(replace(pool, findings=findings)), 80)
    assert "Every log: No attitude." in text
    assert "first: No attitude." not in text


def test_strings_of_a_log_are_shown_and_not_obeyed(fit: FlightEstimate) -> None:
    flight = fit.prepared[0]
    hostile = replace(
        fit,
        prepared=(replace(flight, recording=replace(flight.recording, name=HOSTILE)),),
        findings=(Finding("x", HOSTILE),),
    )
    text = _text(identification_report(hostile), 80)
    assert "\x1b" not in text
    assert text.count("[red]x[/] [link=http://a]y[/link]\\x1b[2J\\n$z$") == 2


def test_an_inspection_shows_hostile_sources(recording: Recording) -> None:
    channels = {**recording.channels}
    channels["velocity_z"] = replace(channels["velocity_z"], source=HOSTILE)
    found = inspection(replace(recording, channels=channels, parameters={"MPC_THR_HOVER": 0.35}), _options())
    text = _text(inspection_report(found), 120)
    assert "\x1b" not in text
    assert "[red]x[/]" in text
    assert "MPC_THR_HOVER = 0.35" in text


def _options() -> object:
    from eivor.flights.options import FlightOptions

    return FlightOptions()
