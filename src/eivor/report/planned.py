"""A plan of a result, at hand or saved, or of rough numbers: the public door, document and JSON."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from eivor import checks
from eivor.errors import UsageError
from eivor.flights.result import FlightEstimate
from eivor.planning.limits import FlightLimits
from eivor.planning.plan import FlightPlan, make_plan
from eivor.planning.targets import TARGETS
from eivor.planning.vehicle import VehicleGuess, vehicle_of_result
from eivor.report.document import Cell, Document, Fact, Facts, Section, TableColumn, TableOf
from eivor.report.json_document import Json, number
from eivor.report.read_fit import load_fit, saved_fit
from eivor.report.saved_fit import SavedFit

SCHEMA = "eivor.plan/1"


def plan(
    source: SavedFit | FlightEstimate | VehicleGuess | str | Path,
    *,
    target: str = "",
    limits: FlightLimits | None = None,
    shape: str = "",
    seed: int = 0,
) -> FlightPlan:
    """Plan the flight that would tell: after one that could not, or of rough numbers.

    Parameters
    ----------
    source : SavedFit, FlightEstimate, VehicleGuess, str or Path
        A result, refused ones included, the file of one, or rough numbers of a vehicle.
    target : str
        "friction", "gain" or "lag". Default: the first of friction, lag and gain that the result could not
        tell.
    limits : FlightLimits, optional
        Of height, speed, acceleration, tilt and time.
    shape : str
        "multisine" or "steps". Default: the one whose simulated flights tell more.
    seed : int
        Of phases, step heights, wind and noise.

    Returns
    -------
    FlightPlan
        Setpoints, and the half-widths that the recipe gave of simulated flights.

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
    return make_plan(_vehicle(source), target=target, limits=limits, shape=shape, seed=seed)


def _vehicle(source: SavedFit | FlightEstimate | VehicleGuess | str | Path) -> VehicleGuess:
    if isinstance(source, VehicleGuess):
        return source
    if isinstance(source, FlightEstimate):
        source = saved_fit(source)
    elif isinstance(source, str | Path):
        source = load_fit(source)
    if not isinstance(source, SavedFit):
        raise UsageError(
            "a result, the path of its JSON file, or a vehicle",
            checks.described(source),
            'Such as ev.plan("fit.json") or ev.plan(ev.VehicleGuess()).',
        )
    return vehicle_of_result(source.document)


def plan_document(made: FlightPlan) -> Document:
    """Document of a plan."""
    columns = (
        TableColumn("quantity"),
        TableColumn("taken as", right=True),
        TableColumn("half-width", right=True, strong=True),
        TableColumn("unit"),
        TableColumn("identified"),
    )
    rows = []
    for word, found in made.predicted.items():
        asked = TARGETS[word]
        taken = "" if asked.relative else f"{found.value:.3g}"
        told = f"in {found.identified} of {len(found.verdicts)}"
        rows.append(tuple(map(Cell, (asked.words, taken, f"± {found.half_width:.2g}", asked.unit, told))))
    return Document(
        f"Plan for the {TARGETS[made.target].words}",
        None,
        made.sentence,
        (Section("", (_facts(made), TableOf(columns, tuple(rows)))),),
    )


def _facts(made: FlightPlan) -> Facts:
    limits, (low, high, speed) = made.limits, made.reached
    gains = made.vehicle.follows
    return Facts(
        (
            Fact("setpoint", f"{made.shape.words}, about {limits.middle_m:g} m above take-off"),
            Fact(
                "limits",
                f"{limits.height_m[0]:g} to {limits.height_m[1]:g} m, {limits.speed:g} m/s, "
                f"{limits.acceleration:g} m/s², {limits.tilt_deg:g}° of tilt, {limits.duration_s:g} s",
            ),
            Fact("simulated", f"{low:.1f} to {high:.1f} m, up to {speed:.1f} m/s"),
            Fact(
                "controller",
                f"{gains.position_gain:.2g} 1/s on height, {gains.velocity_gain:.2g} 1/s on climb rate"
                + (
                    ", as the flight was flown"
                    if made.vehicle.controller is not None
                    else ", to suit the lag"
                ),
            ),
        )
    )


def plan_json(made: FlightPlan) -> dict[str, Json]:
    """Document of a plan of schema ``eivor.plan/1``, ready for `json_text`."""
    limits, (low, high, speed) = made.limits, made.reached
    return {
        "schema": SCHEMA,
        "target": made.target,
        "sentence": made.sentence,
        "shape": {"kind": made.shape.kind, "words": made.shape.words},
        "limits": {
            "height_m": list(limits.height_m),
            "speed": limits.speed,
            "acceleration": limits.acceleration,
            "tilt_deg": limits.tilt_deg,
            "duration_s": limits.duration_s,
        },
        "predicted": {
            word: {
                "half_width": number(found.half_width),
                "value": number(found.value),
                "unit": TARGETS[word].unit,
                "verdicts": [status.value for status in found.verdicts],
            }
            for word, found in made.predicted.items()
        },
        "simulated": {"lowest_m": number(low), "highest_m": number(high), "speed": number(speed)},
        "provenance": {"version": version("eivor")},
    }
