"""Report of a fleet: document, JSON and page."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import polars as pl

from eivor.fleet import analysis as fleet
from eivor.fleet.table import report_path, reports_there
from eivor.flights.quantity import AcrossFlights, QuantitySpec
from eivor.inference.random_effects import FEW
from eivor.logs.read import is_local
from eivor.report import document as doc
from eivor.report import figure_panels as plots
from eivor.report.flight_page import Figures
from eivor.report.html import rendered, whole_page
from eivor.report.json_document import Json, document
from eivor.tools import capitalised

Row = Mapping[str, Any]
#: Sentences of one kind, at most.
MOST = 20
#: Of an interval that reaches so many times the value, digits that half its length determines would
#: leave a zero.
FAR = 20.0


def _across_of_row(report: fleet.FleetReport, row: Row) -> AcrossFlights:
    return next(quantity for quantity in report.quantities if quantity.name == row["quantity"])


def interval_text(row: Row, wording: QuantitySpec, names: tuple[str, str, str]) -> tuple[str, str]:
    """Value and interval of a row as they are shown."""
    value, low, high = _scaled(row, names, wording.scale)
    if 0.0 < FAR * value < high:
        return _two_digits(value), f"[{_two_digits(low)}, {_two_digits(high)}]"
    return doc.plain_numbers(value, (low, high))


def _scaled(row: Row, names: Iterable[str], scale: float) -> list[float]:
    return [math.nan if row[name] is None else scale * row[name] for name in names]


def mean_text(row: Row, wording: QuantitySpec) -> tuple[str, str]:
    """Mean and interval of a vehicle or type; of a single flight its own, with a mark."""
    if not _is_of_one_flight(row):
        return interval_text(row, wording, ("mean", "low", "high"))
    value, interval = interval_text(row, wording, ("mean", *fleet.ONLY))
    return value, f"{interval} †"


def _is_of_one_flight(row: Row) -> bool:
    return all(row.get(name) is not None for name in fleet.ONLY)


def _two_digits(number: float) -> str:
    return f"{float(f'{number:.2g}'):g}"


def between_text(row: Row, across: AcrossFlights, wording: QuantitySpec) -> tuple[str, str]:
    """Standard deviation between members, and its interval: a share where logarithms are compared."""
    names, scale = ("between", "between_low", "between_high"), 100.0 if across.logarithm else wording.scale
    value, low, high = _scaled(row, names, scale)
    if math.isnan(value + low + high):
        return doc.NO_NUMBER, ""
    if across.logarithm:
        return f"{value:.1f} %", f"[{low:.1f}, {high:.1f}]"
    return doc.plain_numbers(value, (low, high))


def next_text(row: Row, wording: QuantitySpec) -> str:
    """Interval of the next member, with a mark where there are few; none where it has no end."""
    if None in (row["next_low"], row["next_high"]):
        return doc.NO_NUMBER
    ends = (row["next_low"] * wording.scale, row["next_high"] * wording.scale)
    _, interval = doc.plain_numbers(row["mean"] * wording.scale, ends)
    return f"{interval} *" if row["pooled"] < FEW else interval


def few_footnote(rows: Sequence[Row], members: str) -> Iterator[str]:
    """Return what the mark of `next_text` means, where there is one."""
    if any(row["pooled"] < FEW and None not in (row["next_low"], row["next_high"]) for row in rows):
        yield f"* of fewer than {FEW} {members}: take it with care."


def report_changes(report: fleet.FleetReport) -> list[str]:
    """Return a sentence about each vehicle that changes, the clearest first."""
    changing = report.vehicles.filter(pl.col("course").is_in([fleet.DRIFTS, fleet.STEPS]))
    rows = sorted(changing.iter_rows(named=True), key=lambda row: min(row["change_p"], row["step_p"]))
    return _at_most([_change(report, row) for row in rows], "vehicles and quantities change")


def _change(report: fleet.FleetReport, row: Row) -> str:
    across = _across_of_row(report, row)
    words = report.motion.quantities[across.name].words
    who = f"{row['vehicle']}: the {words}"
    if row["course"] == fleet.DRIFTS:
        effect = _effect(report, across, row, "change")
        return f"{who} drifts by {effect} over {row['hours']:.3g} flight hours."
    when = f" ({row['step_start']:%Y-%m-%d})" if row["step_start"] else ""
    first, last = int(row["step_flight_first"]), int(row["step_flight_last"])
    text = f"flight {first}" if first == last else f"flights {first} to {last}"
    return (
        f"{who} steps by {_effect(report, across, row, 'step')} at flight {int(row['step_flight'])}{when}, "
        f"after {row['step_hours']:.3g} flight hours; the flights leave {text} open."
    )


def _effect(report: fleet.FleetReport, across: AcrossFlights, row: Row, name: str) -> str:
    wording = report.motion.quantities[across.name]
    scale, unit = (100.0, " %") if across.logarithm else (wording.scale, f" {wording.shown_unit}".rstrip())
    value, low, high = _scaled(row, (name, f"{name}_low", f"{name}_high"), scale)
    value_text, interval = doc.plain_numbers(value, (low, high))
    return f"{value_text}{unit} {interval}"


def _report_differences(report: fleet.FleetReport) -> list[str]:
    rows = report.vehicles.filter(report.vehicles["differs"]).sort("differs_p").iter_rows(named=True)
    selected = []
    for row in rows:
        wording = report.motion.quantities[row["quantity"]]
        value, interval = interval_text(row, wording, ("mean", "low", "high"))
        unit = f" {wording.shown_unit}" if wording.shown_unit else ""
        selected.append(
            f"{row['vehicle']}: its {wording.words}, {value}{unit} {interval}, is not that of the other "
            f"vehicles of type {row['type']}."
        )
    return _at_most(selected, "vehicles differ")


def _report_omitted(report: fleet.FleetReport) -> list[str]:
    return [
        f"{report.motion.quantities[row['quantity']].words}: {row['flights']} "
        f"{'flight' if row['flights'] == 1 else 'flights'}; {row['reason']}."
        for row in report.omitted.iter_rows(named=True)
    ]


def report_covariates(report: fleet.FleetReport) -> list[str]:
    """Return which slopes the flights reported, which were taken as expected, and what is not known."""
    selected = []
    for row in report.covariates.iter_rows(named=True):
        words = report.motion.quantities[row["quantity"]].words
        power = f"{row['slope']:.2f} ± {1.96 * row['std_error']:.2f}"
        covariate = row["covariate"].replace("_", " ")
        selected.append(f"{words} goes with {covariate} (type {row['type']}: {power}).")
    used = set(report.covariates.select("quantity", "covariate").iter_rows())
    missing: dict[str, list[str]] = {}
    expected: dict[str, list[str]] = {}
    for across in report.quantities:
        words = report.motion.quantities[across.name].words
        for covariate in across.covariates:
            key = (across.name, covariate.name)
            if key not in used:
                name = covariate.name.replace("_", " ")
                (expected if key in report.expected else missing).setdefault(name, []).append(words)
    sentences = _at_most(selected, "slopes were estimated")
    sentences += [
        f"The flights do not identify how {_or_list(words)} goes with {name}: what was expected "
        "beforehand is allowed for, with its uncertainty."
        for name, words in expected.items()
    ]
    return sentences + [
        f"{name} is not known of enough flights: what looks like a change of {_or_list(words)} may be it."
        for name, words in missing.items()
    ]


def _or_list(words: list[str]) -> str:
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last


def _at_most(names: list[str], phrase: str) -> list[str]:
    return names if len(names) <= MOST else [*names[:MOST], f"{len(names)} {phrase}; the JSON has all."]


#: Vehicles in a table, at most.
MOST_VEHICLES = 30
#: Sections in which a page has pictures.
FOREST, LINES = "forest", "lines"


def fleet_document(
    report: fleet.FleetReport, title: str, links: Mapping[str, str] | None = None
) -> doc.Document:
    """Document of a fleet's report."""
    return doc.Document(title, about_fleet(report), tuple(_sections(report, links)))


def about_fleet(report: fleet.FleetReport) -> str:
    """Sentence with the numbers of logs, vehicles and types."""
    flights = report.flights
    owned = flights.filter(~pl.col(fleet.SINGLE))
    vehicles = _count(owned.select(fleet.VEHICLE).n_unique(), "vehicle")
    types = _count(owned.filter(pl.col("type") != fleet.UNKNOWN)["type"].n_unique(), "type")
    text = f"{report.motion.words.title}: {_count(report.logs['logs'], 'log')}"
    if copies := report.logs["copies"]:
        text += ", 1 of them a copy" if copies == 1 else f", {copies} of them copies"
    if failed := report.logs["failed"]:
        text += f", {failed} without a result"
    text += f"; {vehicles} of {types}"
    if single := flights.height - owned.height:
        text += f"; {_count(single, 'log')} without a vehicle, each by itself"
    return text


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number:,} {noun}s"


def _sections(report: fleet.FleetReport, links: Mapping[str, str] | None) -> Iterator[doc.Section]:
    if not report.vehicles.height:
        yield doc.Section(
            "Nothing to pool", doc.bullets(["No flight identifies a quantity with a standard error."])
        )
        yield from doc.section("Left out", doc.Bullets, _report_omitted(report))
        return
    types = sorted(report.types.iter_rows(named=True), key=lambda row: row["type"])
    if types:
        footnotes = doc.bullets(few_footnote(types, "vehicles"))
        yield doc.Section("By type", (_members(report, types, "vehicle"), *footnotes))
    chosen = vehicles_to_report(report.vehicles).head(MOST_VEHICLES).with_row_index("place")
    numbered = report.vehicles.with_row_index("order")
    vehicle_rows = chosen.join(numbered, on=["type", "vehicle"], maintain_order="left").sort("place", "order")
    vehicles = list(vehicle_rows.iter_rows(named=True))
    notes = list(few_footnote(vehicles, "flights"))
    if any(map(_is_of_one_flight, vehicles)):
        notes.append("† of its only flight: how much flights differ is not in it.")
    if report.flights[fleet.SINGLE].any():
        notes.append(
            "A log without a vehicle id stands alone under its own name, and counts for no type. "
            "eivor fleet run --vehicle-from says which vehicle each log is of."
        )
    if (count := report.vehicles.select("type", "vehicle").n_unique()) > MOST_VEHICLES:
        firsts = "those that change or differ first; the JSON has all."
        notes.append(f"{MOST_VEHICLES} of {count} vehicles, {firsts}")
    yield doc.Section(
        "By vehicle", (_members(report, vehicles, "flight"), *doc.bullets(notes), doc.Figure(FOREST))
    )
    nothing = ["No vehicle has enough flights with a time, or none changes by more than chance would."]
    yield doc.Section("Changes", (*doc.bullets(report_changes(report) or nothing), doc.Figure(LINES)))
    if report.deviating.height:
        yield doc.Section("Flights that deviate", tuple(_deviating(report, links)))
    yield from doc.section("Vehicles that differ", doc.Bullets, _report_differences(report))
    yield from doc.section("Left out", doc.Bullets, _report_omitted(report))
    yield from doc.section("Taken out before changes were sought", doc.Bullets, report_covariates(report))


def vehicles_to_report(vehicles: pl.DataFrame) -> pl.DataFrame:
    """Vehicles by what is noticed of them: those that change or differ first."""
    noticed = pl.col("course").is_in([fleet.DRIFTS, fleet.STEPS]) | pl.col("differs")
    by_vehicle = vehicles.group_by("type", "vehicle", maintain_order=True).agg(noticed.any().alias("noticed"))
    return by_vehicle.sort("noticed", descending=True, maintain_order=True)


def linked(name: str, sha256: str, links: Mapping[str, str]) -> doc.Cell:
    """A flight's name, which leads to its report; one without says so where others have one."""
    link = links.get(sha256, "")
    return doc.Cell(name, "no report of its own" if links and not link else "", link=link)


def _deviating(
    report: fleet.FleetReport, links: Mapping[str, str] | None
) -> Iterator[doc.TableOf | doc.Bullets]:
    cells = []
    for row in report.deviating.head(MOST).iter_rows(named=True):
        wording = report.motion.quantities[row["quantity"]]
        name = linked(row["name"], row["sha256"], links or {})
        value = doc.Cell(*interval_text(row, wording, ("value", "low", "high")))
        expected = f"{row['expected'] * wording.scale:.4g}"
        cells.append((name, row["vehicle"], f"{wording.words} {doc.symbol_of(wording)}", value, expected))
    columns = (
        doc.TableColumn("flight", strong=True),
        "vehicle",
        "quantity",
        doc.TableColumn("value", right=True, whole=True, below=doc.Tone.FAINT),
        doc.TableColumn("the others", right=True, whole=True),
    )
    yield doc.table(columns, cells)
    if report.deviating.height > MOST:
        yield doc.Bullets((f"{report.deviating.height} flights and quantities deviate; the JSON has all.",))


def _members(report: fleet.FleetReport, rows: Sequence[Row], unit: str) -> doc.TableOf:
    """Table of types, or of vehicles; only the first row of each has its name."""
    key = ("type",) if unit == "vehicle" else fleet.VEHICLE
    columns: list[str | doc.TableColumn] = [
        doc.TableColumn(key[-1], strong=True),
        "quantity",
        doc.TableColumn("mean", right=True, whole=True, below=doc.Tone.FAINT),
        doc.TableColumn("between", right=True, whole=True, below=doc.Tone.FAINT),
        doc.TableColumn(f"next {unit}", right=True, whole=True),
        doc.TableColumn(f"{unit}s", right=True, below=doc.Tone.FAINT),
    ]
    if unit == "flight":
        columns.append(doc.TableColumn("course", whole=True))
    labelled: set[tuple[str, ...]] = set()
    cells = []
    for row in rows:
        across = _across_of_row(report, row)
        wording = report.motion.quantities[across.name]
        member = tuple(row[name] for name in key)
        omitted = f"{row['left_out']} left out" if row.get("left_out") else ""
        line = (
            "" if member in labelled else member[-1],
            f"{wording.words} {doc.symbol_of(wording)}",
            doc.Cell(*mean_text(row, wording)),
            doc.Cell(*between_text(row, across, wording)),
            next_text(row, wording),
            doc.Cell(f"{row['pooled']}", omitted),
        )
        cells.append((*line, row["course"]) if unit == "flight" else line)
        labelled.add(member)
    return doc.table(columns, cells)


def fleet_json(reports: Sequence[fleet.FleetReport]) -> dict[str, Json]:
    """Document of the reports of a fleet, one for each motion; numbers are in SI units."""
    return document("eivor.fleet_report/1", motions=[_motion_json(report) for report in reports])


def _motion_json(report: fleet.FleetReport) -> dict[str, Json]:
    return {
        "motion": report.motion.name,
        **report.logs,
        "quantities": [
            {
                "name": quantity.name,
                "unit": report.motion.quantities[quantity.name].unit,
                "logarithm": quantity.logarithm,
                "covariates": [covariate.name for covariate in quantity.covariates],
            }
            for quantity in report.quantities
        ],
        "types": _rows(report.types),
        "vehicles": _rows(report.vehicles),
        "deviating": _rows(report.deviating),
        "left_out": _rows(report.omitted),
        "covariates": _rows(report.covariates),
    }


def _rows(table: pl.DataFrame) -> list[Json]:
    return [
        {name: item.isoformat() if isinstance(item, datetime) else item for name, item in row.items()}
        for row in table.iter_rows(named=True)
    ]


#: Vehicles of a forest, and vehicles whose quantities are drawn over time, at most.
MOST_ROWS, MOST_LINES = 40, 8


def fleet_page(reports: Sequence[fleet.FleetReport], title: str, links: Mapping[str, str]) -> str:
    """HTML page of a fleet, without anything to fetch."""
    figures, motions = Figures(0), []
    for report in reports:
        pictures = {}
        if report.vehicles.height:
            pictures[FOREST] = figures.html([("", _forest_pictures(report))])
            pictures[LINES] = figures.html([("", _over_hours(report, links))])
        no_reports = "Flights have no reports of their own here; eivor fleet run --reports makes them."
        note = no_reports if report.vehicles.height and not links else ""
        motions.append((fleet_document(report, title, links), note, pictures))
    body = rendered("fleet.html", title=title, motions=motions)
    return whole_page(f"{title}: fleet", body, {"result": fleet_json(reports), "charts": figures.charts})


def _forest_pictures(report: fleet.FleetReport) -> Iterator[plots.Picture]:
    chosen = vehicles_to_report(report.vehicles).head(MOST_ROWS).select(fleet.VEHICLE)
    several = report.vehicles["type"].n_unique() > 1
    for across in report.quantities:
        same = pl.col("quantity") == across.name
        rows = report.vehicles.filter(same).join(chosen, on=fleet.VEHICLE, how="semi", maintain_order="left")
        wording = report.motion.quantities[across.name]
        types = report.types.filter(same).sort("type").head(MOST_ROWS)
        intervals = [
            *(_forest_row(row, wording, several=several) for row in rows.iter_rows(named=True)),
            *(_forest_row(row, wording) for row in types.iter_rows(named=True)),
        ]
        yield plots.forest_picture(capitalised(wording.words), doc.axis_of(wording), intervals)


def _forest_row(row: Row, wording: QuantitySpec, *, several: bool = False) -> plots.PlottedInterval:
    """A vehicle, with its type where there are several, or a type."""
    label = row.get("vehicle") or f"type {row['type']}"
    ends = fleet.ONLY if None in (row["low"], row["high"]) and "vehicle" in row else ("low", "high")
    value, low, high = _scaled(row, ("mean", *ends), wording.scale)
    pieces = () if math.isnan(low) or math.isnan(high) else ((low, high),)
    numbers = " ".join(dict.fromkeys(mean_text(row, wording)))
    label = f"{row['type']}: {label}" if several else label
    return plots.PlottedInterval(label, value, pieces, numbers, None, "vehicle" not in row)


def _over_hours(report: fleet.FleetReport, links: Mapping[str, str]) -> Iterator[plots.Picture]:
    chosen = vehicles_to_report(report.vehicles).head(MOST_LINES).select(fleet.VEHICLE)
    shares = (fleet.is_share(across).name.suffix(f".{across.name}") for across in report.quantities)
    rows = report.flights.with_columns(shares)
    for kind, vehicle in chosen.iter_rows():
        of_vehicle = (pl.col("type") == kind) & (pl.col("vehicle") == vehicle)
        flights, means = rows.filter(of_vehicle), report.vehicles.filter(of_vehicle)
        for across in report.quantities:
            row = next(means.filter(pl.col("quantity") == across.name).iter_rows(named=True), None)
            used = flights.with_columns(pl.col(f"{fleet.SHARE}.{across.name}").alias(fleet.SHARE))
            used = used.filter(fleet.omission_reason(across, used.columns).is_null())
            if row is not None and used.height > 1:
                yield _line(report, across, row, used, links)


def _line(
    report: fleet.FleetReport, across: AcrossFlights, row: Row, used: pl.DataFrame, links: Mapping[str, str]
) -> plots.Picture:
    wording = report.motion.quantities[across.name]
    hours = used["hours"].to_numpy()
    numbers = used.select(pl.col(f"{across.name}.value"), *fleet.flight_interval(across))
    value, low, high = (wording.scale * number.to_numpy() for number in numbers)
    flights = [linked(name, sha256, links) for name, sha256 in used.select("name", "sha256").iter_rows()]
    symbol = doc.symbol_of(wording)
    table = doc.number_table(
        ("flight hours", symbol, "low", "high", "flight"),
        zip(hours.tolist(), value.tolist(), low.tolist(), high.tolist(), flights, strict=True),
    )
    lines = tuple(_trend(row, across, (hours, low, high), wording.scale))

    def draw(axes: Any) -> None:
        axes.vlines(hours, low, high, color=plots.DARK, lw=1.2)
        axes.plot(hours, value, "o", color=plots.DARK, ms=3.5, label="flights, 95 %")
        for (label, *line), colour, style in zip(lines, (plots.RED, plots.BLUE), ("-", "--"), strict=False):
            axes.plot(*line, color=colour, lw=1.3, ls=style, label=label)
        plots.labelled(axes, x="flight hours", y=symbol, size=9.0)
        plots.legend(axes, size=7)

    return plots.Picture(f"{row['vehicle']}: {wording.words}", "", draw, table)


def _trend(
    row: Row, across: AcrossFlights, points: tuple[np.ndarray, np.ndarray, np.ndarray], scale: float
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    hours, low, high = points
    mean = row["mean"] * scale
    if row["course"] == fleet.STEPS and row["step_hours"] is not None:
        yield "step", np.full(2, row["step_hours"]), np.array([np.nanmin(low), np.nanmax(high)])
    elif row["course"] == fleet.DRIFTS and row["hours"]:
        share = (hours - hours.mean()) / row["hours"]
        change = np.log1p(row["change"]) * share if across.logarithm else row["change"] * scale * share
        yield "drift", hours, mean * np.exp(change) if across.logarithm else mean + change
        return
    yield "mean", np.array([hours.min(), hours.max()]), np.full(2, mean)


def flight_links(folder: Path, page: Path) -> Mapping[str, str]:
    """Address of the report of each log that has one, by the log's hash, relative to a page."""
    parent = page.resolve().parent
    if not is_local(folder):
        return {}  # a page on this machine has no relative address of another's
    return {
        sha256: quote(Path(os.path.relpath(report_path(folder.resolve(), sha256), parent)).as_posix())
        for sha256 in reports_there(folder)
    }
