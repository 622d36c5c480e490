"""Planned flights against flights: `python -m validation.plan.study --size small` (or full).

Each vehicle flies a first flight that tells too little, along small steps about a hover. A plan is made after
its result, for friction and for lag in turn, and flown with another controller, in other gusts and with other
noise. The flight's half-widths are held against those that the plan printed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from eivor.inference.verdict import Status
from eivor.motions.identify import identify_flight
from eivor.planning.limits import FlightLimits
from eivor.planning.plan import FlightPlan
from eivor.planning.targets import TARGETS
from eivor.report.planned import plan
from eivor.simulation.flights.trajectories import Trajectory, TrajectoryKind, altitude_reference
from validation.plan.flights import OTHER_CONTROLLER, OWN, ROTORPY, STEP_S, Flyer

#: Flights of each plan, and seeds of first flights, by size; the small size has the own vehicles only.
SIZES = {"small": (2, (1,)), "full": (3, (1,))}
PLANNED_FOR = ("friction", "lag")
FIRST_S = 40.0
LIMITS = FlightLimits()


@dataclass(frozen=True)
class Outcome:
    """One planned flight.

    Parameters
    ----------
    vehicle, target : str
        Who flew, and what for.
    shape : str
        Kind of the setpoint.
    predicted, reached : float
        Half-width of the target in its unit: as the plan printed it, and as the flight has it.
    identified : bool
        The target is.
    kept : bool
        The vehicle stayed within the limits.
    """

    vehicle: str
    target: str
    shape: str
    predicted: float
    reached: float
    identified: bool
    kept: bool

    @property
    def ratio(self) -> float:
        """Reached over predicted."""
        return self.reached / self.predicted


def outcomes(vehicle: Flyer, flights: int, seed: int) -> Iterator[Outcome]:
    """Plans after one first flight, each flown so often."""
    rng = np.random.default_rng(seed)
    first = altitude_reference(
        TrajectoryKind.HOVER_STEPS, count=round(FIRST_S / STEP_S), step_s=STEP_S, rng=rng
    )
    told = identify_flight(vehicle.fly(first, 1000 + seed, gains=1.0).recording)
    for target in PLANNED_FOR:
        made = plan(told, target=target, limits=LIMITS, seed=seed)
        for number in range(flights):
            yield flown_outcome(vehicle, made, 2000 + 100 * seed + number)


def flown_outcome(vehicle: Flyer, made: FlightPlan, seed: int) -> Outcome:
    """The plan, flown once with the other controller."""
    reference = Trajectory(made.shape.offset, made.velocity, made.acceleration)
    flown = vehicle.fly(reference, seed, gains=OTHER_CONTROLLER)
    result = identify_flight(flown.recording)
    asked = TARGETS[made.target]
    quantity = result.quantities[asked.quantity]
    width = quantity.half_width / (abs(quantity.value) if asked.relative else 1.0)
    half_height = 0.5 * (made.limits.height_m[1] - made.limits.height_m[0])
    kept = np.abs(flown.height).max() <= half_height and np.abs(flown.velocity).max() <= made.limits.speed
    return Outcome(
        vehicle.name,
        made.target,
        made.shape.kind,
        made.predicted[made.target].half_width,
        asked.scale * width,
        quantity.verdict is Status.IDENTIFIED,
        bool(kept),
    )


def table(found: Sequence[Outcome]) -> str:
    """Markdown: for each vehicle and target medians of both half-widths, their ratio, and shares."""
    rows = ["| vehicle | planned for | flights | predicted | reached | ratio | identified | within limits |"]
    rows.append("|---|---|---|---|---|---|---|---|")
    for vehicle, target in dict.fromkeys((one.vehicle, one.target) for one in found):
        own = [one for one in found if (one.vehicle, one.target) == (vehicle, target)]
        rows.append(_row(vehicle, target, own))
    rows += [
        _row("**all**", target, [one for one in found if one.target == target]) for target in PLANNED_FOR
    ]
    return "\n".join(rows) + "\n"


def _row(vehicle: str, target: str, own: Sequence[Outcome]) -> str:
    unit = TARGETS[target].unit
    predicted, reached, ratio = (
        float(np.median([getattr(one, name) for one in own])) for name in ("predicted", "reached", "ratio")
    )
    cells = (
        vehicle,
        TARGETS[target].words,
        str(len(own)),
        f"{predicted:.2g} {unit}",
        f"{reached:.2g} {unit}",
        f"{ratio:.2f}",
        f"{sum(one.identified for one in own)} of {len(own)}",
        f"{sum(one.kept for one in own)} of {len(own)}",
    )
    return f"| {' | '.join(cells)} |"


def main() -> int:
    """Run the study, print its table, and keep its flights."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--size", choices=tuple(SIZES), default="small")
    arguments.add_argument("--json", type=Path, help="keep every flight here")
    given = arguments.parse_args()
    flights, seeds = SIZES[given.size]
    vehicles: tuple[Flyer, ...] = OWN if given.size == "small" else (*OWN, *ROTORPY)
    found: list[Outcome] = []
    for seed in seeds:
        for vehicle in vehicles:
            for one in outcomes(vehicle, flights, seed):
                found.append(one)
                print(f"{one.vehicle}, {one.target}: {one.ratio:.2f}", file=sys.stderr, flush=True)
                if given.json:
                    given.json.write_text(json.dumps([asdict(each) for each in found], indent=1) + "\n")
    print(table(found), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
