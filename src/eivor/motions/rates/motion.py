"""Turning of a multirotor about its body axes, as the recipe and the reports see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights import without_lag
from eivor.flights.ahead import Ahead
from eivor.flights.airborne import Active
from eivor.flights.allowance import Allowance
from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.estimated import joint_quantities, lag_quantities
from eivor.flights.grid import Grid
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.predicted import SimpleModel
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Unjudged
from eivor.flights.selection import Selection
from eivor.flights.shown import Panel, Trace
from eivor.flights.words import CardSection
from eivor.inference.verdict import Reason
from eivor.models.instruments import InstrumentRule
from eivor.models.lagged_runs import LaggedRuns
from eivor.motions.rates.allowances import all_allowances
from eivor.motions.rates.axes import AXES, PITCH, ROLL, Axis
from eivor.motions.rates.flights import rates_problem
from eivor.motions.rates.rate_panel import rate_panel
from eivor.motions.rates.rule import all_grounds
from eivor.motions.rates.select import INPUTS, REFERENCES, active, selected
from eivor.motions.rates.thrust import THRUST
from eivor.motions.rates.wording import EQUATION, QUANTITIES, SHOWN, WORDS, rates_card
from eivor.shapes import Float
from eivor.signals.recording import Recording


@dataclass(frozen=True)
class Rates(Motion[LaggedRuns]):
    """p' = G u - D p + b about each axis, behind the lag of the actuators."""

    name = "rates"
    model_name = "body_rates"
    equation = EQUATION
    wording = QUANTITIES
    shown = SHOWN
    headline = (ROLL.effectiveness.name, PITCH.effectiveness.name)
    rows = (*headline, "effective_lag")
    words = WORDS
    inputs = INPUTS
    needed = (ROLL.rate, PITCH.rate)
    references = REFERENCES
    companions = (THRUST,)
    logged_parameters = (
        "IMU_GYRO_RATEMAX",
        "IMU_GYRO_CUTOFF",
        "IMU_DGYRO_CUTOFF",
        "MC_ROLLRATE_P",
        "MC_PITCHRATE_P",
        "MC_YAWRATE_P",
        "SYS_AUTOSTART",
        "CA_ROTOR_COUNT",
        "SDLOG_PROFILE",
    )
    vehicle_parameters = ("SYS_AUTOSTART", "THR_MDL_FAC", "CA_ROTOR_COUNT")

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Rates and torque setpoints, see `Motion.select`."""
        return selected(log, options)

    def active(self, log: Recording, grid: Grid, _input_level: Float[np.ndarray, " n"], /) -> Active:
        """Samples in the air, see `Motion.active`."""
        return active(log, grid)

    def problem(self, flights: tuple[PreparedFlight, ...], rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the flights for each lag and delay, see `Motion.problem`."""
        return rates_problem(flights, rule)

    def quantities(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, Unjudged]:
        """Parameters of the axes that are logged, and the lag, see `Motion.quantities`."""
        found = {**joint_quantities(estimate), **lag_quantities(problem, estimate)}
        return {name: found[name] for name in QUANTITIES if name in found}

    def allowances(
        self,
        _problem: LaggedRuns,
        _estimate: Estimate,
        flights: tuple[PreparedFlight, ...],
        quantities: Mapping[str, Unjudged],
        _at: Circumstances,
        /,
    ) -> Mapping[str, tuple[Allowance, ...]]:
        """What rotors and the stamps of the setpoints leave open, see `eivor.motions.rates.allowances`."""
        return all_allowances(flights, quantities)

    def grounds(
        self, quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
    ) -> Mapping[str, tuple[Reason, ...]]:
        """The rule of the verdict, see `eivor.motions.rates.rule`."""
        return all_grounds(quantities, strength, at)

    def excitation(self, flights: tuple[PreparedFlight, ...]) -> str:
        """Standard deviations of the rates of roll and pitch."""
        spreads = [
            np.std(np.concatenate([flight.signals.channel(axis.rate)[flight.used] for flight in flights]))
            for axis in (ROLL, PITCH)
        ]
        roll, pitch = (float(np.rad2deg(spread)) for spread in spreads)
        return f"Roll turned at {roll:.2g} and pitch at {pitch:.2g} deg/s (standard deviations)."

    def simple_models(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, SimpleModel]:
        """Least squares without a lag, see `Motion.simple_models`."""
        return {without_lag.NAME: without_lag.least_squares_without_lag(problem, estimate.best.at)}

    def ahead(
        self,
        flights: tuple[PreparedFlight, ...],
        models: Mapping[str, SimpleModel],
        refused: frozenset[str],
    ) -> Ahead:
        """Rates of the setpoints alone, see `eivor.motions.rates.ahead`."""
        from eivor.motions.rates.ahead import rates_ahead

        return rates_ahead(flights, models, refused)

    def symbols(self, flight: PreparedFlight) -> str:
        """What u is in this flight."""
        return f"u = {flight.input.name} of each axis, behind a lag τ and a delay d that all share"

    def traces(self, problem: LaggedRuns, estimate: Estimate) -> tuple[Trace, ...]:
        """Angular acceleration about each axis within the band, see `Motion.traces`."""
        return tuple(_trace(problem, estimate, axis) for axis in AXES if axis.number in problem.axes)

    def overview(self, flight: PreparedFlight) -> tuple[Panel, ...]:
        """Rates of roll and pitch, see `Motion.overview`."""
        return tuple(rate_panel(flight, axis) for axis in (ROLL, PITCH))

    def advice(self, log_format: str) -> tuple[CardSection, ...]:
        """What to fly and to log, see `Motion.advice`."""
        return rates_card(log_format)


def _trace(problem: LaggedRuns, estimate: Estimate, axis: Axis) -> Trace:
    best = estimate.best
    driving = [
        number
        for number, parameter in enumerate(problem.parameters)
        if parameter in (axis.effectiveness, axis.reaction)
    ]
    series = problem.series_in_band(best.at, axis.number, best.theta, driving)
    return Trace(f"{axis.name} acceleration", "rad/s²", "G u − D ω", "G u", *series.T)
