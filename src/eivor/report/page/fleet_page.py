"""The page of a fleet: forests of its vehicles, and how quantities went over flight hours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import polars as pl

from eivor.fleets.course import DRIFTS, STEPS
from eivor.fleets.pool import ONLY
from eivor.fleets.pooled_rows import SHARE, VEHICLE, is_share, own_interval, why_left_out
from eivor.fleets.report import FleetReport
from eivor.flights.across import AcrossFlights
from eivor.report.document import Document, Section
from eivor.report.fleet_document import FOREST, LINES, fleet_document, linked, shown_vehicles
from eivor.report.json_fleet import fleet_json
from eivor.report.page.figures import Figures
from eivor.report.page.forest import Forest, ForestRow
from eivor.report.page.markup import Markup, element, joined
from eivor.report.page.number_tables import number_table
from eivor.report.page.parts import section_html
from eivor.report.page.picture import Picture, Pictures
from eivor.report.page.plot import Curve, Dots, Mark, Plot, Rule
from eivor.report.page.scale import margined
from eivor.report.page.shell import whole_page
from eivor.report.told_fleet import Row, mean_told

#: Vehicles of a forest, and vehicles whose quantities are drawn over time, at most.
MOST_ROWS, MOST_LINES = 40, 8
NO_REPORTS = "Flights have no reports of their own here; eivor fleet run --reports makes them."


def fleet_page(reports: Sequence[FleetReport], title: str, links: Mapping[str, str]) -> str:
    """Text of a page that tells a fleet: HTML without anything to fetch.

    Parameters
    ----------
    reports : sequence of FleetReport
        One for each motion.
    title : str
        The fleet's name.
    links : mapping of str to str
        Addresses of flights' own reports, by the hash of their logs.
    """
    figures = Figures(0)
    documents = [fleet_document(report, title, links) for report in reports]
    told = [
        _motion(report, document, figures, f"m{number}-", links)
        for number, (report, document) in enumerate(zip(reports, documents, strict=True))
    ]
    theme = element("button", {"type": "button", "id": "theme"}, "Dark")
    about = element("p", {"class": "about"}, "Eivor · Fleet")
    save = element("button", {"type": "button", "id": "save"}, "Save the numbers as JSON")
    body = joined(
        [
            element("header", None, element("div", None, about, element("h1", None, title)), theme),
            element("main", {"id": "main"}, *told, element("p", None, save)),
        ]
    )
    return whole_page(f"{title}: fleet", body, {"result": fleet_json(reports), "charts": figures.charts})


def _motion(
    report: FleetReport, document: Document, figures: Figures, name: str, links: Mapping[str, str]
) -> Markup:
    drawn = {}
    if report.vehicles.height:
        drawn[FOREST] = figures.html([Pictures("", tuple(_forests(report)))])
        drawn[LINES] = figures.html([Pictures("", tuple(_over_hours(report, links)))])
    sections = [section_html(one, f"{name}{_word(one)}", drawn) for one in document.sections]
    about = [element("p", {"class": "said"}, document.about)]
    if report.vehicles.height and not links:
        about.append(element("p", {"class": "note"}, NO_REPORTS))
    return joined([*about, *sections])


def _word(section: Section) -> str:
    return "-".join(section.heading.lower().split())


def _forests(report: FleetReport) -> Iterator[Picture]:
    """Vehicles side by side, and below them their type."""
    chosen = shown_vehicles(report.vehicles).head(MOST_ROWS).select(VEHICLE)
    several = report.vehicles["type"].n_unique() > 1
    for across in report.quantities:
        mine = pl.col("quantity") == across.name
        rows = report.vehicles.filter(mine).join(chosen, on=VEHICLE, how="semi", maintain_order="left")
        wording = report.motion.wording[across.name]
        drawn = [
            _forest_row(
                row, report, across, f"{row['type']}: {row['vehicle']}" if several else row["vehicle"]
            )
            for row in rows.iter_rows(named=True)
        ]
        drawn += [
            _forest_row(row, report, across, f"type {row['type']}", whole=True)
            for row in report.types.filter(mine).sort("type").head(MOST_ROWS).iter_rows(named=True)
        ]
        axis = f"{wording.words} {wording.symbol} [{wording.shown_unit or '-'}]"
        yield Picture(f"{wording.words[0].upper()}{wording.words[1:]}", "", Forest(axis, tuple(drawn)), None)


def _forest_row(
    row: Row, report: FleetReport, across: AcrossFlights, label: str, *, whole: bool = False
) -> ForestRow:
    wording = report.motion.wording[across.name]
    ends = [row[name] for name in ("low", "high")]
    ends = [row.get(name) for name in ONLY] if None in ends else ends
    pieces = () if None in ends else ((ends[0] * wording.scale, ends[1] * wording.scale),)
    numbers = " ".join(dict.fromkeys(mean_told(row, wording)))
    return ForestRow(label, numbers, row["mean"] * wording.scale, pieces, None, whole)


def _over_hours(report: FleetReport, links: Mapping[str, str]) -> Iterator[Picture]:
    """Flights of a few vehicles over their hours, those that change first."""
    chosen = shown_vehicles(report.vehicles).head(MOST_LINES).select(VEHICLE)
    rows = report.flights.with_columns(
        is_share(across).name.suffix(f".{across.name}") for across in report.quantities
    )
    for kind, vehicle in chosen.iter_rows():
        own = (pl.col("type") == kind) & (pl.col("vehicle") == vehicle)
        flights, means = rows.filter(own), report.vehicles.filter(own)
        for across in report.quantities:
            row = next(means.filter(pl.col("quantity") == across.name).iter_rows(named=True), None)
            used = flights.with_columns(pl.col(f"{SHARE}.{across.name}").alias(SHARE))
            used = used.filter(why_left_out(across, used.columns).is_null())
            if row is not None and used.height > 1:
                yield _line(report, across, row, used, links)


def _line(
    report: FleetReport, across: AcrossFlights, row: Row, used: pl.DataFrame, links: Mapping[str, str]
) -> Picture:
    wording = report.motion.wording[across.name]
    hours = used["hours"].to_numpy()
    numbers = used.select(pl.col(f"{across.name}.value"), *own_interval(across))
    value, low, high = (wording.scale * one.to_numpy() for one in numbers)
    flights = [linked(name, sha256, links) for name, sha256 in used.select("name", "sha256").iter_rows()]
    gap = np.full(hours.size, np.nan)
    bars = np.stack([low, high, gap], axis=1).ravel()
    marks: list[Mark] = [
        Curve("", "measured", np.repeat(hours, 3), bars),
        Dots("flights, 95 %", "measured", hours, value),
        *_course(row, across, hours, wording.scale),
    ]
    unit = f" [{wording.shown_unit}]" if wording.shown_unit else ""
    table = number_table(
        ("flight hours", f"{wording.symbol}{unit}", "low", "high", "flight"),
        zip(hours.tolist(), value.tolist(), low.tolist(), high.tolist(), flights, strict=True),
    )
    y = margined(f"{wording.symbol}{unit}", np.concatenate([low, high]))
    return Picture(
        f"{row['vehicle']}: {wording.words}",
        "",
        Plot(margined("flight hours", hours), y, tuple(marks)),
        table,
    )


def _course(row: Row, across: AcrossFlights, hours: np.ndarray, scale: float) -> Iterator[Mark]:
    """Mean, drift or step of a vehicle."""
    mean = row["mean"] * scale
    if row["course"] == STEPS and row["step_hours"] is not None:
        yield Rule("step", "second", row["step_hours"], True)
    elif row["course"] == DRIFTS and row["hours"]:
        share = (hours - hours.mean()) / row["hours"]
        change = np.log1p(row["change"]) * share if across.logarithm else row["change"] * scale * share
        line = mean * np.exp(change) if across.logarithm else mean + change
        yield Curve("drift", "predicted", hours, line)
        return
    yield Rule("mean", "predicted", mean, False)
