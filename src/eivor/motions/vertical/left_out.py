"""Terms that the model leaves out, each with a test that it is missed.

To the equation at its estimate, linear in the lag, one column is added with an instrument of its own, and its
coefficient is estimated like the flight itself: whitened, with the flight's instruments. That is the score
test of the term (Engle 1984), whose numerator is the residual's product with the column. The terms:

* quadratic drag, -v |v|: what the friction lacks at speed;
* ground effect, 1 / z^2 over the ground, or over a place below the flight where the log does not tell it;
* the thrust curve's bend, U_m (U / U_m - 1)^2 with the flight's mean U_m: what the input map lacks of it;
* the supply, U times what the battery's voltage differs from its mean by, as a share; unless all logs have
  a voltage U times the time, from -1/2 at the beginning to 1/2 at the end: a battery that sags.

Instruments are the same functions of velocity, height and input as far as the references explain them, as
voltage and time answer nothing of a second's length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import EstimationError, InstrumentError, TooFewSamplesError
from eivor.estimation.estimate import Estimate
from eivor.flights.agreement import Difference, estimated
from eivor.flights.prepared import PreparedFlight
from eivor.models.equation import Parameter
from eivor.models.lagged_runs import AxisColumns, LaggedRuns, nothing_moves
from eivor.models.separable import Values
from eivor.motions.vertical.flights import VerticalFlights
from eivor.motions.vertical.surroundings import height_over_ground, voltage, voltage_change
from eivor.motions.vertical.terms import DRAG, GROUND, SUPPLY, explained
from eivor.shapes import Float

#: What their numbers are called.
PREFIX = "left_out_"
#: A term is missed below this p-value.
MISSED = 0.005
#: Name of the test of the thrust curve's bend.
CURVATURE = "thrust_curvature"
#: Terms whose coefficients are told as shares of the gain.
SHARES = (CURVATURE, SUPPLY)
#: Smaller ones matter to nothing; of the supply that is what the thrust of one command changes by.
LEAST = {SUPPLY: 0.02}
#: What the voltage changed by over the time used, in the mean over the flights, as a share: the supply's
#: coefficient is then the power of the voltage that thrust goes with, and else what thrust changes by.
VOLTAGE_CHANGE = f"{PREFIX}{SUPPLY}_voltage_change"
#: Heights below this count as this [m].
LEAST_HEIGHT = 0.05

Column = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class _Flight:
    """What the terms are made of in one flight, as measured, and as far as the references explain it."""

    velocity: Column
    mapped: Column
    mean: float
    height: Column | None
    voltage: Column | None
    time: Column


#: From a flight to a term's column; None where the log lacks what it needs.
_TERMS: dict[str, Callable[[_Flight], Column | None]] = {
    DRAG: lambda of: -of.velocity * np.abs(of.velocity),
    GROUND: lambda of: None if of.height is None else np.maximum(of.height, LEAST_HEIGHT) ** -2.0,
    CURVATURE: lambda of: of.mean * (of.mapped / of.mean - 1.0) ** 2 if of.mean else None,
    SUPPLY: lambda of: of.mapped * (of.time if of.voltage is None else of.voltage),
}


def left_out(
    problem: VerticalFlights, estimate: Estimate, flights: Sequence[PreparedFlight]
) -> dict[str, Difference]:
    """Coefficient of each term as if it alone were added; none without instruments.

    Terms that the problem has are not tested.

    Parameters
    ----------
    problem : VerticalFlights
        The flights' own problem.
    estimate : Estimate
        Of it.
    flights : sequence of PreparedFlight
        The same flights, on the same samples.

    Returns
    -------
    dict of str to Difference
        In 1/m, in m^3/s^2, and as shares of the gain: of the curve's bend, and of the supply for the
        voltage's own share, or over the flight where not all flights have a voltage.
    """
    own = problem.runs.columns
    if not all(one.instruments.shape[1] for one in own):
        return {}
    at = estimate.best.at
    measured = [_measured(problem, place, flight, at) for place, flight in enumerate(flights)]
    if any(of.voltage is None for of in measured):  # one coefficient has one meaning
        measured = [replace(of, voltage=None) for of in measured]
    explained = [_explained(one, of) for one, of in zip(own, measured, strict=True)]
    base = [_linear(problem, one, estimate) for one in own]
    found: dict[str, Difference] = {}
    added = {term.left_out for term in problem.terms}
    for name, term in _TERMS.items():
        if name in added:
            continue
        columns, instruments = [term(of) for of in measured], [term(of) for of in explained]
        known = [(x, z) for x, z in zip(columns, instruments, strict=True) if x is not None and z is not None]
        if len(known) < len(own):
            continue
        with_term = [_with(one, linear, x, z) for one, linear, (x, z) in zip(own, base, known, strict=True)]
        coefficient = _coefficient(tuple(with_term), name)
        if coefficient is not None:
            found[name] = coefficient
    gain = abs(estimate.parameters["input_gain"]) or math.nan
    return found | {
        name: replace(one, value=one.value / gain, std_error=one.std_error / gain)
        for name, one in found.items()
        if name in SHARES
    }


def _measured(problem: VerticalFlights, place: int, flight: PreparedFlight, at: Values) -> _Flight:
    mapped = problem.runs.columns[place].moving(at)[:, 0]
    used = np.flatnonzero(flight.used)
    time = flight.grid.time_s
    span = time[used[-1]] - time[used[0]]
    share = (time - time[used[0]]) / span - 0.5
    volts = voltage(flight)
    away = None if volts is None else volts / float(volts[flight.used].mean()) - 1.0
    mean = float(mapped[flight.used].mean())
    return _Flight(problem.flights[place].velocity, mapped, mean, height_over_ground(flight), away, share)


def _explained(own: AxisColumns, of: _Flight) -> _Flight:
    """The same as far as the instruments of a flight explain it; voltage and time as they are."""
    known = {"velocity": of.velocity, "mapped": of.mapped} | (
        {} if of.height is None else {"height": of.height}
    )
    fitted = explained(own.instruments, own.runs, np.column_stack(list(known.values())))
    return replace(of, **dict(zip(known, fitted.T, strict=True)))


def _linear(problem: VerticalFlights, own: AxisColumns, estimate: Estimate) -> Float[np.ndarray, "n k"]:
    """Columns of the linear parameters at the estimate, and derivatives by the nuisances searched for."""
    at = estimate.best.at
    moving = own.moving(at)
    theta = estimate.best.theta[own.fixed.shape[1] :]
    slopes = [one.derivative(own.moving, at) @ theta for one in problem.nuisances if one.refined]
    return np.column_stack([own.fixed, moving, *slopes])


def _with(own: AxisColumns, linear: Float[np.ndarray, "n k"], x: Column, z: Column) -> AxisColumns:
    """Columns of a flight with a term and its instrument."""
    return replace(
        own,
        fixed=np.column_stack([x, linear]),
        moving=nothing_moves(x.size),
        instruments=np.column_stack([own.instruments, z]),
    )


def _coefficient(columns: tuple[AxisColumns, ...], name: str) -> Difference | None:
    """Coefficient of the first column; None where nothing tells it."""
    others = (Parameter(f"of the model {place}", "") for place in range(1, columns[0].fixed.shape[1]))
    try:
        return estimated(LaggedRuns(columns, (Parameter(name, ""), *others), ()), {}).differences[name]
    except (EstimationError, InstrumentError, TooFewSamplesError):
        return None


def voltage_numbers(flights: Sequence[PreparedFlight]) -> dict[str, float]:
    """`VOLTAGE_CHANGE`; nothing unless all flights have a voltage."""
    changes = [change for flight in flights if (change := voltage_change(flight)) is not None]
    return {VOLTAGE_CHANGE: float(np.mean(changes))} if 0 < len(changes) == len(flights) else {}


# -- told ---------------------------------------------------------------------------------------------------


def left_out_numbers(found: Mapping[str, Difference]) -> dict[str, float]:
    """Coefficients, half-widths and p-values by name."""
    numbers: dict[str, float] = {}
    for name, one in found.items():
        numbers |= {
            f"{PREFIX}{name}": one.value,
            f"{PREFIX}{name}_half_width": one.half_width,
            f"{PREFIX}{name}_p_value": one.p_value,
        }
    return numbers


def missed(numbers: Mapping[str, float], name: str) -> bool:
    """Whether the test of a term says that it is missed, by so much that it matters."""
    if not numbers.get(f"{PREFIX}{name}_p_value", 1.0) < MISSED:
        return False
    changed = numbers.get(VOLTAGE_CHANGE, 1.0) if name == SUPPLY else 1.0
    return abs(numbers[f"{PREFIX}{name}"] * changed) >= LEAST.get(name, 0.0)


def left_out_told(numbers: Mapping[str, float]) -> tuple[tuple[str, str], ...]:
    """Terms that are missed, and the tests of the others."""
    tested = [name for name in _TERMS if f"{PREFIX}{name}" in numbers]
    said = [left_out_sentence(numbers, name) for name in tested if missed(numbers, name)]
    quiet = [
        f"{name.replace('_', ' ')} (p {numbers[f'{PREFIX}{name}_p_value']:.2g})"
        for name in tested
        if not missed(numbers, name)
    ]
    if quiet:
        said.append(f"not missed: {', '.join(quiet)}")
    return (("left out", "; ".join(said)),) if said else ()


def left_out_sentence(numbers: Mapping[str, float], name: str) -> str:
    """What is missed, with number and unit."""
    value, half = numbers[f"{PREFIX}{name}"], numbers[f"{PREFIX}{name}_half_width"]
    if name == DRAG:
        drag = f"a drag of {value:.2g} ± {half:.2g} 1/m times the squared speed"
        return f"{drag} is missed: K is that of these speeds"
    if name == GROUND:
        grows = "grows" if value > 0.0 else "falls"
        return f"thrust {grows} towards the ground, as if the ground were near"
    if name == CURVATURE:
        bends = "more" if value > 0.0 else "less"
        by = f"{value:+.2g} ± {half:.2g} times the squared share of the input beyond its mean"
        return f"thrust bends {bends} than the input map: {by}"
    if VOLTAGE_CHANGE in numbers:
        changed = numbers[VOLTAGE_CHANGE]
        return (
            f"the thrust of one command went as the battery's voltage to the power {value:.2g} ± {half:.2g}: "
            f"the voltage changed by {changed:.0%}, and the thrust by {abs(value * changed):.0%} "
            f"(± {half * changed:.0%})"
        )
    moved = "rose" if value > 0.0 else "fell"
    return f"the thrust of one command {moved} by {abs(value):.0%} (± {half:.0%}) with the supply or the time"
