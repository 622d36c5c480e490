"""What is told of a fleet, in words and numbers as they are shown: once for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from eivor.fleets.course import DRIFTS, STEPS
from eivor.fleets.pool import ONLY
from eivor.fleets.pooled_rows import SINGLE
from eivor.fleets.report import FleetReport
from eivor.flights.across import AcrossFlights
from eivor.flights.quantity import Wording
from eivor.inference.random_effects.confidence_distribution import FEW
from eivor.report.wording import NO_NUMBER, plain_numbers

Row = Mapping[str, Any]
#: Sentences of one kind, at most.
MOST = 20
#: Of an interval that reaches so many times the value, digits that half its length tells would leave a zero.
FAR = 20.0


def wording_of(report: FleetReport, across: AcrossFlights) -> Wording:
    """How a quantity is called."""
    return report.motion.wording[across.name]


def interval_told(row: Row, wording: Wording, names: tuple[str, str, str]) -> tuple[str, str]:
    """Value and interval of a row as they are shown."""
    value, low, high = (row[name] for name in names)
    if value is None:
        return NO_NUMBER, NO_NUMBER
    value *= wording.scale
    low, high = (float("nan") if end is None else end * wording.scale for end in (low, high))
    if 0.0 < FAR * value < high:
        return _two_digits(value), f"[{_two_digits(low)}, {_two_digits(high)}]"
    return plain_numbers(value, (low, high))


def mean_told(row: Row, wording: Wording) -> tuple[str, str]:
    """Mean and interval of a vehicle or type; of a single flight its own, with a mark."""
    if not _is_of_one_flight(row):
        return interval_told(row, wording, ("mean", "low", "high"))
    value, interval = interval_told(row, wording, ("mean", *ONLY))
    return value, f"{interval} †"


def _is_of_one_flight(row: Row) -> bool:
    return all(row.get(name) is not None for name in ONLY)


def only_told(rows: Sequence[Row]) -> Iterator[str]:
    """Return what the mark of `mean_told` means, where there is one."""
    if any(map(_is_of_one_flight, rows)):
        yield "† of its only flight: how much flights differ is not in it."


def singles_told(report: FleetReport) -> Iterator[str]:
    """Return what is done with logs that have no vehicle, where there are any."""
    if report.flights[SINGLE].any():
        yield (
            "A log without a vehicle id stands alone under its own name, and counts for no type. "
            "eivor fleet run --vehicle-from says which vehicle each log is of."
        )


def _two_digits(number: float) -> str:
    return f"{float(f'{number:.2g}'):g}"


def between_told(row: Row, across: AcrossFlights, wording: Wording) -> tuple[str, str]:
    """Standard deviation between members, and its interval: a share where logarithms are compared."""
    numbers = [row[name] for name in ("between", "between_low", "between_high")]
    if any(one is None for one in numbers):
        return NO_NUMBER, ""
    if across.logarithm:
        value, low, high = (100.0 * one for one in numbers)
        return f"{value:.1f} %", f"[{low:.1f}, {high:.1f}]"
    value, low, high = (wording.scale * one for one in numbers)
    return plain_numbers(value, (low, high))


def next_told(row: Row, wording: Wording) -> str:
    """Interval of the next member, with a mark where there are few; none where it has no end."""
    if not _next_is_bounded(row):
        return NO_NUMBER
    ends = (row["next_low"] * wording.scale, row["next_high"] * wording.scale)
    _, interval = plain_numbers(row["mean"] * wording.scale, ends)
    return f"{interval} *" if row["pooled"] < FEW else interval


def _next_is_bounded(row: Row) -> bool:
    return row["next_low"] is not None and row["next_high"] is not None


def few_told(rows: Sequence[Row], members: str) -> Iterator[str]:
    """Return what the mark of `next_told` means, where there is one."""
    if any(_next_is_bounded(row) and row["pooled"] < FEW for row in rows):
        yield f"* of fewer than {FEW} {members}: take it with care."


def changes_told(report: FleetReport) -> list[str]:
    """Return a sentence about each vehicle that changes, the clearest first."""
    if not report.vehicles.height:
        return []
    changing = report.vehicles.filter(report.vehicles["course"].is_in([DRIFTS, STEPS]))
    rows = sorted(changing.iter_rows(named=True), key=lambda row: min(row["change_p"], row["step_p"]))
    return _at_most([_change(report, row) for row in rows], "vehicles and quantities change")


def _change(report: FleetReport, row: Row) -> str:
    across = next(one for one in report.quantities if one.name == row["quantity"])
    words = report.motion.wording[across.name].words
    who = f"{row['vehicle']}: the {words}"
    if row["course"] == DRIFTS:
        told = _effect(report, across, row, "change")
        return f"{who} drifts by {told} over {row['hours']:.3g} flight hours."
    when = f" ({row['step_start']:%Y-%m-%d})" if row["step_start"] is not None else ""
    first, last = int(row["step_flight_first"]), int(row["step_flight_last"])
    place = f"flight {first}" if first == last else f"flights {first} to {last}"
    return (
        f"{who} steps by {_effect(report, across, row, 'step')} at flight {int(row['step_flight'])}{when}, "
        f"after {row['step_hours']:.3g} flight hours; the flights leave {place} open."
    )


def _effect(report: FleetReport, across: AcrossFlights, row: Row, name: str) -> str:
    wording = report.motion.wording[across.name]
    numbers = [row[key] for key in (name, f"{name}_low", f"{name}_high")]
    scale, unit = (100.0, " %") if across.logarithm else (wording.scale, f" {wording.shown_unit}".rstrip())
    value, low, high = (scale * (float("nan") if one is None else one) for one in numbers)
    shown, interval = plain_numbers(value, (low, high))
    return f"{shown}{unit} {interval}"


def differences_told(report: FleetReport) -> list[str]:
    """Return a sentence about each vehicle that differs from its type."""
    if not report.vehicles.height:
        return []
    rows = report.vehicles.filter(report.vehicles["differs"]).sort("differs_p").iter_rows(named=True)
    told = []
    for row in rows:
        wording = report.motion.wording[row["quantity"]]
        value, interval = interval_told(row, wording, ("mean", "low", "high"))
        unit = f" {wording.shown_unit}" if wording.shown_unit else ""
        told.append(
            f"{row['vehicle']}: its {wording.words}, {value}{unit} {interval}, is not that of the other "
            f"vehicles of type {row['type']}."
        )
    return _at_most(told, "vehicles differ")


def left_out_told(report: FleetReport) -> list[str]:
    """Return what was left out, and why."""
    told = []
    for row in report.left_out.iter_rows(named=True):
        words = report.motion.wording[row["quantity"]].words
        flights = "1 flight" if row["flights"] == 1 else f"{row['flights']} flights"
        told.append(f"{words}: {flights}; {row['reason']}.")
    return told


def covariates_told(report: FleetReport) -> list[str]:
    """Return which slopes the flights told, which were taken as expected, and what is not known."""
    told = []
    taken = report.covariates.iter_rows(named=True) if report.covariates.height else ()
    for row in taken:
        words = report.motion.wording[row["quantity"]].words
        power = f"{row['slope']:.2f} ± {1.96 * row['std_error']:.2f}"
        told.append(f"{words} goes with {row['covariate'].replace('_', ' ')} (type {row['type']}: {power}).")
    used = (
        set(zip(report.covariates["quantity"], report.covariates["covariate"], strict=True))
        if told
        else set()
    )
    missing: dict[str, list[str]] = {}
    expected: dict[str, list[str]] = {}
    for across in report.quantities:
        for one in across.covariates:
            if (across.name, one.name) not in used:
                place = expected if (across.name, one.name) in report.expected else missing
                place.setdefault(one.name, []).append(report.motion.wording[across.name].words)
    shown = _at_most(told, "slopes were estimated")
    shown += [
        f"The flights do not tell how {_listed(words)} goes with {name.replace('_', ' ')}: what was expected "
        "beforehand is allowed for, with its uncertainty."
        for name, words in expected.items()
    ]
    shown += [
        f"{name.replace('_', ' ')} is not known of enough flights: what looks like a change of "
        f"{_listed(words)} may be it."
        for name, words in missing.items()
    ]
    return shown


def _listed(words: list[str]) -> str:
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last


def _at_most(told: list[str], what: str) -> list[str]:
    return told if len(told) <= MOST else [*told[:MOST], f"{len(told)} {what}; the JSON has all."]
