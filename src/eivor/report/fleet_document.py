"""The document of a fleet: what its types and vehicles have, what changes, and what was left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import polars as pl

from eivor.fleets.pooled_rows import SINGLE, UNKNOWN, VEHICLE
from eivor.fleets.report import FleetReport
from eivor.report.document import Bullets, Cell, Document, Figure, Section, TableColumn, TableOf, Tone
from eivor.report.flight_document import section
from eivor.report.told_fleet import (
    MOST,
    Row,
    between_told,
    changes_told,
    covariates_told,
    differences_told,
    few_told,
    interval_told,
    left_out_told,
    mean_told,
    next_told,
    only_told,
    singles_told,
)

#: Vehicles in a table, at most.
MOST_VEHICLES = 30
#: Sections in which a page has pictures.
FOREST, LINES = "forest", "lines"


def fleet_document(report: FleetReport, title: str, links: Mapping[str, str] | None = None) -> Document:
    """Document of a fleet's report.

    Parameters
    ----------
    report : FleetReport
        Of one motion.
    title : str
        The fleet's name.
    links : mapping of str to str, optional
        Addresses of flights' own reports, by the hash of their logs; for media that have links.
    """
    return Document(title, None, about_fleet(report), tuple(_sections(report, links)))


def about_fleet(report: FleetReport) -> str:
    """How many logs, vehicles and types there are."""
    flights = report.flights
    known = flights.filter(~pl.col(SINGLE))
    vehicles = known.select(VEHICLE).n_unique()
    types = known.filter(pl.col("type") != UNKNOWN)["type"].n_unique()
    counts = [_count(report.logs["logs"], "log")]
    if report.logs["copies"]:
        counts.append(
            "1 of them a copy" if report.logs["copies"] == 1 else f"{report.logs['copies']} of them copies"
        )
    if report.logs["failed"]:
        counts.append(f"{report.logs['failed']} without a result")
    told = f"{_count(vehicles, 'vehicle')} of {_count(types, 'type')}"
    if flights.height > known.height:
        told += f"; {_count(flights.height - known.height, 'log')} without a vehicle, each by itself"
    return f"{report.motion.words.title}: {', '.join(counts)}; {told}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number:,} {what}s"


def _sections(report: FleetReport, links: Mapping[str, str] | None) -> Iterator[Section]:
    if not report.vehicles.height:
        yield Section("Nothing to pool", (Bullets(("No flight tells a quantity with a standard error.",)),))
        yield from section("Left out", Bullets, left_out_told(report))
        return
    types = list(report.types.iter_rows(named=True))
    if types:
        yield Section("By type", (_types(report, types), *_notes(few_told(types, "vehicles"))))
    shown = _shown(report.vehicles)
    vehicles = list(shown.iter_rows(named=True))
    notes = [*few_told(vehicles, "flights"), *only_told(vehicles), *singles_told(report)]
    if (count := report.vehicles.select("type", "vehicle").n_unique()) > MOST_VEHICLES:
        notes.append(
            f"{MOST_VEHICLES} of {count} vehicles, those that change or differ first; the JSON has all."
        )
    yield Section("By vehicle", (_vehicles(report, vehicles), *_notes(notes), Figure(FOREST)))
    nothing = ["No vehicle has enough flights with a time, or none changes by more than chance would."]
    yield Section("Changes", (Bullets(tuple(changes_told(report) or nothing)), Figure(LINES)))
    if report.deviating.height:
        yield Section("Flights that deviate", tuple(_deviating(report, links)))
    yield from section("Vehicles that differ", Bullets, differences_told(report))
    yield from section("Left out", Bullets, left_out_told(report))
    yield from section("Taken out before changes were sought", Bullets, covariates_told(report))


def _notes(notes: Iterator[str] | list[str]) -> tuple[Bullets, ...]:
    told = tuple(notes)
    return (Bullets(told),) if told else ()


def shown_vehicles(vehicles: pl.DataFrame) -> pl.DataFrame:
    """Vehicles by what is noticed of them: those that change or differ first."""
    noticed = pl.col("course").is_in(["drifts", "steps"]) | pl.col("differs")
    by_vehicle = vehicles.group_by("type", "vehicle", maintain_order=True).agg(noticed.any().alias("noticed"))
    return by_vehicle.sort("noticed", descending=True, maintain_order=True)


def _shown(vehicles: pl.DataFrame) -> pl.DataFrame:
    chosen = shown_vehicles(vehicles).head(MOST_VEHICLES).with_row_index("place")
    numbered = vehicles.with_row_index("order")
    return chosen.join(numbered, on=["type", "vehicle"], maintain_order="left").sort("place", "order")


def linked(name: str, sha256: str, links: Mapping[str, str]) -> Cell:
    """A flight's name, which leads to its report; one without says so where others have one."""
    link = links.get(sha256, "")
    return Cell(name, "no report of its own" if links and not link else "", link=link)


def _deviating(report: FleetReport, links: Mapping[str, str] | None) -> Iterator[TableOf | Bullets]:
    """Flights that deviate, the clearest first."""
    rows = list(report.deviating.head(MOST).iter_rows(named=True))
    cells = []
    for row in rows:
        wording = report.motion.wording[row["quantity"]]
        unit = f" [{wording.shown_unit}]" if wording.shown_unit else ""
        cells.append(
            (
                linked(row["name"], row["sha256"], links or {}),
                Cell(row["vehicle"]),
                Cell(f"{wording.words} {wording.symbol}{unit}"),
                Cell(*interval_told(row, wording, ("value", "low", "high"))),
                Cell(f"{row['expected'] * wording.scale:.4g}"),
            )
        )
    columns = (
        TableColumn("flight", strong=True),
        TableColumn("vehicle"),
        TableColumn("quantity"),
        TableColumn("value", right=True, whole=True, below=Tone.FAINT),
        TableColumn("the others", right=True, whole=True),
    )
    yield TableOf(columns, tuple(cells))
    if report.deviating.height > MOST:
        yield Bullets((f"{report.deviating.height} flights and quantities deviate; the JSON has all.",))


def _columns(first: str, members: str, following: str) -> tuple[TableColumn, ...]:
    return (
        TableColumn(first, strong=True),
        TableColumn("quantity"),
        TableColumn("mean", right=True, whole=True, below=Tone.FAINT),
        TableColumn("between", right=True, whole=True, below=Tone.FAINT),
        TableColumn(following, right=True, whole=True),
        TableColumn(members, right=True, below=Tone.FAINT),
    )


def _cells(report: FleetReport, row: Row, first: str) -> tuple[Cell, ...]:
    across = next(one for one in report.quantities if one.name == row["quantity"])
    wording = report.motion.wording[across.name]
    value, interval = mean_told(row, wording)
    unit = f" [{wording.shown_unit}]" if wording.shown_unit else ""
    left_out = f"{row['left_out']} left out" if row.get("left_out") else ""
    return (
        Cell(first),
        Cell(f"{wording.words} {wording.symbol}{unit}"),
        Cell(value, interval),
        Cell(*between_told(row, across, wording)),
        Cell(next_told(row, wording)),
        Cell(f"{row['pooled']}", left_out),
    )


def _types(report: FleetReport, rows: Sequence[Row]) -> TableOf:
    ordered = sorted(rows, key=lambda row: row["type"])
    seen: set[str] = set()
    cells = []
    for row in ordered:
        cells.append(_cells(report, row, "" if row["type"] in seen else row["type"]))
        seen.add(row["type"])
    return TableOf(_columns("type", "vehicles", "next vehicle"), tuple(cells))


def _vehicles(report: FleetReport, rows: Sequence[Row]) -> TableOf:
    columns = (*_columns("vehicle", "flights", "next flight"), TableColumn("course", whole=True))
    seen: set[tuple[str, str]] = set()
    cells = []
    for row in rows:
        key = (row["type"], row["vehicle"])
        cells.append((*_cells(report, row, "" if key in seen else row["vehicle"]), Cell(row["course"])))
        seen.add(key)
    return TableOf(columns, tuple(cells))
