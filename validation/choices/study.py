"""What decides whether a log can be identified: its rate, and the delay that the model allows for.

    python -m validation.choices.study [--flights 40] [--workers N] [--page docs/studies/coverage.md]

flies the scenario `flight` with the seeds 0, 1, 2, ..., thins each log, and identifies it at every rate; then
flies it again with commands that are 20 ms late, and identifies it with and without a delay in the model.
Prints the tables; `--page` puts them between the page's marks. Some minutes on two cores.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import eivor as ev
from eivor.errors import UsageError
from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_flight
from eivor.lab.study import Share
from eivor.models.lagged_runs import lag_and_delay
from eivor.motions.vertical.regression import VerticalFlights
from eivor.process_pool import in_order, local_executor
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from validation.pages import markdown
from validation.studies import WORKERS, Option, StudyCommand, share_text
from validation.suite_files import versions

#: Every so many samples of a log of 100 Hz are kept: 100, 50, 20 and 10 Hz.
THINNINGS = (1, 2, 5, 10)
LOG_RATE_HZ = 100.0
#: Delay of the commands in the second part [s].
DELAY_S = 0.02
FLIGHTS = 40
QUANTITIES = ("viscous_friction", "input_gain", "effective_lag", "hover_input")
TITLES = ("K", "K_u", "effective lag", "hover input")
PART = "choices"


@dataclass(frozen=True, slots=True)
class RateTrial:
    verdict: str  # Of the flight
    # Whether the interval of each of `QUANTITIES` holds the truth; None without an interval
    held: tuple[bool | None, ...]


@dataclass(frozen=True, slots=True)
class DelayTrial:
    """A flight whose commands are late, with one model."""

    error: float  # Of the input gain, relative to the truth
    held: bool  # Whether its interval holds the truth


@dataclass(frozen=True, slots=True)
class Trial:
    """What was made of one seed."""

    rates: tuple[RateTrial, ...]  # For each of `THINNINGS`
    with_delay: DelayTrial  # Of the model that searches the delay, and of the one that has none
    without_delay: DelayTrial


def fly(seed: int) -> Trial:
    prompt = replace(shipped_flight(), seed=seed)
    late = replace(prompt, delay=DELAY_S)
    first, second = (flight.recording for flight in simulate_vertical_flights([prompt, late]))
    rates = tuple(_at_rate(ev.identify_flight(thinned(first, every)), prompt) for every in THINNINGS)
    searched = ev.identify_flight(second)
    assert searched.fit is not None
    assert isinstance(searched.fit.problem, VerticalFlights)
    problem = replace(searched.fit.problem, nuisances=lag_and_delay(delays_s=[0.0]))
    without = ev.identify(problem, ev.methods.reference_iv())
    name, truth = "input_gain", late.input_gain
    return Trial(
        rates,
        _late(searched.parameters[name], searched.interval(name), truth),
        _late(without.parameters[name], without.interval(name), truth),
    )


def thinned(recording: ev.Recording, every: int) -> ev.Recording:
    """Log that keeps one sample out of so many; a held channel then holds what was kept."""
    channels = {
        name: replace(channel, time_s=channel.time_s[::every], values=channel.values[::every])
        for name, channel in recording.channels.items()
    }
    return replace(recording, channels=channels)


def _at_rate(result: ev.FlightEstimate, spec: VerticalFlightSpec) -> RateTrial:
    truth = (spec.viscous_friction, spec.input_gain, spec.actuator_lag + spec.delay, spec.hover_input)
    intervals = [result.quantities[name].interval for name in QUANTITIES]
    held = tuple(
        low <= value <= high if np.isfinite([low, high]).all() else None
        for (low, high), value in zip(intervals, truth, strict=True)
    )
    return RateTrial(result.verdict.status.value, held)


def _late(value: float, interval: tuple[float, float], truth: float) -> DelayTrial:
    return DelayTrial(value / truth - 1.0, bool(interval[0] <= truth <= interval[1]))


def tables(trials: Sequence[Trial]) -> str:
    made = (
        f"Made by `python -m validation.choices.study` with {versions()}: {len(trials)} flights, seeds 0 to "
        f"{len(trials) - 1}. Brackets hold the 95 % Wilson interval of a share."
    )
    rates = [
        (f"{LOG_RATE_HZ / every:g} Hz", *_rate_cells([trial.rates[index] for trial in trials]))
        for index, every in enumerate(THINNINGS)
    ]
    header = ("log", "identified", *(f"{title} held" for title in TITLES))
    delays = [
        _delay_row("searched", [trial.with_delay for trial in trials]),
        _delay_row("left out", [trial.without_delay for trial in trials]),
    ]
    return "\n\n".join(
        [
            made,
            "**Log rate.** Nominal 95 % intervals of every flight that has one, whatever the verdict.",
            markdown(header, rates),
            f"**Delay.** Commands that reach the rotors {1e3 * DELAY_S:g} ms late, at {LOG_RATE_HZ:g} Hz.",
            markdown(("delay in the model", "error of K_u, mean ± SD", "K_u held"), delays),
        ]
    )


def _rate_cells(trials: Sequence[RateTrial]) -> list[str]:
    identified = sum(trial.verdict == Status.IDENTIFIED.value for trial in trials)
    cells = [f"{identified} of {len(trials)}"]
    for column in zip(*(trial.held for trial in trials), strict=True):
        known = [held for held in column if held is not None]
        cells.append(share_text(Share(sum(known), len(known))))
    return cells


def _delay_row(model: str, trials: Sequence[DelayTrial]) -> tuple[str, str, str]:
    errors = 100.0 * np.array([trial.error for trial in trials])
    held = share_text(Share(sum(trial.held for trial in trials), len(trials)))
    return model, f"{errors.mean():+.2f} ± {errors.std(ddof=1):.2f} %", held


def run(flights: int = FLIGHTS, workers: int | None = None) -> list[Trial]:
    if flights < 2:
        raise UsageError("two flights or more", f"{flights}", "The page has 40.")
    return list(in_order(local_executor(workers, flights).map(fly, range(flights))))


OPTIONS: dict[str, Option] = {
    "--flights": {"type": int, "default": FLIGHTS, "help": "seeds from 0 on"},
    "--workers": WORKERS,
}
main = StudyCommand(
    "validation.choices.study",
    __doc__,
    PART,
    lambda chosen: (tables(run(chosen.flights, chosen.workers)), ()),
    OPTIONS,
).main

if __name__ == "__main__":
    sys.exit(main())
