"""Position, velocity, attitude and rates some tenths of a second ahead, of the rotors alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.flights.ahead import UNCHANGED, Ahead, AheadError, Starts, all_ahead, starts_of
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.predicted import SimpleModel
from eivor.flights.prepared import PreparedFlight
from eivor.models.separable import Values
from eivor.motions.rigid_body.beside import ALL_DRAG_MOMENTS
from eivor.motions.rigid_body.carried import CarriedBody
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.motions.rigid_body.logged_state import LoggedState
from eivor.motions.rigid_body.one_spin import with_spin_moments
from eivor.motions.rigid_body.parameters import (
    COUPLING,
    DAMPING,
    DRAG,
    GAIN,
    LIFT,
    LIFT_MOMENT,
    OFFSET,
    QUADRATIC_DRAG,
    SPIN_MOMENT,
    THRUST,
    TURNING,
)
from eivor.shapes import Float

#: What it is that everything stays as it is.
STAYS = "stays as it is"
#: Terms without which a prediction is a little worse; one that the fit refuses counts as zero.
SMALL = (
    *COUPLING,
    *DAMPING,
    *DRAG,
    *QUADRATIC_DRAG,
    LIFT,
    *LIFT_MOMENT,
    *OFFSET,
    *SPIN_MOMENT,
    *ALL_DRAG_MOMENTS,
)
#: Drag by whose verdict the quadratic one of its axis goes: the two are told well together or not at all.
WITH_DRAG = {one.name: drag.name for one, drag in zip(QUADRATIC_DRAG, DRAG, strict=True)}


@dataclass(frozen=True)
class Predictable:
    """What of a body's state can be predicted.

    Parameters
    ----------
    known, told : frozenset of str
        Quantities of the fit, and those that are not refused.
    logged : tuple of LoggedState
        Of every flight.
    """

    known: frozenset[str]
    told: frozenset[str]
    logged: tuple[LoggedState, ...]

    @property
    def turns(self) -> tuple[bool, ...]:
        """Axes whose gain is told."""
        return tuple(one.name in self.told for one in GAIN)

    @property
    def lifts(self) -> bool:
        """Whether the thrust gain is told."""
        return THRUST.name in self.told

    @cached_property
    def left_out(self) -> dict[str, str]:
        """Why each quantity that cannot be predicted is left out."""
        if EFFECTIVE_LAG not in self.told:
            return dict.fromkeys((*_RATES, *_BEYOND), "the fit does not tell the lag")
        found = {
            rate: f"the fit does not tell the {axis} gain"
            for rate, axis, told in zip(_RATES, TURNING, self.turns, strict=True)
            if not told
        }
        moves = all(one.moves for one in self.logged), "velocity or attitude is not logged"
        needs: dict[str, tuple[tuple[bool, str], ...]] = {
            "attitude": ((all(one.turns for one in self.logged), "no attitude is logged"),),
            "velocity": (moves,),
            "position": (moves, (bool(self.placed), "no position is logged")),
        }
        for quantity in _BEYOND:
            why = [words for known, words in needs[quantity] if not known]
            # where only yaw stays, the force still points very nearly where it does
            rates = _RATES if quantity == "attitude" else _RATES[:2]
            why += [found[rate] for rate in rates if rate in found]
            if quantity != "attitude" and not self.lifts:
                why.append("the fit does not tell the thrust gain")
            if why:
                found[quantity] = why[0]
        return found

    @cached_property
    def placed(self) -> tuple[int, ...]:
        """Axes along which every flight has a position."""
        return tuple(axis for axis in range(3) if all(axis in one.placed for one in self.logged))

    def sentences(self, refused: frozenset[str]) -> tuple[str, ...]:
        """What is left out, and what counts as zero."""
        by_reason: dict[str, list[str]] = {}
        for quantity, why in self.left_out.items():
            by_reason.setdefault(why, []).append(quantity)
        said = [f"Not predicted: {', '.join(names)}, since {why}." for why, names in by_reason.items()]
        zero = [name.replace("_", " ") for name in zeros(refused) if name in self.known]
        if zero and len(self.left_out) < len(_RATES) + len(_BEYOND):
            said.append(f"Counted as zero, since the fit does not tell it: {', '.join(zero)}.")
        return tuple(said)


def zeros(refused: frozenset[str]) -> list[str]:
    """Small terms that count as zero."""
    return [one.name for one in SMALL if WITH_DRAG.get(one.name, one.name) in refused]


_RATES = tuple(f"{axis} rate" for axis in TURNING)
_BEYOND = ("attitude", "velocity", "position")


def rigid_body_ahead(
    flights: tuple[PreparedFlight, ...],
    layout: RotorLayout,
    models: Mapping[str, SimpleModel],
    refused: frozenset[str],
) -> Ahead:
    """The state after each horizon, by each model and by rates and velocity at the start.

    Parameters
    ----------
    flights : tuple of PreparedFlight
        With runs.
    layout : RotorLayout
        Of their rotors.
    models : mapping of str to SimpleModel
        The fit first.
    refused : frozenset of str
        Quantities of the fit that are not told. What rests on a gain among them is left out; couplings,
        damping, drag and lift among them count as zero in the fit.
    """
    first, *_ = models
    models = with_spin_moments(models, first)
    own = models[first].values
    told = frozenset({*own, EFFECTIVE_LAG}) - refused
    logged = tuple(LoggedState(flight) for flight in flights)
    what = Predictable(frozenset(own), told, logged)
    kept = {name: value for name, value in own.items() if name not in zeros(refused)}
    by_model = {**models, first: SimpleModel(models[first].words, kept)}
    found, times = [], []
    for one in logged:
        starts = starts_of(one.flight)
        found.append(_of_flight(one, starts, layout, by_model, what))
        times.append(one.flight.grid.time_s[starts.samples])
    return all_ahead(found, times, what.sentences(refused))


def _of_flight(
    logged: LoggedState,
    starts: Starts,
    layout: RotorLayout,
    models: Mapping[str, SimpleModel],
    what: Predictable,
) -> tuple[AheadError, ...]:
    if len(what.left_out) == len(_RATES) + len(_BEYOND) or not starts.samples.size:
        return ()
    begun = logged.body[:, starts.samples]
    states = {
        name: (model.words, starts.carried(begun, _body(logged, layout, model.values, starts, what)))
        for name, model in models.items()
    }
    states[UNCHANGED] = (STAYS, _unchanged(begun, starts))
    measured = logged.body[:, starts.ends].transpose(1, 0, 2)
    return tuple(
        _error(name, words, quantity, predicted, measured, what.placed)
        for quantity in (*_RATES, *_BEYOND)
        if quantity not in what.left_out
        for name, (words, predicted) in states.items()
    )


def _body(
    logged: LoggedState, layout: RotorLayout, values: Values, starts: Starts, what: Predictable
) -> CarriedBody:
    return CarriedBody(logged.flight, layout, values, logged, starts, what.turns, what.lifts)


def _unchanged(
    begun: Float[np.ndarray, "13 starts"], starts: Starts
) -> Float[np.ndarray, "horizons 13 starts"]:
    """States of a body whose velocity and rates are those at the start."""
    found = np.repeat(begun[None], len(starts.steps), axis=0)
    w, x, y, z = begun[6:10]
    speed = np.sqrt((begun[10:13] ** 2).sum(axis=0))
    axis = begun[10:13] / np.where(speed > 0.0, speed, 1.0)
    for number, step in enumerate(starts.steps):
        ahead_s = step * starts.step_s
        found[number, :3] += ahead_s * begun[3:6]
        c, (a, b, d) = np.cos(0.5 * speed * ahead_s), axis * np.sin(0.5 * speed * ahead_s)
        found[number, 6:10] = (
            w * c - x * a - y * b - z * d,
            x * c + w * a + y * d - z * b,
            y * c + w * b + z * a - x * d,
            z * c + w * d + x * b - y * a,
        )
    return found


def _error(
    model: str,
    words: str,
    quantity: str,
    predicted: Float[np.ndarray, "horizons 13 starts"],
    measured: Float[np.ndarray, "horizons 13 starts"],
    placed: tuple[int, ...],
) -> AheadError:
    """What is left of one quantity: of position along the axes on which it is logged."""
    series = None
    if quantity in _RATES:
        part, unit = 10 + _RATES.index(quantity), "rad/s"
        left = np.abs(predicted[:, part] - measured[:, part])
        series = np.column_stack([measured[-1, part], predicted[-1, part]])
    elif quantity == "attitude":
        unit = "rad"
        left = _angle(predicted[:, 6:10], measured[:, 6:10])
    else:
        parts = (3, 4, 5) if quantity == "velocity" else placed
        unit = "m/s" if quantity == "velocity" else "m"
        difference = predicted[:, parts] - measured[:, parts]
        left = np.sqrt((difference**2).sum(axis=1))
        if placed == (2,) and quantity == "position":
            quantity = "height"
    return AheadError(model, words, quantity, unit, left.T, series)


def _angle(
    first: Float[np.ndarray, "horizons 4 starts"], second: Float[np.ndarray, "horizons 4 starts"]
) -> Float[np.ndarray, "horizons starts"]:
    """Angle of the turn from one attitude to another; the first of any length."""
    first = first / np.sqrt((first**2).sum(axis=1, keepdims=True))
    apart, beside = (np.sqrt((one**2).sum(axis=1)) for one in (first - second, first + second))
    between = np.minimum(apart, beside)  # an attitude and its negative are one
    angle: Float[np.ndarray, "horizons starts"] = 4.0 * np.arcsin(np.minimum(0.5 * between, 1.0))
    return angle
