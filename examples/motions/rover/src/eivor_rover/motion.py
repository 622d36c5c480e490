"""The rover, as Eivor's recipe and reports see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights.lag_prior import joint_quantities, lag_quantities, ratio_quantity
from eivor.flights.motion import (
    Abilities,
    Flights,
    FlightView,
    InstrumentStrength,
    LogChannels,
    Motion,
    VerdictInputs,
)
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight, Selection
from eivor.flights.quantity import PlotData, QuantityEstimate, Trace
from eivor.inference.verdict import Reason
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import InstrumentRule
from eivor.signals.recording import Recording
from eivor_rover.channels import CHANNELS, INPUTS, REFERENCES, SPEED, selected
from eivor_rover.problem import rover_runs
from eivor_rover.rule import reasons
from eivor_rover.words import EQUATION, QUANTITIES, WORDS


def excitation(flights: Flights) -> str:
    """How much speed and command varied."""
    speed = np.concatenate([flight.signals.channel(SPEED)[flight.used] for flight in flights])
    command = np.concatenate([flight.used_input.mean(axis=1) for flight in flights])
    return (
        f"The command varied by {command.std():.2g} and the speed by {speed.std():.2g} m/s (standard "
        "deviations)."
    )


@dataclass(frozen=True)
class Rover(Motion[LaggedRuns]):
    """v' = a u - c v - d sign(v) + b, behind the lag of the drive."""

    name = "rover"
    words = WORDS
    equation = EQUATION
    quantities = QUANTITIES
    channels = LogChannels(INPUTS, (SPEED,), REFERENCES, added=CHANNELS)
    abilities = Abilities(excitation=excitation)

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Speed, command and accelerometer."""
        return selected(log, options)

    def problem(self, flights: tuple[PreparedFlight, ...], rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the drives for each lag and delay."""
        return rover_runs(flights, rule)

    def derive(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        """Parameters, lags, and what follows from them."""
        joint = joint_quantities(estimate)
        return {
            **{name: joint[name] for name in ("drive_gain", "rolling_drag", "dry_friction")},
            **lag_quantities(problem, estimate),
            "breakaway_command": ratio_quantity(estimate, "dry_friction", "drive_gain", ""),
            "time_constant": ratio_quantity(estimate, 1.0, "rolling_drag", "s"),
        }

    def reasons(
        self, quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength, inputs: VerdictInputs
    ) -> Mapping[str, tuple[Reason, ...]]:
        """The rule of the verdicts."""
        return reasons(quantities, strength, inputs)

    def traces(self, problem: LaggedRuns, estimate: Estimate) -> tuple[Trace, ...]:
        """Forward acceleration, means of each run removed."""
        best = estimate
        rows = problem.rows(best.nuisances)
        return (
            Trace(
                "forward acceleration",
                "m/s²",
                "a u − c v − d sign(v)",
                "a u",
                rows.response,
                rows.regressors @ best.theta,
                rows.regressors[:, 2] * best.theta[2],
            ),
        )

    def view(self, flight: PreparedFlight) -> FlightView:
        """What u is in this drive, and the speed."""
        symbols = f"u = {flight.input.name} behind a lag τ and a delay t_d"
        return FlightView(symbols, (PlotData("forward speed\n[m/s]", flight.signals.channel(SPEED)),))
