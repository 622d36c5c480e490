"""Rotors that follow their commands within a limit of rate or level: the limit, and commands as they act."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from eivor.flights.prepared import LEVEL, RATE, CommandLimit, PreparedFlight
from eivor.motions.vertical.model import VerticalMotion
from eivor.motions.vertical.regression import VerticalFlight, VerticalFlights, vertical_problem
from eivor.tools import Float

#: Rates and levels that are tried; and lags [s] whose responses together stand for any linear actuator.
RATES, LEVELS, LAGS_S = 16, 12, (0.0, 0.008, 0.016, 0.03, 0.06, 0.12, 0.25)
#: A limit is there when it makes twice the log likelihood so much larger, without the blocks that gain most.
LEAST_GAIN, OUTLYING = 20.0, 0.1
#: Samples of a flight that are read, and memory of its residual's autoregression and blocks of it [s].
MOST_SAMPLES, MEMORY_S, BLOCK_S = 50_000, 0.3, 1.0


def _longest_run(flight: PreparedFlight) -> PreparedFlight:
    """The first samples of the longest run, alone."""
    longest = max(flight.runs, key=lambda run: run.stop - run.start)
    run = slice(longest.start, min(longest.stop, longest.start + MOST_SAMPLES))
    return replace(flight, runs=(run,)).shortened


def _gains(
    flight: VerticalFlight,
    motion: VerticalMotion,
    prepared: PreparedFlight,
    limits: Sequence[CommandLimit],
) -> Float[np.ndarray, "blocks k"]:
    """By how much each limit makes the squared innovations of the force balance smaller than none does.

    In variances, block by block of a part of the flight. The innovations are those of one autoregression.
    """
    flight, (run,) = replace(flight, signals=prepared.signals), prepared.runs
    step_s = flight.signals.step_s
    tilt, block = flight.signals.channel("cos_tilt"), max(round(BLOCK_S / step_s), 1)
    response = flight.velocity_derivative if flight.acceleration is None else flight.acceleration

    def columns(commands: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "rows c"]:
        """Acceleration; then velocity, thrust behind every lag, and powers of thrust for other maps."""
        states = [flight.state_of(commands, lag_s=lag_s, delay_s=0.0) for lag_s in LAGS_S]
        thrusts = [motion.input_map(state).mean(axis=1) * tilt for state in states]
        middle = thrusts[len(LAGS_S) // 2]
        away = middle / (middle[run].mean() or 1.0) - 1.0
        results = np.column_stack((response, flight.velocity, *thrusts, away**2, away**3))[run]
        return results - results.mean(axis=0)

    logged = columns(flight.signals.family(flight.input))
    whitening = _whitening(_residual(logged), max(int(MEMORY_S / step_s), 1))

    def squares(of: Float[np.ndarray, "n c"]) -> Float[np.ndarray, " blocks"]:
        white = np.stack([np.convolve(column, whitening, mode="valid") for column in of.T], axis=1)
        usual = white.shape[0] // block * block
        return np.asarray((_residual(white)[:usual].reshape(-1, block) ** 2).sum(axis=1))

    unlimited = squares(logged)
    gains = [
        unlimited - squares(columns(commands)) for commands in np.moveaxis(prepared.acting(limits), 2, 0)
    ]
    return np.stack(gains, axis=1) / (unlimited.mean() / block)


def _whitening(residual: Float[np.ndarray, " n"], order: int) -> Float[np.ndarray, " p"]:
    """Filter that leaves of a residual its innovations, by Yule and Walker."""
    power = np.abs(np.fft.rfft(residual, 2 * residual.size)) ** 2
    correlation = np.fft.irfft(power)[: order + 1]
    correlation[0] *= 1.0 + 1e-9
    return np.append(1.0, -scipy.linalg.solve_toeplitz(correlation[:-1], correlation[1:]))


def _residual(columns: Float[np.ndarray, "n c"]) -> Float[np.ndarray, " n"]:
    """What the others leave of the first column."""
    Q = np.linalg.qr(columns[:, 1:])[0]
    return columns[:, 0] - Q @ (Q.T @ columns[:, 0])


def command_limit(problem: VerticalFlights) -> CommandLimit | None:
    """The limit of rate or level within which commands act, in all flights; None where nothing says so.

    Noise that feedback passes on to quick commands shows a rate: references alone move them too slowly.
    """
    flights = [flight.prepared for flight in problem.flights if not flight.measured]
    prepared = [_longest_run(flight) for flight in flights if flight is not None and flight.issued]
    if len(prepared) < len(problem.flights):
        return None
    rates, levels = _rates(prepared), _levels(prepared)
    if not (rates or levels):
        return None
    pairs = zip(problem.flights, prepared, strict=True)
    gains = np.concatenate([_gains(flight, problem.motion, of, [*rates, *levels]) for flight, of in pairs])
    kinds = (gains[:, : len(rates)], rates), (gains[:, len(rates) :], levels)
    gain, limit = max((_best(*kind) for kind in kinds if kind[1]), key=lambda item: item[0])
    return limit if gain >= LEAST_GAIN else None


def _best(gains: Float[np.ndarray, "blocks k"], limits: list[CommandLimit]) -> tuple[float, CommandLimit]:
    """What the best of some limits of one kind gains, and that limit between its neighbours."""
    total = gains.sum(axis=0)
    best = int(total.argmax())
    most = np.sort(gains[:, best])[: math.floor((1.0 - OUTLYING) * len(gains))]
    # the vertex of a parabola through the best and its neighbours
    low, middle, high = total[np.clip([best - 1, best, best + 1], 0, len(limits) - 1)]
    bend = low - 2.0 * middle + high
    away = 0.5 * (low - high) / bend if 0 < best < len(limits) - 1 and bend < 0.0 else 0.0
    kind, value = limits[best]
    return float(most.sum()), CommandLimit(kind, float(value * (limits[1].value / limits[0].value) ** away))


def _rates(flights: Sequence[PreparedFlight]) -> list[CommandLimit]:
    """Rates of commands from half of the rms on the grid to the largest few; none where commands rest."""
    rates, means = [], []
    for flight in flights:
        for command in flight.issued:
            step = np.diff(command.time_s)
            rates.append(np.abs(np.diff(command.values)[step > 0.0]) / step[step > 0.0])
            gridded = flight.signals.channel(command.name)
            means.append(np.mean(np.gradient(gridded, flight.signals.step_s)[flight.used] ** 2))
    every = np.concatenate(rates)
    every = every[np.isfinite(every) & (every > 0.0)]
    low, high = 0.5 * float(np.sqrt(np.mean(means))), float(np.quantile(every, 0.99)) if every.size else 0.0
    return [CommandLimit(RATE, x) for x in np.geomspace(low, high, RATES)] if 0.0 < low < high else []


def _levels(flights: Sequence[PreparedFlight]) -> list[CommandLimit]:
    """Levels of commands above most of them, below the largest; none where commands rest."""
    every = [flight.signals.channel(item.name)[flight.used] for flight in flights for item in flight.issued]
    low, high = (float(end) for end in np.quantile(np.concatenate(every), (0.6, 1.0)))
    return [CommandLimit(LEVEL, x) for x in np.geomspace(low, high, LEVELS)[:-1]] if 0.0 < low < high else []


def within_limit(problem: VerticalFlights) -> VerticalFlights:
    """The problem with commands as they act, where these have a limit."""
    limit = None if any(flight.command_limit for flight in problem.flights) else command_limit(problem)
    if limit is None:
        return problem
    flights = tuple(
        replace(flight, signals=flight.prepared.within(limit).signals, command_limit=limit)
        for flight in problem.flights
        if flight.prepared is not None
    )
    return vertical_problem(flights, problem.motion, problem.rule, problem.nuisances, problem.terms)
