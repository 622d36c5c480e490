"""The search for the actuator's lag by the default method: seconds per delay candidate and minute of flight.

Target: about 0.05 s. The peer is `scipy.signal.lfilter` on the same commands as often as the grid of lags
has values: a search cannot do with less.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from _shared import arguments, example_flight, least_seconds, machine
from scipy.signal import lfilter

import eivor as ev
from eivor.motions.vertical.regression import VerticalFlights


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    log = ev.read_log(example_flight())
    window = (0.0, 20.0) if small else None
    fit = ev.identify_flight(log, ev.FlightOptions(window=window)).fit
    assert fit is not None
    problem = fit.problem
    assert isinstance(problem, VerticalFlights)
    repeats = 1 if small else 5
    for copies in (1,) if small else (1, 4):
        flights = problem.made_of(problem.flights * copies)
        commands = [flight.signals.family(flight.input.name) for flight in flights.flights]
        minutes = sum(
            (run.stop - run.start) * flight.signals.step_s / 60.0
            for flight in flights.flights
            for run in flight.runs
        )
        work = minutes * flights.nuisances[1].grid.size

        def search(flights: VerticalFlights = flights) -> object:
            return ev.identify(replace(flights), ev.methods.reference_iv())  # a copy has no memo

        def filters(
            commands: list[np.ndarray] = commands, count: int = flights.nuisances[0].grid.size
        ) -> None:
            for _ in range(count):
                for command in commands:
                    lfilter([0.1], [1.0, -0.9], command, axis=0)

        seconds = least_seconds(search, repeats) / work
        peer = least_seconds(filters, repeats) / minutes
        print(
            f"{minutes:4.1f} min of flight   {seconds:6.3f} s per candidate and minute   "
            f"ratio to lfilter alone {seconds / peer:5.2f}   of target {seconds / 0.05:5.2f}"
        )


if __name__ == "__main__":
    main()
