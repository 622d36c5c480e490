"""A multirotor as a rigid body, as the recipe and the reports see it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.method import Method
from eivor.estimation.weighting.whitening import SpectralWhitening
from eivor.flights import without_lag
from eivor.flights.ahead import Ahead
from eivor.flights.airborne import Active
from eivor.flights.allowance import Allowance
from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.estimated import EFFECTIVE_LAG, joint_quantities, lag_quantities
from eivor.flights.grid import Grid
from eivor.flights.implied import Implications, Implied
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.predicted import SimpleModel
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Unjudged
from eivor.flights.selection import Selection
from eivor.flights.shown import Panel, Trace
from eivor.flights.words import CardSection
from eivor.inference.verdict import Reason
from eivor.models.instruments import InstrumentRule, NoInstruments
from eivor.models.lagged_runs import LaggedRuns
from eivor.motions.rates.axes import AXES
from eivor.motions.rates.rate_panel import rate_panel
from eivor.motions.rates.select import active
from eivor.motions.rigid_body.allowances import all_allowances
from eivor.motions.rigid_body.combinations import Combinations
from eivor.motions.rigid_body.filters_shown import filters_not_passed
from eivor.motions.rigid_body.flights import rigid_body_problem
from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.motions.rigid_body.lags_apart import lags_apart
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.motions.rigid_body.one_spin import settled_spin, spin_moments
from eivor.motions.rigid_body.parameters import ALONG, DRIVING, FORCE_X, GAIN, THRUST, TURNING
from eivor.motions.rigid_body.physical import PhysicalParameter, physical_parameters
from eivor.motions.rigid_body.quantities import at_hover, viscous_friction
from eivor.motions.rigid_body.rotor_order import order_shown
from eivor.motions.rigid_body.rule import all_grounds
from eivor.motions.rigid_body.select import INPUTS, REFERENCES, selected
from eivor.motions.rigid_body.surrogate import noises_known, noisier
from eivor.motions.rigid_body.told_vehicle import vehicle_told
from eivor.motions.rigid_body.vehicle_file import load_vehicle, shipped_vehicles
from eivor.motions.rigid_body.whole_band import settled_band
from eivor.motions.rigid_body.wind_shown import steady_wind
from eivor.motions.rigid_body.wording import EQUATION, QUANTITIES, SHOWN, WORDS, rigid_body_card
from eivor.shapes import Float
from eivor.signals.recording import Recording

#: The method whose rows are whitened, as those of the motion's own methods are.
TOTAL_LEAST_SQUARES = "total_least_squares"
#: What the rotors did before a log begins in the air is not known, and matters for so long [s].
SETTLED_S = 1.0


@dataclass(frozen=True)
class RigidBody(Motion[LaggedRuns]):
    """Turning about three axes and the force along them, behind the lag of the rotors.

    Parameters
    ----------
    vehicle : KnownVehicle, optional
        What flies; without it nothing is identified.
    pooled : bool
        Several of its flights are identified, so that what is said of the vehicle file is said of all.
    """

    vehicle: KnownVehicle | None = None
    pooled: bool = False

    name = "rigid-body"
    model_name = "rigid_body"
    equation = EQUATION
    wording = QUANTITIES
    shown = SHOWN
    headline = (THRUST.name, GAIN[0].name, GAIN[1].name, EFFECTIVE_LAG)
    rows = headline
    words = WORDS
    inputs = INPUTS
    needed = tuple(axis.rate for axis in AXES)
    references = REFERENCES
    direct = "whitened_least_squares"

    @property
    def layout(self) -> RotorLayout:
        """Where the rotors are.

        Raises
        ------
        UsageError
            When nobody said what flies.
        """
        if self.vehicle is None:
            raise UsageError(
                "a vehicle: places and spins of its rotors tell what turns it",
                "none",
                f"Give one with --vehicle: a file, which `eivor vehicle new` begins, or one of "
                f"{', '.join(shipped_vehicles())}.",
            )
        return RotorLayout(self.vehicle)

    def check(self, options: FlightOptions) -> None:
        """Refuse to begin without a vehicle, see `Motion.check`."""
        _ = options, self.layout

    def of_vehicle(self, vehicle: str) -> RigidBody:
        """Return the same motion of a vehicle, by the name of a shipped one or from a file."""
        return replace(self, vehicle=load_vehicle(vehicle))

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Rotors, rates, forces, velocity and attitude, see `Motion.select`."""
        return selected(log, options, self.layout)

    def active(self, log: Recording, grid: Grid, _input_level: Float[np.ndarray, " n"], /) -> Active:
        """Samples in the air at which the rotors no longer know how they began, see `Motion.active`."""
        found, settled = active(log, grid), grid.steps - grid.steps[0] >= SETTLED_S / grid.step_s
        return replace(found, mask=found.mask & settled)

    def weighted(self, method: Method, /) -> Method:
        """Total least squares of whitened rows: between samples rates and speeds are mostly noise."""
        if method.name != TOTAL_LEAST_SQUARES or not isinstance(method, LinearMethod):
            return method
        return replace(method, row_weighting=SpectralWhitening())

    def for_flights(self, flights: tuple[PreparedFlight, ...], _options: FlightOptions, /) -> RigidBody:
        """With whether there are several, see `Motion.for_flights`."""
        return replace(self, pooled=len(flights) > 1)

    def problem(self, flights: tuple[PreparedFlight, ...], rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the flights for each lag and delay, see `Motion.problem`."""
        problem = rigid_body_problem(flights, self.layout, rule)
        if not all(map(noises_known, flights)):
            return problem
        surrogates = tuple(map(noisier, flights))
        return replace(problem, noisier=rigid_body_problem(surrogates, self.layout, NoInstruments()))

    def settled(
        self, problem: LaggedRuns, estimated: Callable[[LaggedRuns], Estimate], _options: FlightOptions, /
    ) -> tuple[LaggedRuns, Estimate]:
        """With one inertia of the rotors about all axes where the flights tell it, and in a band that serves.

        See `one_spin` and `whole_band`.
        """
        return settled_band(*settled_spin(problem, estimated), estimated)

    def quantities(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, Unjudged]:
        """Parameters of the equations that are there, and the lag, see `Motion.quantities`."""
        joint = joint_quantities(estimate)
        found = {
            **at_hover(problem, joint),
            **spin_moments(problem, joint),
            **viscous_friction(problem, estimate),
            **lag_quantities(problem, estimate),
        }
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
        """What the log does not say of commands and filters, see `eivor.motions.rigid_body.allowances`."""
        return all_allowances(flights, quantities, self.layout.vehicle)

    def grounds(
        self, quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
    ) -> Mapping[str, tuple[Reason, ...]]:
        """The rule of the verdict, see `eivor.motions.rigid_body.rule`."""
        return all_grounds(quantities, strength, at)

    def implications(self, estimate: Estimate) -> Implications:
        """Physical parameters, as far as the flight and the vehicle file tell them; see `physical`."""
        if self.vehicle is None:
            return Implications()
        found = physical_parameters(Combinations.of_estimate(estimate), self.vehicle)
        return Implications(tuple(map(_implied, found.rows)), found.contradictions)

    def diagnostics(
        self, problem: LaggedRuns, estimate: Estimate, flights: tuple[PreparedFlight, ...], /
    ) -> Mapping[str, float]:
        """Where a flight contradicts the vehicle file, `rotor_order` and `filters_shown`, or our equations.

        That a steady wind blew is `wind_shown`, that axes disagree about the lag `lags_apart`.
        """
        shown = order_shown(flights, self.layout)
        if shown is not None:
            return shown.numbers
        wind = steady_wind(problem, estimate.best.at, flights)
        lags = lags_apart(estimate)
        found = {**(wind.numbers if wind is not None else {}), **(lags.numbers if lags is not None else {})}
        if self.pooled and len(flights) == 1:
            return found  # the whole pool is asked about filters
        filters = filters_not_passed(problem, estimate, flights, self.layout)
        return found if filters is None else found | filters.numbers

    def excitation(self, flights: tuple[PreparedFlight, ...]) -> str:
        """Standard deviations of the rates."""
        spreads = [
            float(np.rad2deg(np.std(np.concatenate([f.signals.channel(axis.rate)[f.used] for f in flights]))))
            for axis in AXES
        ]
        roll, pitch, yaw = spreads
        return (
            f"Roll, pitch and yaw turned at {roll:.2g}, {pitch:.2g} and {yaw:.2g} deg/s (standard "
            "deviations)."
        )

    def simple_models(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, SimpleModel]:
        """Least squares without a lag, see `Motion.simple_models`."""
        return {without_lag.NAME: without_lag.least_squares_without_lag(problem, estimate.best.at)}

    def ahead(
        self,
        flights: tuple[PreparedFlight, ...],
        models: Mapping[str, SimpleModel],
        refused: frozenset[str],
    ) -> Ahead:
        """The state of the rotors alone, see `eivor.motions.rigid_body.ahead`."""
        from eivor.motions.rigid_body.ahead import rigid_body_ahead

        return rigid_body_ahead(flights, self.layout, models, refused)

    def told_vehicle(self) -> Mapping[str, object] | None:
        """What was known of the vehicle, see `Motion.told_vehicle`."""
        return None if self.vehicle is None else asdict(self.vehicle)

    def of_told_vehicle(self, told: object) -> RigidBody:
        """Return the same motion of the vehicle of a result, see `Motion.of_told_vehicle`."""
        return replace(self, vehicle=vehicle_told(told))

    def symbols(self, flight: PreparedFlight) -> str:
        """What n is in this flight."""
        how = "measured" if flight.input.measured else "commands, behind a lag τ and a delay d that all share"
        return f"n = {flight.input.name} of {flight.actuators} rotors (map: {flight.input_map}), {how}"

    def traces(self, problem: LaggedRuns, estimate: Estimate) -> tuple[Trace, ...]:
        """Angular acceleration about each axis and force along it, within the bands; see `Motion.traces`."""
        driving = [number for number, parameter in enumerate(problem.parameters) if parameter in DRIVING]
        found = []
        for axis in problem.axes:
            series = problem.series_in_band(estimate.best.at, axis, estimate.best.theta, driving)
            turning = axis < FORCE_X
            words = (
                f"{TURNING[axis]} acceleration"
                if turning
                else f"specific force along {ALONG[axis - FORCE_X]}"
            )
            unit, band = "rad/s²" if turning else "m/s²", problem.band_hz(axis)
            measured, predicted, driven = series.T
            found.append(Trace(words, unit, "model", "rotors", measured, predicted, driven, band))
        return tuple(found)

    def overview(self, flight: PreparedFlight) -> tuple[Panel, ...]:
        """Rates, see `Motion.overview`."""
        return tuple(rate_panel(flight, axis) for axis in AXES)

    def advice(self, log_format: str) -> tuple[CardSection, ...]:
        """What to fly and to log, see `Motion.advice`."""
        return rigid_body_card(log_format)


def _implied(row: PhysicalParameter) -> Implied:
    told = row.told
    if told is None:
        return Implied(row.name, row.words, "", "", None, None, None, row.sentence)
    return Implied(
        row.name, row.words, told.symbol, told.unit, told.value, told.std_error, told.interval, row.sentence
    )
