"""How well the bootstrap is calibrated: the tables of docs/method.md.

    python benchmarks/bootstrap.py [--small]

Time: coverage of 95 % intervals of a regression with an intercept, an AR(1) input of memory 0.7 and AR(1)
errors. Flights: width of the bootstrap's 95 % intervals over that of the recipe's, for pools of ten
simulated flights, and how often each holds the truth. Every seed is a number below.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from _shared import arguments
from scipy.signal import lfilter

import eivor as ev
from eivor.estimation.methods import identify, reference_iv
from eivor.flights.prepare import prepare
from eivor.flights.result import FlightEstimate
from eivor.models.regression import Regression
from eivor.motions.vertical.regression import VerticalFlights
from eivor.signals.recording import Recording
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights

QUANTITIES = ("viscous_friction", "input_gain", "effective_lag", "hover_input")


def autocorrelated(seed: int, rows: int, memory: float) -> Regression:
    """Response 1 + x / 2 + e."""
    random = np.random.default_rng(seed)
    x, e = (lfilter([1.0], [1.0, -m], random.normal(size=rows + 200))[200:] for m in (0.7, memory))
    return ev.regression(response=1.0 + 0.5 * x + e, regressors=np.column_stack([np.ones(rows), x]))


def coverage(rows: int, memory: float, trials: int, runs: int) -> None:
    """Print the coverage of intercept and slope."""
    held, lengths = np.zeros(2), []
    for trial in range(trials):
        problem = autocorrelated(trial, rows, memory)
        bootstrap = ev.bootstrap(problem, ev.methods.least_squares(), runs=runs, seed=trial)
        lengths.append(bootstrap.block_length)
        for index, truth in enumerate((1.0, 0.5)):
            low, high = bootstrap.interval(bootstrap.names[index])
            held[index] += low <= truth <= high
    print(
        f"rows {rows}, memory {memory}, blocks of {np.median(lengths):.0f}, {trials} trials: "
        f"{' '.join(f'{share:.3f}' for share in held / trials)}",
        flush=True,
    )


def pool(fit: FlightEstimate, recordings: list[Recording]) -> FlightEstimate:
    """What `identify_flight` makes of a pool, without each flight's own result."""
    prepared = tuple(prepare(log, fit.motion, fit.options) for log in recordings)
    assert fit.fit is not None
    assert isinstance(fit.fit.problem, VerticalFlights)
    whole = fit.fit.problem
    problem = whole.made_of(prepared)
    estimate = identify(problem, reference_iv())
    quantities = {
        name: quantity_estimate.judged(fit.verdict, fit.motion.quantities[name])
        for name, quantity_estimate in fit.motion.derive(problem, estimate).items()
    }
    return replace(fit, fit=replace(fit.fit, problem=problem, estimate=estimate), quantities=quantities)


def flights(pools: int, runs: int) -> None:
    """Print the ratio of widths for each pool, their quartiles, and the coverage of both intervals."""
    first: FlightEstimate | None = None
    ratios, ours, theirs = [], np.zeros(4), np.zeros(4)
    for number in range(pools):
        gusts, delay = (0.3, 1.0)[number % 2], (0.0, 0.01)[number // 2 % 2]
        specs = [
            VerticalFlightSpec(gust_rms=gusts, delay=delay, seed=1000 * (number + 1) + k) for k in range(10)
        ]
        recordings = [flight.recording for flight in simulate_vertical_flights(specs)]
        first = first or ev.identify_flight(recordings[:2])
        fit, spec = pool(first, recordings), specs[0]
        bootstrap_flights = ev.bootstrap_flights(fit, runs=runs, seed=number)
        truth = (spec.viscous_friction, spec.input_gain, spec.actuator_lag + spec.delay, spec.hover_input)
        row = []
        for index, name in enumerate(QUANTITIES):
            (low, high), (lower, upper) = bootstrap_flights.interval(name), fit.quantities[name].interval
            row.append((high - low) / (upper - lower))
            ours[index] += low <= truth[index] <= high
            theirs[index] += lower <= truth[index] <= upper
        ratios.append(row)
        print(number, gusts, delay, np.round(row, 2), flush=True)
    for share in (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0):
        print(f"quantile {share:.2f} of the ratio:", np.round(np.quantile(ratios, share, axis=0), 2))
    print("coverage, bootstrap:", ours / pools, " recipe:", theirs / pools, f" {pools} pools")


def main() -> None:
    small = arguments(__doc__).small
    start_s = time.perf_counter()
    flights(1 if small else 40, 50 if small else 400)
    for rows in (200,) if small else (500, 4000):
        for memory in (0.5,) if small else (0.0, 0.5, 0.9):
            coverage(rows, memory, 3 if small else 400, 49 if small else 199)
    print(f"{time.perf_counter() - start_s:.0f} s")


if __name__ == "__main__":
    main()
