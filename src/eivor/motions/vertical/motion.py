"""The vertical motion of a multirotor, as the recipe and the reports see it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from eivor.errors import InputError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.agreement import SensorAgreement, sensor_agreement
from eivor.flights.allowance import Allowance
from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.drawn import Drawn
from eivor.flights.estimated import reciprocal
from eivor.flights.grid import on_grid
from eivor.flights.motion import Motion
from eivor.flights.options import FIT_MAP, FlightOptions
from eivor.flights.predicted import Predicted, SimpleModel
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Quantity, Unjudged
from eivor.flights.selection import Selection
from eivor.flights.shown import Panel, Trace
from eivor.flights.tracked import Followed
from eivor.flights.words import CardSection
from eivor.inference.verdict import Reason
from eivor.models.instruments import InstrumentRule
from eivor.models.separable import Values
from eivor.motions.vertical.allowances import all_allowances
from eivor.motions.vertical.balance import apparent_gravity, balance_sums
from eivor.motions.vertical.curve_told import curve_findings
from eivor.motions.vertical.flights import VerticalFlight, VerticalFlights
from eivor.motions.vertical.followed import followed_gain
from eivor.motions.vertical.height import near_ground
from eivor.motions.vertical.hover import HOVER_PARAMETERS, hover_findings
from eivor.motions.vertical.left_out import left_out, left_out_numbers, left_out_told, voltage_numbers
from eivor.motions.vertical.map_evidence import map_numbers
from eivor.motions.vertical.model import VerticalMotion
from eivor.motions.vertical.quantities import all_quantities, drawn_quantities, thrust_curve
from eivor.motions.vertical.row_noise import input_variance
from eivor.motions.vertical.rule import all_grounds
from eivor.motions.vertical.select import INPUTS, REFERENCES, TELEMETRY, open_loop_findings, selected
from eivor.motions.vertical.sensor_rule import APPARENT_GRAVITY
from eivor.motions.vertical.sensors import LEAST, aligned, difference_problem, sideways_speed, told
from eivor.motions.vertical.sideways import SIDEWAYS
from eivor.motions.vertical.supply import supply_findings
from eivor.motions.vertical.term_channels import check_flights, check_terms, mean_voltage, with_surroundings
from eivor.motions.vertical.terms import SUPPLY, TERMS, GroundEffect, OptionalTerm
from eivor.motions.vertical.wording import ACROSS, EQUATION, QUANTITIES, SHOWN, WORDS, vertical_card
from eivor.shapes import Float
from eivor.signals.input_map import input_map
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Finding, Recording
from eivor.signals.signals import Signals


@dataclass(frozen=True)
class Vertical(Motion[VerticalFlights]):
    """z'' + g = K_u U - K z' + b, behind the lag of the actuators.

    Parameters
    ----------
    added : tuple of OptionalTerm
        Terms that were asked for.
    rotor_radius : float, optional
        Of a rotor [m].
    mean_voltage : float, optional
        Voltage that the gain belongs to, where a term follows the voltage [V].
    """

    added: tuple[OptionalTerm, ...] = ()
    rotor_radius: float | None = None
    mean_voltage: float | None = None

    name = "vertical"
    model_name = "vertical_motion"
    equation = EQUATION
    wording = QUANTITIES
    shown = SHOWN
    headline = ("viscous_friction",)
    of_flight = ("viscous_friction",)
    terms = MappingProxyType({word: term.meaning for word, term in TERMS.items()})
    rows = ("viscous_friction", "input_gain", "effective_lag", "hover_input")
    across = ACROSS
    words = WORDS
    inputs = INPUTS
    telemetry = TELEMETRY
    lag_from = ("rates",)
    needed = ("velocity_z",)
    references = REFERENCES
    logged_parameters = (
        *HOVER_PARAMETERS,
        "HTE_THR_RANGE",
        "THR_MDL_FAC",
        "MOT_THST_EXPO",
        "MPC_THR_MIN",
        "MPC_THR_MAX",
        "MPC_Z_VEL_MAX_UP",
        "MPC_Z_VEL_MAX_DN",
        "SYS_AUTOSTART",
        "CA_ROTOR_COUNT",
        "SDLOG_PROFILE",
    )
    # the vehicle, and the path from its thrust setpoint to the rotors
    vehicle_parameters = (
        "SYS_AUTOSTART",
        "THR_MDL_FAC",
        "CA_ROTOR_COUNT",
        "MOT_POLE_COUNT",
        "PWM_MIN",
        "PWM_MAX",
        "PWM_MAIN_MIN",
        "PWM_MAIN_MAX",
    )

    def check(self, options: FlightOptions) -> None:
        """Refuse input maps that do not exist, and terms without what they need, see `Motion.check`."""
        check_terms(options, self.rotor_radius)
        if options.input_map not in ("", FIT_MAP):
            input_map(options.input_map)

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Velocity, specific force, tilt and what drives the rotors, see `Motion.select`."""
        return selected(log, options)

    def of_vehicle(self, vehicle: str) -> Vertical:
        """Return the same motion with the radius of a vehicle's rotors, see `Motion.of_vehicle`.

        Raises
        ------
        UsageError
            When the vehicle tells none.
        """
        from eivor.motions.rigid_body.vehicle_file import load_vehicle  # late: few name one

        radius = load_vehicle(vehicle).rotor_radius
        if radius is None:
            raise UsageError(
                f"a vehicle with the radius of its rotors, which is all that '{self.name}' asks of one",
                f"{vehicle!r}, which has none",
                "Write radius = 0.12 under [rotors] of its file, or leave the vehicle out.",
            )
        return replace(self, rotor_radius=radius)

    def for_flights(self, flights: tuple[PreparedFlight, ...], options: FlightOptions) -> Vertical:
        """With the terms that were asked for, see `Motion.for_flights`."""
        check_flights(flights, options)
        added = tuple(TERMS[word] for word in options.terms)
        radius = self.rotor_radius if options.rotor_radius is None else options.rotor_radius
        known = mean_voltage(flights) if self.mean_voltage is None else self.mean_voltage
        return replace(self, added=added, rotor_radius=radius, mean_voltage=known)

    def told_vehicle(self) -> Mapping[str, object] | None:
        """What terms count in, see `Motion.told_vehicle`; nothing without terms."""
        if not self.added:
            return None
        return {"rotor_radius": self.rotor_radius, "mean_voltage": self.mean_voltage}

    def of_told_vehicle(self, told: object) -> Vertical:
        """Return the same motion with what the terms of a result count in, see `Motion.of_told_vehicle`."""
        if told is None:
            return self
        known = told if isinstance(told, Mapping) else {}
        radius, volts = known.get("rotor_radius"), known.get("mean_voltage")
        if (
            not known
            or not isinstance(radius, int | float | None)
            or not isinstance(volts, int | float | None)
        ):
            raise InputError(
                "a result with rotor_radius and mean_voltage of its terms",
                f"{told!r}",
                "Identify the flight again with eivor identify --json.",
            )
        return replace(self, rotor_radius=radius, mean_voltage=volts)

    @property
    def written(self) -> tuple[str, str]:
        """The equation with the terms that were asked for, see `Motion.written`."""
        equation, symbols = self.equation
        told = (symbols, *(term.symbols for term in self.added if term.symbols))
        return " ".join((equation, *(term.written for term in self.added))), "; ".join(told)

    def problem(self, flights: tuple[PreparedFlight, ...], rule: InstrumentRule) -> VerticalFlights:
        """Regressions of the flights for each lag and delay, see `Motion.problem`."""
        model = VerticalMotion(input_map(flights[0].input_map))
        cut = tuple(self._cut(flight) for flight in flights)
        return VerticalFlights(cut, model, rule, terms=self.added)

    def signals(self, flight: PreparedFlight, lag_s: float, delay_s: float) -> Signals:
        """Signals with `input`: the mean of the mapped actuators, late, times the cosine of tilt.

        A commanded input is exact unless a noise is declared of it.
        """
        cut, motion = vertical_flight(flight), VerticalMotion(input_map(flight.input_map))
        driving = cut.mapped_input(motion, lag_s, delay_s)
        noise = WhiteNoise(input_variance(cut, motion.input_map) ** 0.5)
        return replace(
            flight.signals,
            channels={**flight.signals.channels, "input": driving},
            noise={**flight.signals.noise, "input": noise},
        )

    def _cut(self, flight: PreparedFlight) -> VerticalFlight:
        """What the regressions need of a flight, with what its terms need."""
        cut = vertical_flight(flight)
        return with_surroundings(cut, flight, self.rotor_radius, self.mean_voltage) if self.added else cut

    def settled(
        self,
        problem: VerticalFlights,
        estimated: Callable[[VerticalFlights], Estimate],
        options: FlightOptions,
    ) -> tuple[VerticalFlights, Estimate]:
        """Estimate with the map that was chosen, or find it out: see `eivor.motions.vertical.curve`."""
        if options.input_map != FIT_MAP:
            return problem, estimated(problem)
        from eivor.motions.vertical.curve import settled_curve  # late: few ask for it

        return settled_curve(problem, estimated, options.accelerometer_bias)

    def as_settled(
        self, flights: tuple[PreparedFlight, ...], problem: VerticalFlights
    ) -> tuple[PreparedFlight, ...]:
        """Flights with the map that was found out, see `Motion.as_settled`."""
        return tuple(replace(flight, input_map=problem.motion.input_map.name) for flight in flights)

    def quantities(self, problem: VerticalFlights, estimate: Estimate) -> Mapping[str, Unjudged]:
        """Parameters, hover input, effective lag and time constant, see `Motion.quantities`."""
        return all_quantities(problem, estimate)

    def followed(
        self, problem: VerticalFlights, quantities: Mapping[str, Quantity], options: FlightOptions
    ) -> Followed:
        """The input's gain, see `eivor.motions.vertical.followed`."""
        return followed_gain(problem, quantities, options)

    def allowances(
        self,
        _problem: VerticalFlights,
        _estimate: Estimate,
        flights: tuple[PreparedFlight, ...],
        quantities: Mapping[str, Unjudged],
        at: Circumstances,
        /,
    ) -> Mapping[str, tuple[Allowance, ...]]:
        """Systematic parts, see `eivor.motions.vertical.allowances`."""
        return all_allowances(flights, quantities, at)

    def sensors(
        self, problem: VerticalFlights, flights: tuple[PreparedFlight, ...]
    ) -> SensorAgreement | None:
        """Whether velocity and accelerometer agree, see `eivor.motions.vertical.sensors`."""
        return sensor_agreement(difference_problem(problem, flights), LEAST)

    def sensors_told(self, sensors: SensorAgreement) -> str:
        """By how much they differ, or may differ."""
        return told(sensors)

    def aligned(
        self, flights: tuple[PreparedFlight, ...], sensors: SensorAgreement
    ) -> tuple[PreparedFlight, ...]:
        """Offset and scale taken out, see `Motion.aligned`."""
        return aligned(flights, sensors)

    def following(self, quantities: Mapping[str, Unjudged]) -> Mapping[str, Unjudged]:
        """The time constant, which is one over the friction, see `Motion.following`."""
        return {"time_constant": reciprocal(quantities["viscous_friction"], "s")}

    def grounds(
        self, quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
    ) -> Mapping[str, tuple[Reason, ...]]:
        """The rule of the verdict, see `eivor.motions.vertical.rule`."""
        return all_grounds(quantities, strength, at)

    def known(self, flights: tuple[PreparedFlight, ...]) -> Mapping[str, float]:
        """Mean input, which is near the hover input, see `Motion.known`."""
        means = [flight.used_input.mean() for flight in flights]
        return {"hover_input": float(np.mean(means))} if means else {}

    def excitation(self, flights: tuple[PreparedFlight, ...]) -> str:
        """Relative standard deviation of the mapped input, and that of the vertical speed."""
        model = VerticalMotion(input_map(flights[0].input_map))
        moved: list[Float[np.ndarray, "_ 2"]] = []
        for flight in flights:
            cut = vertical_flight(flight)
            moved.extend(cut.cut(np.column_stack([cut.mapped_input(model, 0.0, 0.0), cut.velocity])))
        mapped, speed = np.concatenate(moved).T
        mean = abs(float(mapped.mean()))
        if mean == 0.0 or not np.isfinite(mapped.std() / mean):
            return ""
        return (
            f"The input varied by {mapped.std() / mean:.1%} and the vertical speed by "
            f"{speed.std():.2g} m/s (standard deviations)."
        )

    def diagnostics(
        self, problem: VerticalFlights, estimate: Estimate, flights: tuple[PreparedFlight, ...]
    ) -> Mapping[str, float]:
        """Thrust near hover and in the input map, the gravity that is felt, height, and terms left out."""
        missed = left_out(problem, estimate, flights)
        return {
            **map_numbers(problem, estimate, missed),
            **thrust_curve(problem, estimate),
            APPARENT_GRAVITY: apparent_gravity(problem),
            SIDEWAYS: sideways_speed(flights),
            **near_ground(flights, self.rotor_radius, corrected=GroundEffect() in self.added),
            **left_out_numbers(missed),
            **(voltage_numbers(flights) if SUPPLY in missed else {}),
        }

    def checks(self, numbers: Mapping[str, float]) -> tuple[tuple[str, str], ...]:
        """Terms that the model leaves out, and whether they are missed."""
        return left_out_told(numbers)

    def findings(
        self, flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity]
    ) -> tuple[Finding, ...]:
        """Instruments where no loop acts, what the autopilot holds its hover input to be, a curve for it."""
        told = (*open_loop_findings(flights), *hover_findings(flights, quantities))
        return (*told, *supply_findings(flights), *curve_findings(flights, quantities))

    def flight_sums(
        self, problem: VerticalFlights, at: Values
    ) -> Mapping[str, Float[np.ndarray, " flights"]]:
        """Terms of the balance, see `Motion.flight_sums`."""
        return balance_sums(problem, at)

    def resampled(self, problem: VerticalFlights, drawn: Drawn) -> Mapping[str, float]:
        """Friction, gain and hover input; lag and effective lag when they were searched for."""
        return drawn_quantities(problem, drawn)

    def simple_models(self, problem: VerticalFlights, estimate: Estimate) -> Mapping[str, SimpleModel]:
        """Least squares without a lag, and the hover input alone, see `Motion.simple_models`."""
        from eivor.motions.vertical.predict import simple_models

        return simple_models(problem, estimate)

    def predictions(self, problem: VerticalFlights, values: Values) -> tuple[Predicted, ...]:
        """Vertical acceleration one step ahead, and climb rate in open loop, see `Motion.predictions`."""
        from eivor.motions.vertical.predict import predictions

        return predictions(problem, values)

    def flown(
        self, problem: VerticalFlights, estimate: Estimate, flights: tuple[PreparedFlight, ...]
    ) -> Mapping[str, object]:
        """Residual, controller and tilt of the flights, see `Motion.flown`."""
        from eivor.motions.vertical.flown import flown

        return flown(problem, estimate, flights)

    def symbols(self, flight: PreparedFlight) -> str:
        """What U is in this flight."""
        name = flight.input.name
        names = f"the mean of the mapped {name}" if flight.actuators > 1 else name
        moved = (
            "measured; motion follows d later (below zero: their stamps are late)"
            if flight.input.measured
            else "behind a lag τ and a delay d"
        )
        of_terms = "".join(f"; {term.symbols}" for term in self.added if term.symbols)
        return f"U = cos(tilt) × {names} (map: {flight.input_map}), {moved}{of_terms}"

    def traces(self, problem: VerticalFlights, estimate: Estimate) -> tuple[Trace, ...]:
        """Vertical acceleration, means of each run removed, see `Motion.traces`."""
        best = estimate.best
        rows = problem.rows(best.at)
        return (
            Trace(
                "vertical acceleration",
                "m/s²",
                "K_u U − K z'",
                "K_u U",
                rows.response,
                rows.regressors @ best.theta,
                rows.regressors[:, 1] * best.theta[1],
            ),
        )

    def overview(self, flight: PreparedFlight) -> tuple[Panel, ...]:
        """Height where it is logged, and climb rate, see `Motion.overview`."""
        signals = flight.signals
        climb = Panel(
            "climb rate\n[m/s]", signals.channel("velocity_z"), flight.asked("reference_velocity_z")
        )
        panels = [climb]
        if "position_z" in flight.recording.channels:
            height = on_grid(flight.recording.channel("position_z"), flight.grid)[0]
            panels.insert(0, Panel("height [m]", height, flight.asked("reference_position_z")))
        return tuple(panels)

    def advice(self, log_format: str) -> tuple[CardSection, ...]:
        """What to fly and to log, see `Motion.advice`."""
        return vertical_card(log_format)


def vertical_flight(flight: PreparedFlight) -> VerticalFlight:
    """Return what the regressions of vertical motion need of a flight."""
    return VerticalFlight(
        flight.signals,
        flight.input.name,
        flight.input.measured,
        flight.runs,
        flight.band_hz,
        densities={name: level.density for name, level in flight.noise.items() if level.source},
    )
