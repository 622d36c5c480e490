"""The flight that would tell: ranked by a formula, the best few flown in simulation, the best one chosen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import InputError, UsageError
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.planning.flown import Flown, fly
from eivor.planning.limits import FlightLimits
from eivor.planning.ranking import ranked_std_errors
from eivor.planning.setpoints import STEP_S, Shape, candidates
from eivor.planning.targets import TARGETS, check_target
from eivor.planning.vehicle import VehicleGuess
from eivor.shapes import Float

KINDS = ("multisine", "steps")
#: So many shapes are flown in simulation, each so often; one flight of each is identified, all of the best.
FINALISTS, RUNS = 3, 3
#: Flights longer than this leave time for one run of each shape [s].
LONG_S = 150.0
#: How far a shape is made smaller when its flights leave the limits, and how often at most.
SMALLER, OFTEN = 0.85, 4


@dataclass(frozen=True, slots=True)
class Predicted:
    """Half-width of a 95 % interval that the flight is expected to give.

    Parameters
    ----------
    half_width : float
        Median over the simulated flights, in the target's unit.
    value : float
        Of the vehicle that was simulated, in that unit; for what is told as a share 100 %.
    verdicts : tuple of Status
        Of each simulated flight.
    """

    half_width: float
    value: float
    verdicts: tuple[Status, ...]

    @property
    def identified(self) -> int:
        """Number of simulated flights in which it was identified."""
        return sum(status is Status.IDENTIFIED for status in self.verdicts)


@dataclass(frozen=True)
class FlightPlan:
    """A flight, and what it is expected to tell.

    Parameters
    ----------
    vehicle : VehicleGuess
        What it was planned for.
    limits : FlightLimits
        What it keeps.
    target : str
        What it should tell, a word of `TARGETS`.
    shape : Shape
        The height setpoint about the middle of the limits.
    predicted : mapping of str to Predicted
        For each target.
    reached : tuple of float
        Lowest and highest height above take-off [m] and largest speed [m/s] of the simulated flights.
    """

    vehicle: VehicleGuess
    limits: FlightLimits
    target: str
    shape: Shape
    predicted: Mapping[str, Predicted]
    reached: tuple[float, float, float]

    @property
    def time_s(self) -> Float[np.ndarray, " n"]:
        """Time from the first setpoint [s]."""
        return STEP_S * np.arange(self.shape.offset.size)

    @property
    def height(self) -> Float[np.ndarray, " n"]:
        """Height setpoint above the place of take-off [m]."""
        return self.limits.middle_m + self.shape.offset

    @property
    def velocity(self) -> Float[np.ndarray, " n"]:
        """Its rate [m/s]."""
        return self.shape.derivatives[0]

    @property
    def acceleration(self) -> Float[np.ndarray, " n"]:
        """Its second derivative [m/s^2]."""
        return self.shape.derivatives[1]

    @property
    def telling(self) -> bool:
        """Whether the target was identified in most of the simulated flights."""
        found = self.predicted[self.target]
        return 2 * found.identified > len(found.verdicts)

    @property
    def sentence(self) -> str:
        """What is planned and expected, in a sentence."""
        asked, found = TARGETS[self.target], self.predicted[self.target]
        flights = len(found.verdicts)
        return (
            f"{self.limits.duration_s:g} s of {self.shape.words}: the {asked.words} within "
            f"± {found.half_width:.2g} {asked.unit}, identified in {found.identified} of {flights} simulated "
            f"flight{'' if flights == 1 else 's'}."
        )

    def summary(self) -> str:
        """Setpoint, expected half-widths and what the simulated flights reached, as plain text."""
        lines = [self.sentence]
        for word, found in self.predicted.items():
            asked = TARGETS[word]
            of = "" if asked.relative else f" (of {found.value:.3g})"
            lines.append(f"{asked.words:<18}± {found.half_width:.2g} {asked.unit}{of}")
        low, high, speed = self.reached
        lines.append(f"heights {low:.1f} to {high:.1f} m above take-off, up to {speed:.1f} m/s")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<FlightPlan for the {TARGETS[self.target].words}: {self.sentence}>"


def make_plan(
    vehicle: VehicleGuess,
    *,
    target: str = "",
    limits: FlightLimits | None = None,
    shape: str = "",
    seed: int = 0,
) -> FlightPlan:
    """Choose a flight for the smallest interval of what is asked.

    Parameters
    ----------
    vehicle : VehicleGuess
        From rough numbers, or from a result.
    target : str
        "friction", "gain" or "lag"; empty for what the vehicle's result could not tell, else friction.
    limits : FlightLimits, optional
        Default: those of `FlightLimits`.
    shape : str
        "multisine" or "steps"; empty for the better one.
    seed : int
        Of phases, step heights, wind and noise.

    Raises
    ------
    UsageError
        For words that do not exist, and arguments of other types.
    InputError
        When no flight within the limits can be flown.

    Notes
    -----
    Sixty shapes are ranked, three flown and identified. About seven seconds for flights of a minute.
    """
    checks.kind("vehicle", vehicle, VehicleGuess, "a VehicleGuess", "Give ev.VehicleGuess(hover_input=0.5).")
    limits = FlightLimits() if limits is None else limits
    checks.kind("limits", limits, FlightLimits, "FlightLimits", "Give ev.FlightLimits(), or nothing.")
    checks.text("target", target)
    checks.text("shape", shape)
    checks.whole("seed", seed)
    if seed < 0:
        raise UsageError("a seed of zero or more", f"{seed}", "Any such integer will do.")
    target = target or vehicle.asked or "friction"
    check_target(target)
    if shape not in ("", *KINDS):
        raise UsageError(f"one of {', '.join(KINDS)}", f"{shape!r}", "Or nothing, for the better one.")
    finalists = _finalists(vehicle, limits, target, (shape,) if shape else KINDS, seed)
    flown = _flown_within(finalists, vehicle, limits, seed)
    found = [(flights, flights[0].identified()) for flights in flown]
    best, first = min(found, key=lambda pair: _half_width(pair[1], target))
    kept = [(best[0], first), *((one, one.identified()) for one in best[1:])]
    return _plan(vehicle, limits, target, kept)


def _finalists(
    vehicle: VehicleGuess, limits: FlightLimits, target: str, kinds: tuple[str, ...], seed: int
) -> list[Shape]:
    """The best of each kind by the formula, which errs between kinds, then those that tell the lag too.

    What the recipe says of friction and gain is a union over delays: it suffers more from a lag that is
    hardly told than the formula knows.
    """
    shapes = list(candidates(limits, kinds, seed))
    errors = np.array([ranked_std_errors(one, vehicle) for one in shapes])
    words = list(TARGETS)
    asked, lag = errors[:, words.index(target)], errors[:, words.index("lag")]
    best = [shapes[index] for index in np.argsort(asked)]
    firsts = [next(one for one in best if one.kind == kind) for kind in kinds]
    others = [shapes[index] for index in np.argsort(asked * lag)]
    chosen = {id(one): one for one in (*firsts, *others)}
    return list(chosen.values())[:FINALISTS]


def _flown_within(
    shapes: list[Shape], vehicle: VehicleGuess, limits: FlightLimits, seed: int
) -> list[list[Flown]]:
    """Flights of each shape, which is made smaller until all of them keep the limits.

    Raises
    ------
    InputError
        When even small flights leave them.
    """
    runs = RUNS if limits.duration_s <= LONG_S else 1
    for _ in range(OFTEN):
        seeds = [seed + run for run in range(runs)]
        flights = fly([one for one in shapes for _ in seeds], vehicle, seeds * len(shapes))
        flown = [flights[first : first + runs] for first in range(0, len(flights), runs)]
        kept = [of_shape for of_shape in flown if all(one.keeps(limits) for one in of_shape)]
        if kept:
            return kept
        shapes = [one.scaled(SMALLER) for one in shapes]
    raise InputError(
        "a flight that keeps its limits",
        f"flights that leave {limits.height_m[0]:g} to {limits.height_m[1]:g} m or {limits.speed:g} m/s in "
        "the wind of the simulation",
        "Widen the limits, or wait for calmer air.",
    )


def _half_width(result: FlightEstimate, target: str) -> float:
    """Half-width in SI, or as a share; infinite without an estimate."""
    asked = TARGETS[target]
    quantity = result.quantities[asked.quantity]
    width = quantity.half_width / (abs(quantity.value) if asked.relative else 1.0)
    return width if math.isfinite(width) else math.inf


def _plan(
    vehicle: VehicleGuess, limits: FlightLimits, target: str, found: list[tuple[Flown, FlightEstimate]]
) -> FlightPlan:
    values = {"friction": vehicle.viscous_friction, "gain": 1.0, "lag": vehicle.lag_s}
    predicted = {
        word: Predicted(
            asked.scale * float(np.median([_half_width(result, word) for _, result in found])),
            asked.scale * values[word],
            tuple(result.quantities[asked.quantity].verdict for _, result in found),
        )
        for word, asked in TARGETS.items()
    }
    heights = np.concatenate([flown.height for flown, _ in found]) + limits.middle_m
    speed = max(float(np.abs(flown.velocity).max()) for flown, _ in found)
    reached = (float(heights.min()), float(heights.max()), speed)
    return FlightPlan(vehicle, limits, target, found[0][0].shape, predicted, reached)
