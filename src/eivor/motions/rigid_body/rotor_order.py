"""Which rotor a command acts as: places and spins by which the rotors explain how a flight turned.

Bin by bin of a band, with P_i the mapped command of rotor i behind a lag, and after the sum of all P, the
rate and the coupling of the axis are taken out of both sides,

    w_a' = g_a sum_i A_ai P_i,          A_ai the arm of rotor i about the axis a, or its spin,

for every order of the rotors of the vehicle file, with the spins going with the places, staying, or one of
them turned round. The order with the smallest sum over the axes of log(residual) is the one that the flight
shows. The sign of g_a is free in that comparison, because a loop that fights disturbances gives the wrong
one: an order that differs in signs alone is left to the signs of the gains.
"""

from __future__ import annotations

import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations, permutations

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.spectral import SpectralRun
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.shapes import Complex, Float
from eivor.signals.derivative import time_derivative
from eivor.signals.input_map import input_map

#: Band that is looked at [Hz], and lags [s].
BAND_HZ = (0.5, 8.0)
LAGS_S = np.geomspace(0.01, 0.16, 9)
#: All orders of up to so many rotors; of more, those with two of them exchanged.
MOST_ORDERED = 4
#: Another order must leave so much less, in logarithms of the residual summed over axes (that of simulated
#: flights never left more than .05 less than theirs), and explain this share of the axis that it improves.
CLEARLY = 0.3
EXPLAINED = 0.25
#: Of orders that differ by less the one with the fewest changes is told.
ALIKE = 0.05


@dataclass(frozen=True, slots=True)
class Order:
    """As which rotors of the vehicle file the commands act.

    Parameters
    ----------
    acts_as : tuple of int
        For each command the number of the rotor at whose place it acts, from 1; below zero where its spin is
        not that rotor's.
    axis : int
        Number of the axis that this explains so much better.
    explained, before : float
        Share of that axis that the rotors explain so, and by the vehicle file.
    """

    acts_as: tuple[int, ...]
    axis: int
    explained: float
    before: float

    @classmethod
    def of_numbers(cls, numbers: Mapping[str, float]) -> Order | None:
        """That of the numbers of a result; None where there is none in them."""
        acts_as = [int(value) for name, value in numbers.items() if name.endswith(_ACTS_AS)]
        if not acts_as:
            return None
        return cls(tuple(acts_as), int(numbers[_AXIS]), numbers[_EXPLAINED], numbers[_BEFORE])

    @property
    def numbers(self) -> dict[str, float]:
        """The same as numbers of a result."""
        rotors = {f"rotor_{rotor}{_ACTS_AS}": float(one) for rotor, one in enumerate(self.acts_as, start=1)}
        return {**rotors, _AXIS: float(self.axis), _EXPLAINED: self.explained, _BEFORE: self.before}

    @property
    def sentence(self) -> str:
        """What it says of the vehicle file."""
        return (
            f"{self._which}: so the rotors explain {self.explained:.0%} of {AXES[self.axis].name}, and "
            f"{self.before:.0%} by the vehicle file."
        )

    @property
    def _which(self) -> str:
        moved = [rotor for rotor, one in enumerate(self.acts_as, start=1) if abs(one) != rotor]
        turned = [abs(one) for one in self.acts_as if one < 0]
        if not moved:
            return f"{_rotors(turned)} the other way than the vehicle file says"
        if len(moved) == 2 and not turned:
            return f"Rotors {moved[0]} and {moved[1]} look exchanged"
        commands, places = (
            ", ".join(map(str, x)) for x in (range(1, len(self.acts_as) + 1), map(abs, self.acts_as))
        )
        order = f"The commands {commands} look to act as the rotors {places} of the vehicle file"
        return f"{order}, of which {_rotors(turned).lower()} the other way" if turned else order


#: Names of the numbers.
_ACTS_AS, _AXIS, _EXPLAINED, _BEFORE = "_acts_as", "order_axis", "order_explained", "order_explained_by_file"


def _rotors(numbers: Sequence[int]) -> str:
    *others, last = map(str, sorted(numbers))
    return f"Rotors {', '.join(others)} and {last} look to spin" if others else f"Rotor {last} looks to spin"


def order_shown(flights: Sequence[PreparedFlight], layout: RotorLayout) -> Order | None:
    """Order that flights show where it is clearly another than that of the vehicle file; else None.

    Parameters
    ----------
    flights : sequence of PreparedFlight
        Of one vehicle, with runs.
    layout : RotorLayout
        By the vehicle file.
    """
    sums = reduce(operator.add, (_Sums.of_flight(flight, layout.count) for flight in flights))
    given = _candidate(layout, tuple(range(layout.count)), np.asarray(layout.yaw))
    found = [given, *_others(layout)]
    left, gain = sums.left([one.arms for one in found])
    score = np.log(left).sum(axis=2)
    lag = int(np.argmin(score.min(axis=1)))
    score, left, gain = score[lag], left[lag], gain[lag]
    best = float(score.min())
    if score[0] - best < CLEARLY:
        return None
    alike = [number for number in range(len(found)) if score[number] < best + ALIKE]
    chosen = min(alike, key=lambda number: (int((gain[number] < 0.0).sum()), *found[number].changes))
    axis = int(np.argmax(left[0] - left[chosen]))
    explained, before = 1.0 - float(left[chosen, axis]), 1.0 - float(left[0, axis])
    return Order(found[chosen].acts_as, axis, explained, before) if explained > EXPLAINED else None


@dataclass(frozen=True)
class _Candidate:
    """Rows of arms about each axis of one order."""

    acts_as: tuple[int, ...]
    arms: Float[np.ndarray, "3 rotors"]

    @property
    def changes(self) -> tuple[int, int]:
        """How many spins and how many places are not as in the vehicle file."""
        places = sum(abs(number) != place for place, number in enumerate(self.acts_as, start=1))
        return sum(number < 0 for number in self.acts_as), places


def _candidate(
    layout: RotorLayout, order: tuple[int, ...], spins: Float[np.ndarray, " rotors"]
) -> _Candidate:
    at = list(order)
    own = spins * layout.yaw[at] > 0.0
    acts_as = tuple(place + 1 if same else -(place + 1) for place, same in zip(order, own, strict=True))
    return _Candidate(acts_as, np.stack([layout.roll[at], layout.pitch[at], spins]))


def _others(layout: RotorLayout) -> Iterator[_Candidate]:
    for order in _orders(layout.count):
        moving = layout.yaw[list(order)]
        one_turned = moving * (1.0 - 2.0 * np.eye(layout.count))
        for one in (moving, layout.yaw, *one_turned):
            yield _candidate(layout, order, one)


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    if count <= MOST_ORDERED:
        yield from permutations(range(count))
        return
    yield tuple(range(count))
    for one, other in combinations(range(count), 2):
        order = list(range(count))
        order[one], order[other] = other, one
        yield tuple(order)


@dataclass(frozen=True)
class _Sums:
    """Sums of products over the bins, for each lag and axis, what stays being taken out of both sides.

    Parameters
    ----------
    rotors : ndarray, shape (lags, 3, rotors, rotors)
        Of the rotors among each other.
    across : ndarray, shape (lags, 3, rotors)
        Of the rotors with the angular acceleration.
    turning : ndarray, shape (lags, 3)
        Of the angular acceleration with itself.
    """

    rotors: Float[np.ndarray, "lags 3 rotors rotors"]
    across: Float[np.ndarray, "lags 3 rotors"]
    turning: Float[np.ndarray, "lags 3"]

    def __add__(self, other: _Sums) -> _Sums:
        return _Sums(self.rotors + other.rotors, self.across + other.across, self.turning + other.turning)

    @classmethod
    def of_flight(cls, flight: PreparedFlight, count: int) -> _Sums:
        """Those of one flight."""
        parts = [_bins(flight, run) for run in flight.runs]
        bins = np.concatenate([part for part, _ in parts])
        frequency = np.concatenate([hz for _, hz in parts])
        shape = (LAGS_S.size, 3)
        rotors, across, turning = np.zeros((*shape, count, count)), np.zeros((*shape, count)), np.zeros(shape)
        for number, lag_s in enumerate(LAGS_S):
            lagged = bins[:, 9:] / (1.0 + 2j * np.pi * frequency * lag_s)[:, None]
            for axis in range(3):
                stays = np.column_stack([bins[:, 3 + axis], bins[:, 6 + axis], lagged.sum(axis=1)])
                moves = _without(stays, np.column_stack([lagged, bins[:, axis]]))
                products = np.real(moves.conj().T @ moves)
                rotors[number, axis] = products[:-1, :-1]
                across[number, axis], turning[number, axis] = products[:-1, -1], products[-1, -1]
        return cls(rotors, across, turning)

    def left(
        self, arms: Sequence[Float[np.ndarray, "3 rotors"]]
    ) -> tuple[Float[np.ndarray, "lags orders 3"], Float[np.ndarray, "lags orders 3"]]:
        """Share of each axis that each order leaves at each lag, and its gain."""
        rows = np.stack(arms)
        own = np.einsum("oai,laij,oaj->loa", rows, self.rotors, rows)
        with_turning = np.einsum("oai,lai->loa", rows, self.across)
        whole = self.turning[:, None, :]
        gain = with_turning / np.where(own > 0.0, own, np.inf)
        return np.maximum(1.0 - gain * with_turning / np.where(whole > 0.0, whole, np.inf), 1e-6), gain


def _bins(
    flight: PreparedFlight, run: slice
) -> tuple[Complex[np.ndarray, "bins columns"], Float[np.ndarray, " bins"]]:
    """Of a run angular accelerations, rates, couplings and mapped commands, and frequencies of bins [Hz]."""
    signals = flight.signals
    rates = np.column_stack([signals.channel(axis.rate) for axis in AXES])
    change = np.column_stack([time_derivative(rate, signals.step_s) for rate in rates.T])
    coupling = np.roll(rates, -1, axis=1) * np.roll(rates, -2, axis=1)
    mapped = input_map(flight.input_map)(signals.family(flight.input.name))
    band = SpectralRun(0, run.stop - run.start, signals.step_s, BAND_HZ, counted=flight.usable[run])
    return band.spectrum(np.column_stack([change, rates, coupling, mapped])[run]), band.frequency_hz


def _without(
    stays: Complex[np.ndarray, "bins s"], moves: Complex[np.ndarray, "bins m"]
) -> Complex[np.ndarray, "bins m"]:
    """Columns without what real multiples of others explain of them."""
    split = np.concatenate([stays.real, stays.imag])
    told, *_ = np.linalg.lstsq(split, np.concatenate([moves.real, moves.imag]), rcond=1e-10)
    return moves - stays @ told
