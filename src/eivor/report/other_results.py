"""Documents and figures of draws, tracks, plans and residuals."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from eivor import checks
from eivor.errors import InputError, UsageError
from eivor.estimation.recursive import HELD, LARGEST_SHARE
from eivor.flights.result import FlightEstimate
from eivor.flights.track import Track, relative_change
from eivor.planning.plan import SECONDS, FlightPlan, MachinePlan, make_plan, plan_machine
from eivor.planning.vehicle import FlightLimits, VehicleGuess, vehicle_of_result
from eivor.report import document as doc
from eivor.report.figure_panels import BLUE, RED, Figure, labelled, legend, page
from eivor.report.flight_figures import flight_runs, within_band
from eivor.report.html import rendered
from eivor.report.json_document import Json, document
from eivor.report.outputs import saved_of
from eivor.report.saved_fit import SavedFit
from eivor.signals.signals import stretches
from eivor.tools import printable

if TYPE_CHECKING:
    import polars as pl


SERIES = {"measured": "#3b82d6", "predicted": "#d9483b", "residual": "#7c8796"}  # On white and on black
PLOTTED = (("measured", "predicted"), ("residual",))
MCAP_MAGIC = b"\x89MCAP0\r\n"
PANEL_TITLES = ("foxglovePanelTitle", "lichtblickPanelTitle")


def residual_files(result: FlightEstimate) -> dict[str, str | bytes]:
    """Measured, predicted and residual of each axis within the band, and layouts that draw them."""
    import polars as pl

    if result.fit is None:
        raise InputError("a flight with an estimate, for its residuals", "one without", "See its verdict.")
    runs, frames = flight_runs(result), []
    is_pool = len({run.flight for run in runs}) > 1
    traces = result.fit.traces(result.motion)
    topics: dict[str, None] = {}
    for run in runs:
        columns = {"time": run.time_s}
        for trace in traces:
            words = f"{run.flight + 1}_{Path(run.name).stem}/{trace.axis}" if is_pool else trace.axis
            topic = re.sub(r"[^\w/]", "_", words, flags=re.ASCII)
            measured, predicted = within_band(trace, run).T
            topics[topic] = None
            series = zip(SERIES, (measured, predicted, measured - predicted), strict=True)
            columns |= {f"{topic}/{name}": values for name, values in series}
        frames.append(pl.DataFrame(columns))
    table = pl.concat(frames, how="diagonal").sort("time")
    areas = {topic: [_area(table, topic, names) for names in PLOTTED] for topic in topics}
    layout = rendered("plotjuggler.xml", areas=areas, series=SERIES)
    return {
        "residuals.csv": table.write_csv(file=None, float_scientific=False),  # 1e-5 is a word to PlotJuggler
        "plotjuggler.xml": layout,
        "residuals.mcap": _mcap(list(topics), table),
        "foxglove.json": _foxglove(list(topics)),
    }


def _area(table: pl.DataFrame, topic: str, names: Sequence[str]) -> dict[str, object]:
    values = table.select(f"{topic}/{name}" for name in names).drop_nulls().to_numpy()
    ends = (table["time"][0], table["time"][-1], values.min(), values.max())
    return {"names": names, "ends": dict(zip(("left", "right", "bottom", "top"), ends, strict=True))}


def _mcap(topics: Sequence[str], table: pl.DataFrame) -> bytes:
    """MCAP of JSON messages, a topic for each axis; time counts from the first row."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value.encode())) + value.encode()

    def record(kind: int, *parts: bytes) -> bytes:
        content = b"".join(parts)
        return struct.pack("<BQ", kind, len(content)) + content

    schema = json.dumps({"type": "object", "properties": {key: {"type": "number"} for key in SERIES}})
    records = [MCAP_MAGIC, record(1, text(""), text("eivor"))]
    records.append(record(3, struct.pack("<H", 1), text("eivor.Residual"), text("jsonschema"), text(schema)))
    for number, topic in enumerate(topics):
        ends = struct.pack("<HH", number, 1), struct.pack("<I", 0)
        records.append(record(4, ends[0], text(f"/{topic}"), text("json"), ends[1]))
    first_s = table["time"][0]
    for row in table.iter_rows(named=True):
        stamp = round(1e9 * (row["time"] - first_s))
        for number, topic in enumerate(topics):
            values = {name: row[f"{topic}/{name}"] for name in SERIES}
            if None not in values.values():
                head = struct.pack("<HIQQ", number, 0, stamp, stamp)
                records.append(record(5, head, json.dumps(values).encode()))
    return b"".join([*records, record(15, bytes(4)), record(2, bytes(20)), MCAP_MAGIC])


def _foxglove(topics: Sequence[str]) -> str:
    """Layout of Foxglove and Lichtblick, a tab for each axis; they load none without a playback speed."""
    panels: dict[str, Any] = {"Tab!axes": {"activeTabIdx": 0, "tabs": []}}
    style = {"enabled": True, "timestampMethod": "receiveTime"}
    for topic in topics:
        ids = [f"Plot!{topic}-{names[0]}" for names in PLOTTED]
        for panel, names in zip(ids, PLOTTED, strict=True):
            paths = [{"value": f"/{topic}.{name}", "color": SERIES[name], **style} for name in names]
            panels[panel] = dict.fromkeys(PANEL_TITLES, f"{topic}: {', '.join(names)}") | {
                "paths": paths,
                "xAxisVal": "timestamp",
                "isSynced": True,
                "showLegend": True,
            }
        split = {"direction": "column", "first": ids[0], "second": ids[1], "splitPercentage": 60}
        panels["Tab!axes"]["tabs"].append({"title": topic, "layout": split})
    others = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return json.dumps({"configById": panels, **others, "layout": "Tab!axes"}, indent=1)


#: Rows of a table of moments, at most.
ROWS = 16


def track_document(track: Track) -> doc.Document:
    """Document of a track."""
    (flight,) = track.result.prepared
    count = f"{len(track.precise_moments)} of {len(track.moments)} moments identify" if track.moments else ""
    known = track.known
    if track.nuisances:
        values = ", ".join(f"{name} {1e3 * value:.0f} ms" for name, value in track.nuisances.items())
        sentence = f"Followed at {values.replace('_', ' ')}, with a memory of {track.memory_s:g} s."
        known = (sentence, *known)
    sections = (
        *((doc.Section("", (_table(track),)),) if track.moments else ()),
        *doc.section("Changes", doc.Bullets, report_changes(track)),
        *doc.section("Not identified", doc.Bullets, untold(track)),
        *doc.section("Taken as known", doc.Bullets, known),
    )
    about = f"{_parameter_words(track)} over the log: {count or 'no moment identifies'} it"
    return doc.Document(flight.recording.name, about, sections)


def _parameter_words(track: Track) -> str:
    if not track.name:
        return "Nothing"
    wording = track.result.motion.quantities[track.name]
    return f"{wording.words} {wording.own_symbol}".rstrip()


def report_changes(track: Track) -> Iterator[str]:
    """Return a sentence about each change; one where there is none."""
    for change in track.changes:
        by = track.change_at(change)
        yield (
            f"Identified at {change.time_s:.1f} s, and up to {track.memory_s:g} s older than that: "
            f"the {_parameter_words(track)} {'rose' if change.change > 0 else 'fell'}"
            f"{'' if by is None else f' by {_share(abs(by[0]), by[1])}'}."
        )
    precise = track.precise_moments
    if precise and not track.changes:
        first, last = precise[0], precise[-1]
        total = _share(*relative_change(first, last), "+")
        span = f" From {first.time_s:.1f} to {last.time_s:.1f} s it changed by {total}."
        yield f"No sudden change.{span if len(precise) > 1 else ''}"


def _share(share: float, half: float, sign: str = "") -> str:
    return f"{100.0 * share:{sign}.1f} ± {100.0 * half:.1f} %"


def untold(track: Track) -> Iterator[str]:
    """Why the parameter is not identified, where it is not."""
    if not track.moments:
        yield from (f"{reason.sentence} {reason.remedy}" for reason in track.result.verdict.reasons)
        return
    for part in stretches(np.array([not moment.is_precise for moment in track.moments])):
        moments = track.moments[part]
        ends = f"{moments[0].time_s:.1f} to {moments[-1].time_s:.1f} s"
        empty = sum(item.share < HELD for item in moments)
        if 2 * empty >= len(moments):
            why = "hardly any sample of the memory before is of flight that can be used"
        else:
            why = f"the interval is wider than ±{100.0 * LARGEST_SHARE:.0f} %; --memory narrows it"
        yield f"{ends}: {why}."


def _table(track: Track) -> doc.TableOf:
    wording = track.result.motion.quantities[track.name]
    columns = (
        doc.TableColumn("time [s]", strong=True),
        doc.TableColumn(f"{wording.symbol} [{wording.shown_unit or wording.unit}]", right=True, whole=True),
        doc.TableColumn("95 % interval", whole=True),
        doc.TableColumn("of the first reported", right=True),
        doc.TableColumn("", below=doc.Tone.WARNING),
    )
    first = track.precise_moments[0].value if track.precise_moments else None
    rows, step = [], max(1, -(-len(track.moments) // ROWS))
    for number, moment in enumerate(track.moments, start=1):
        if not moment.change and number % step:
            continue
        value, interval = doc.NO_NUMBER, doc.NO_NUMBER
        if moment.is_precise:
            scaled = wording.scale * moment.value, wording.scale * moment.half_width
            value, interval = doc.plain_numbers(scaled[0], (scaled[0] - scaled[1], scaled[0] + scaled[1]))
        share = f"{100.0 * moment.value / first:.0f} %" if moment.is_precise and first else ""
        note = {1: "rose", -1: "fell", 0: ""}[moment.change]
        rows.append((f"{moment.time_s:.1f}", value, interval, share, note))
    return doc.table(columns, rows)


def track_json(track: Track) -> dict[str, Json]:
    """Document of a track; numbers are in SI units, and null where nothing is identified."""
    (flight,) = track.result.prepared
    return document(
        "eivor.track/1",
        log=flight.recording.name,
        parameter=track.name,
        unit=track.unit,
        memory_s=track.memory_s,
        at=track.nuisances,
        known=track.known,
        moments=[
            {
                "time_s": moment.time_s,
                "value": moment.value,
                "low": moment.value - moment.half_width,
                "high": moment.value + moment.half_width,
                "identified": moment.is_precise,
            }
            for moment in track.moments
        ],
        changes=[
            {"time_s": change.time_s, "upwards": change.change > 0, "share": share, "half_width": half}
            for change in track.changes
            for share, half in (track.change_at(change) or (None, None),)
        ],
        not_told=list(untold(track)),
        verdict_of_the_flight=track.result.verdict.status,
        findings=track.result.findings,
    )


def plan(
    source: SavedFit | FlightEstimate | VehicleGuess | str | Path,
    *,
    target: str = "",
    limits: FlightLimits | Mapping[str, tuple[float, ...]] | None = None,
    shape: str = "",
    seed: int = 0,
    seconds: float = 60.0,
) -> FlightPlan | MachinePlan:
    """Plan the flight that would identify: after one that could not, or of rough numbers.

    Parameters
    ----------
    source : SavedFit, FlightEstimate, VehicleGuess, str or Path
        A result, refused ones included, the file of one, or rough numbers of a vehicle.
    target : str
        "friction", "gain" or "lag". Default: the first of friction, lag and gain that the result could not
        determine. Of a machine one of its parameters. Default: the smallest joint uncertainty.
    limits : FlightLimits or mapping, optional
        Of height, speed, acceleration, tilt and time. Of a machine, for channels: largest distance from the
        mean of the log, and largest rate. Default: those of references and inputs in the log.
    shape : str
        "multisine" or "steps". Default: the one whose simulated flights carry more information.
    seed : int
        Of phases, step heights, wind and noise.
    seconds : float
        Length of what a machine does.

    Returns
    -------
    FlightPlan or MachinePlan
        Setpoints, and the half-widths that the recipe gave of simulated flights. Of a machine its
        references, and the half-widths of a formula.

    Raises
    ------
    UsageError
        For words that do not exist, arguments of other types, and a result of another motion.
    InputError
        When the file cannot be read, or no flight keeps the limits.

    Notes
    -----
    Simulated with the result's numbers, what it left over by frequency, and its controller; this takes
    seven seconds or so.
    """
    checks.number("seconds", seconds)
    if not SECONDS[0] <= seconds <= SECONDS[1]:
        raise UsageError(f"{SECONDS[0]:g} to {SECONDS[1]:g} s", f"{seconds:g} s", "Give another time.")
    if not isinstance(source, VehicleGuess):
        expected = "a result, the path of its JSON file, or a vehicle"
        remedy = 'Such as ev.plan("fit.json") or ev.plan(ev.VehicleGuess()).'
        fit = saved_of(source, expected, remedy, preferred=("vertical",))
        model, prediction = fit.document.model, fit.document.prediction
        record = {} if prediction is None else prediction.flight_record
        machine = fit.fitted.machine
        if machine is not None:
            channels = {} if limits is None else limits
            checks.mapping("limits", channels, tuple, "tuples of numbers")
            words = {"target": target, "shape": shape}
            return plan_machine(machine, fit.quantities, record, channels, seconds, seed, **words)  # type: ignore[arg-type]
        source = vehicle_of_result(model.name, model.input_map, fit.quantities, record)
    if isinstance(limits, Mapping):
        raise UsageError("FlightLimits of a flight", "limits of channels", "Give ev.FlightLimits().")
    return make_plan(source, target=target, limits=limits, shape=shape, seed=seed)


def plan_document(result: FlightPlan | MachinePlan) -> doc.Document:
    """Document of a plan."""
    if isinstance(result, FlightPlan):
        title, facts = f"Plan for the {result.predicted[result.target].words}", _plan_facts(result)
    else:
        limits = (
            f"{name} ± {' · '.join(f'{item:.3g}' for item in sizes)}" for name, sizes in result.limits.items()
        )
        title = f"Plan for {result.machine.name}"
        facts = doc.Facts((("references", ", ".join(result.references)), ("limits", "; ".join(limits))))
    rows = []
    for word, item in result.predicted.items():
        assumed = result.taken(word) if isinstance(result, FlightPlan) else f"{item.value:.3g}"
        share = (f"in {item.identified} of {len(item.verdicts)}",) if item.verdicts else ()
        rows.append((item.words, assumed, f"± {item.half_width:.2g}", item.unit, *share))
    number = partial(doc.TableColumn, right=True)
    columns = ("quantity", number("taken as"), number("half-width", strong=True), "unit", "identified")
    widths = doc.table(columns[: len(rows[0])], rows)
    return doc.Document(title, result.sentence, (doc.Section("", (facts, widths)),))


def _plan_facts(result: FlightPlan) -> doc.Facts:
    limits, (low, high, speed) = result.limits, result.reached
    gains = result.vehicle.follows
    why = ", to suit the lag" if result.vehicle.controller is None else ", as the flight was flown"
    return doc.Facts(
        (
            ("setpoint", f"{result.shape.words}, about {limits.middle_m:g} m above take-off"),
            (
                "limits",
                f"{limits.height_m[0]:g} to {limits.height_m[1]:g} m, {limits.speed:g} m/s, "
                f"{limits.acceleration:g} m/s², {limits.tilt_deg:g}° of tilt, {limits.duration_s:g} s",
            ),
            ("simulated", f"{low:.1f} to {high:.1f} m, up to {speed:.1f} m/s"),
            (
                "controller",
                f"{gains.position_gain:.2g} 1/s on height, {gains.velocity_gain:.2g} 1/s on climb rate{why}",
            ),
        )
    )


def plan_json(result: FlightPlan | MachinePlan) -> dict[str, Json]:
    """Document of a plan of schema ``eivor.plan/1``, ready for `json_text`."""
    shape = {"kind": result.shape.kind, "words": result.shape.words}
    head = {"target": result.target, "sentence": result.sentence, "shape": shape, "limits": result.limits}
    numbers = ("half_width", "value", "unit")
    names = (*numbers, "verdicts") if isinstance(result, FlightPlan) else ("words", *numbers)
    predicted = {key: {name: getattr(item, name) for name in names} for key, item in result.predicted.items()}
    if isinstance(result, MachinePlan):
        return document("eivor.plan/1", **head, predicted=predicted, references=list(result.references))
    low, high, speed = result.reached
    simulated = {"lowest_m": low, "highest_m": high, "speed": speed}
    return document("eivor.plan/1", **head, predicted=predicted, simulated=simulated)


TRACK_WIDTH, HEIGHT = 10.0, 4.5
LETTERS = 90


def track_figure(track: Track) -> Figure:
    """Value with its 95 % band over time; times at which nothing is identified are left out."""
    (flight,) = track.result.prepared
    if not track.precise_moments:
        figure = page(TRACK_WIDTH, HEIGHT, f"{printable(flight.recording.name)}: reported at no moment")
        words = fill("\n".join(map(printable, untold(track))), LETTERS)
        figure.text(0.5, 0.5, words, ha="center", parse_math=False)
        return figure
    wording = track.result.motion.quantities[track.name]
    time = np.array([moment.time_s for moment in track.moments])
    precise = np.array([moment.is_precise for moment in track.moments])
    numbers = wording.scale * np.array([(moment.value, moment.half_width) for moment in track.moments])
    value, half = np.where(precise, numbers.T, np.nan)
    figure = page(TRACK_WIDTH, HEIGHT, f"{printable(flight.recording.name)}: {wording.words} over the log")
    axes = figure.add_subplot()
    axes.fill_between(time, value - half, value + half, color=BLUE, alpha=0.2, lw=0, label="95 %")
    axes.plot(time, value, color=BLUE, lw=1.3, label=f"memory {track.memory_s:g} s")
    for index, change in enumerate(track.changes):
        axes.axvline(change.time_s, color=RED, lw=1.2, ls="--", label="" if index else "change reported")
    labelled(axes, x="time t [s]", y=f"{wording.symbol} [{wording.shown_unit or wording.unit or '-'}]")
    axes.margins(x=0.01)
    legend(axes)
    return figure
