"""The vertical motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from eivor import checks
from eivor.errors import InputError
from eivor.estimation.estimate import Estimate
from eivor.flights import lag_prior, motion, quantity
from eivor.flights.grid import on_grid
from eivor.flights.options import FIT_MAP, FlightOptions
from eivor.flights.prepared import RATE, Difference, PreparedFlight, Selection, sensor_agreement
from eivor.flights.quantity import NAN, PlotData, Quantity, QuantityEstimate, Trace, TrackedParameter
from eivor.inference.distributions import chi_square_quantile, chi_square_tail
from eivor.inference.verdict import Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, measured_state
from eivor.models.separable import InstrumentRule, NoInstruments, Prior, Values
from eivor.motions.equation import AxisEquation, DeclaredMotion
from eivor.motions.rigid_body.vehicle import load_vehicle
from eivor.motions.vertical import commands, misspecification, regression, select, verdict
from eivor.motions.vertical.figures import key_figures
from eivor.motions.vertical.predict import closed_loop_record, predictions, simple_models
from eivor.motions.vertical.regression import (
    EQUATION,
    NO_LAG_VALUES,
    Balance,
    VerticalFlights,
    WeightBalance,
    mean_voltage,
)
from eivor.signals.recording import GRAVITY, Finding, Recording
from eivor.signals.signals import Signals
from eivor.signals.thrust_map import Mixed, input_map
from eivor.tools import plain

#: Friction of a multirotor of which nothing is known [1/s].
ANY_FRICTION = Prior(0.3, 0.3)

SET_LEVEL = 0.95
#: Half-widths are not below this [m/s^2].
LEAST_HALF_WIDTH = 1e-9


def beyond(value: float, half_width: float) -> float:
    """Squared distance of an intercept from what a fitting map leaves, in standard errors."""
    excess = max(abs(value) - verdict.CLEAR_INTERCEPT, 0.0) / max(half_width, LEAST_HALF_WIDTH)
    return chi_square_quantile(SET_LEVEL, 1) * excess**2


def fitting_p_value(distance: float, value: float, bend: Difference | None) -> float:
    """P-value of the test that the input map fits; one where the intercept is within what it leaves."""
    if not 0.0 < distance < np.inf:
        return 1.0
    bent = 0.0
    if bend is not None and bend.value * value < 0.0:
        bent = chi_square_quantile(1.0 - bend.p_value, 1)
    both = distance + bent
    return 0.5 * chi_square_tail(both, 1) + 0.25 * chi_square_tail(both, 2)


def _hover(balance: Balance | WeightBalance) -> QuantityEstimate:
    """Hover input, U_h through the input map's inverse; by the weight without a gain."""
    weight, curve = balance.weight if isinstance(balance, Balance) else balance, balance.problem.input_map
    if isinstance(balance, Balance) and not balance.by_weight:
        item = lag_prior.linear_quantity(balance.estimate, "", *balance.hover)
        value, std_error, (low, high) = item.value, item.std_error, item.interval
    else:
        value, std_error, half = weight.hover
        low, high = value - half, value + half
        if not low > 0.0:
            return QuantityEstimate(curve.inverse(value), "", NAN, quantity.NO_INTERVAL)
    hover = curve.inverse(value)
    error = std_error / curve.slope(hover) if curve.slope(hover) > 0.0 else NAN
    return QuantityEstimate(hover, "", error, (curve.inverse(low), curve.inverse(high)))


def known_without_estimate(
    flights: motion.Flights,
) -> tuple[dict[str, QuantityEstimate], verdict.VerticalChecks]:
    """Hover input of flights that gave no estimate, and its drift; nothing of a constant input."""
    if all(flight.constant_input for flight in flights):
        return {}, verdict.VerticalChecks()
    of = WeightBalance(Vertical().problem(flights, NoInstruments()), NO_LAG_VALUES)  # lags hardly move means
    return {"hover_input": _hover(of)}, verdict.VerticalChecks(
        drift=of.drift, mean_command=_mean_command(of.problem)
    )


def _mean_command(problem: VerticalFlights) -> float:
    """Mean command of the rotors over that of their mean thrust, in the flight furthest from 1."""
    return max(map(regression.mean_command, problem.flights), key=lambda share: abs(share - 1.0))


#: A fall by a larger share over the time used is identified; thrust goes with its first or second power.
LARGE_FALL = 0.03
#: A flight without its voltage that is longer may have sagged as much [s].
LONG_S = 120.0
#: Ends of the time used whose medians are compared, as a share of it.
END_SHARE = 0.1


def supply_findings(flights: tuple[PreparedFlight, ...]) -> Iterator[Finding]:
    """Drift of the supply of flights by commands."""
    for flight in flights:
        if not flight.runs or flight.input.measured:
            continue
        name = f"{flight.recording.name}: " if len(flights) > 1 else ""
        (start, end), channel = flight.span_s, flight.recording.channels.get(regression.VOLTAGE)
        stamps, volts = (np.empty(0), np.empty(0)) if channel is None else (channel.time_s, channel.values)
        known = np.isfinite(volts) & (volts > 0.0) & (stamps >= start) & (stamps <= end)
        stamps, volts = stamps[known], volts[known]
        margin = END_SHARE * (end - start)
        ends = volts[stamps <= start + margin], volts[stamps >= end - margin]
        first, last = (float(np.median(item)) if item.size else NAN for item in ends)
        if volts.size < 2.0 / END_SHARE and end - start > LONG_S:
            sentence = (
                f"No battery voltage is logged with {(end - start) / 60.0:.2g} minutes of flight: it may "
                "have sagged, and the same command then gives less thrust at the end. Log it."
            )
            yield Finding("voltage_not_logged", name + sentence)
        elif volts.size >= 2.0 / END_SHARE and 1.0 - last / first > LARGE_FALL:
            sentence = (
                f"The battery's voltage fell by {1.0 - last / first:.1%}, from {first:.3g} to {last:.3g} V: "
                "the same command gave less thrust at the end, and gain and hover input are means over the "
                "flight."
            )
            yield Finding("voltage_sag", name + sentence)


def tracked_gain(
    problem: VerticalFlights, quantities: Mapping[str, Quantity], options: FlightOptions, name: str
) -> TrackedParameter:
    """Rows that identify K_u over a flight, and what is known of K and the intercept."""
    checks.index_of("a parameter", name or "input_gain", ("input_gain",))
    estimated, friction = quantities["viscous_friction"], ANY_FRICTION
    source = "as of any multirotor: the flight does not identify it"
    by_flight = "as the whole flight identifies it"
    if estimated.verdict is not Status.REFUSED and 0.0 < estimated.half_width < math.inf:
        friction = Prior(estimated.value, max(estimated.std_error, 0.5 * estimated.half_width))
        source = by_flight
    bias, pooled, intercept = options.accelerometer_bias, quantities["intercept"], None
    level = "Nothing is known of the intercept: only movement identifies the gain."
    if quantities["input_gain"].verdict is not Status.REFUSED and 0.0 < pooled.half_width < math.inf:
        intercept = Prior(pooled.value - GRAVITY, 0.5 * pooled.half_width)
        level = f"Intercept {pooled.value:.2g} ± {pooled.half_width:.2g} m/s², {by_flight}."
    elif math.isfinite(bias):
        intercept = Prior(-GRAVITY, bias)
        level = (
            f"Intercept 0 ± {1.96 * bias:.2g} m/s²: the input map is right, and the accelerometer's bias "
            "small (--accelerometer-bias)."
        )
    known = f"Friction {friction.mean:.3g} ± {1.96 * friction.std:.2g} 1/s, {source}."
    return TrackedParameter("input_gain", problem, {"viscous_friction": friction}, intercept, (known, level))


def excitation(flights: motion.Flights) -> str:
    """Relative standard deviation of the mapped input, and that of the vertical speed."""
    moved = [(regression.mapped_input(item), item.signals.channel("velocity_z")) for item in flights]
    pairs = zip(flights, moved, strict=True)
    mapped, speed = np.concatenate([np.stack(each)[:, item.used] for item, each in pairs], axis=1)
    mean, varied = abs(float(mapped.mean())), float(mapped.std())
    if mean == 0.0 or not np.isfinite(varied / mean):
        return ""
    of_speed = f"the vertical speed by {speed.std():.2g} m/s (standard deviations)"
    return f"The input varied by {varied / mean:.1%} and {of_speed}."


def flight_findings(flights: motion.Flights, quantities: Mapping[str, Quantity]) -> tuple[Finding, ...]:
    """Instruments where no loop acts, what the autopilot holds its hover input to be, a curve for it."""
    listed = (*select.open_loop_findings(flights), *verdict.hover_findings(flights, quantities))
    return (*listed, *supply_findings(flights), *commands.curve_findings(flights, quantities))


def resampled(
    problem: VerticalFlights, parameters: Values, nuisances: Values, sums: Values
) -> dict[str, float]:
    """Friction, gain and hover input; lag and effective lag when they were searched for."""
    names = ("viscous_friction", "input_gain", *(term.parameter.name for term in problem.terms))
    results = {name: parameters[name] for name in names}
    results["hover_input"] = problem.input_map.inverse(regression.hover_of_sums(parameters, sums))
    lag_s, delay_s = (nuisances[name] for name in (ACTUATOR_LAG.name, DELAY.name))
    searched = {nuisance.name for nuisance in problem.nuisances if nuisance.searched}
    if ACTUATOR_LAG.name in searched:
        results[ACTUATOR_LAG.name] = lag_s
    if {ACTUATOR_LAG.name, DELAY.name} & searched:
        results[lag_prior.EFFECTIVE_LAG] = lag_s + delay_s
    return results


def refined(
    problem: VerticalFlights,
    solve: motion.Solver[VerticalFlights],
    options: FlightOptions,
    _flights: motion.Flights,
) -> tuple[VerticalFlights, Estimate]:
    """The problem with the limit of commands and the input map that flights show."""
    problem = commands.with_command_limit(problem)
    if options.input_map == FIT_MAP:
        return commands.refined_curve(problem, solve, options.accelerometer_bias)
    return problem, solve(problem)


def refined_flights(flights: motion.Flights, problem: VerticalFlights) -> motion.Flights:
    """Flights with what the problem found out."""
    known = [replace(flight, input_map=problem.input_map.name) for flight in flights]
    limit = problem.command_limit
    if limit is None:
        return tuple(known)
    unit = known[0].issued[0].unit
    if limit.kind == RATE:
        sentence = (
            f"Commands act at no more than {plain(limit.value)} {unit or '1'}/s, as the response to their "
            "noise shows: gain, friction and lag are those behind commands of that rate."
        )
    else:
        largest = f"{plain(limit.value, 3)} {unit}".rstrip()
        sentence = f"Commands above {largest} act as that: the results are those of commands up to there."
    finding = Finding(limit.kind, sentence)
    return tuple(replace(f.within(limit), findings=(*f.findings, finding)) for f in known)


ABILITIES = motion.Abilities(
    refined=refined,
    refined_flights=refined_flights,
    sensors=motion.SensorComparison(
        lambda problem, flights: sensor_agreement(
            misspecification.difference_problem(problem, flights), misspecification.LEAST_SENSOR_DIFFERENCE
        ),
        misspecification.sensor_agreement_sentence,
        misspecification.corrected,
    ),
    resampling=motion.Resampling(regression.balance_sums, resampled),
    prediction=motion.Prediction(simple_models, predictions),
    tracking=tracked_gain,
    closed_loop_record=closed_loop_record,
    known=known_without_estimate,
    excitation=excitation,
    findings=flight_findings,
    figures=key_figures,
    profiled=True,
    lag_from=("rates",),
)


@dataclass(frozen=True)
class Vertical(DeclaredMotion[VerticalFlights]):
    """z'' + g = K_u U - K z' + b, behind the lag of the actuators."""

    added: tuple[regression.OptionalTerm, ...] = ()
    rotor_radius: float | None = None  # [m]
    mean_voltage: float | None = None

    name = "vertical"
    axes = (EQUATION,)
    words = select.TABLES.words
    quantities = select.QUANTITIES
    rules = verdict.RULES
    parts = verdict.PARTS
    channels = select.TABLES.channels

    @property
    def equation(self) -> tuple[str, str]:  # type: ignore[override]
        equation, symbols = select.TABLES.equation
        listed = (symbols, *(term.symbols for term in self.added if term.symbols))
        return " ".join((equation, *(term.written for term in self.added))), "; ".join(listed)

    @property
    def abilities(self) -> motion.Abilities:  # type: ignore[override]
        record = {"rotor_radius": self.rotor_radius, "mean_voltage": self.mean_voltage}
        return replace(
            ABILITIES,
            vehicle=motion.VehicleSupport(self._of_vehicle, record if self.added else None, self._restored),
            check=self._check,
            for_flights=self._for_flights,
            terms={word: term.meaning for word, term in regression.TERMS.items()},
        )

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        return select.selected(log, options)

    def axes_of(self, flights: motion.Flights) -> Sequence[Mapping[int, AxisEquation]]:
        return [{0: regression.equation_of(flight, self.added)} for flight in flights]

    def signals(self, flight: PreparedFlight, _axis: AxisEquation) -> Signals:
        return regression.signals_of(flight, bool(self.added), self.rotor_radius, self.mean_voltage)

    def problem(self, flights: motion.Flights, rule: InstrumentRule) -> VerticalFlights:
        made = self.lagged_runs(flights, rule)
        if self.added and made.columns[0].instruments.shape[1]:
            pairs = zip(made.columns, flights, strict=True)
            of = ((item, self.signals(flight, EQUATION)) for item, flight in pairs)
            made = made.with_instruments([regression.with_instruments_of(self.added, *each) for each in of])
        width = made.columns[0].instruments.shape[1]
        return VerticalFlights(
            made.columns,
            made.parameters,
            measured_state() if flights[0].input.measured else made.nuisances,
            partial(regression.row_noise, flights, len(self.added), width, rule),
            flights=flights,
            made_of=partial(self.problem, rule=rule),
            terms=self.added,
        )

    def derive(self, problem: VerticalFlights, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        of, joint = Balance(problem, estimate), lag_prior.joint_quantities(estimate)
        by_run = tuple(GRAVITY + float(run.mean(axis=0) @ of.coefficients) for run in of.weight.columns)
        intercept = lag_prior.linear_quantity(estimate, "m/s^2", *of.intercept)
        results = {
            **{name: joint[name] for name in ("viscous_friction", "input_gain")},
            "intercept": replace(intercept, by_run=by_run),
            **{term.parameter.name: joint[term.parameter.name] for term in problem.terms},
            **lag_prior.lag_quantities(problem, estimate),
            "hover_input": _hover(of),
            "time_constant": lag_prior.ratio_quantity(estimate, 1.0, "viscous_friction", "s"),
        }
        if problem.curve is None:
            return results
        moved = commands.curve_quantities(of, problem.curve)
        moved["intercept"] = replace(moved["intercept"], by_run=by_run)
        return {**results, **moved, "time_constant": lag_prior.reciprocal(moved["viscous_friction"], "s")}

    def checks(
        self, problem: VerticalFlights, estimate: Estimate, flights: motion.Flights
    ) -> verdict.VerticalChecks:
        omitted, of = misspecification.omitted_terms(problem, estimate, flights), Balance(problem, estimate)
        (value, gradient, variance), curve = of.intercept, problem.input_map
        half = estimate.joint_covariance.half_width(gradient, SET_LEVEL, variance)
        of_map, of_thrust = of.exponents
        return verdict.VerticalChecks(
            fitting_p_value(beyond(value, half), value, omitted.differences.get(misspecification.CURVATURE)),
            thrust_exponent=of_thrust,
            map_exponent=of_map,
            input_spread=float(np.concatenate(of.weight.columns)[:, 2].std()) / abs(of.hover[0]),
            thrust_command=isinstance(curve, Mixed) or curve.name == "linear",
            apparent_gravity=regression.apparent_gravity(problem),
            turned=misspecification.turned(flights),
            command_limit=problem.command_limit,
            sideways_speed=misspecification.sideways_speed(flights),
            near_ground=verdict.near_ground(
                flights, self.rotor_radius, corrected=regression.GROUND_EFFECT in self.added
            ),
            omitted=omitted,
            drift=of.drift,
            mean_command=_mean_command(problem),
            sensitivities=misspecification.sensitivities(problem, estimate, flights),
            velocity=misspecification.velocity_spectrum(problem),
        )

    def traces(self, problem: VerticalFlights, estimate: Estimate) -> tuple[Trace, ...]:
        """Vertical acceleration without mean and line of each run."""
        columns = tuple(replace(item, instruments=item.instruments[:, :0]) for item in problem.columns)
        copied = replace(problem, columns=columns, noise=None)  # which keeps no rows
        rows, theta = copied.rows(estimate.nuisances), estimate.theta
        predicted, driven = rows.regressors @ theta, rows.regressors[:, 1] * theta[1]
        words = ("vertical acceleration", "m/s²", "K_u U − K z'", "K_u U")
        return (Trace(*words, rows.response, predicted, driven),)

    def view(self, flight: PreparedFlight) -> motion.FlightView:
        name = flight.input.name
        names = f"the mean of the mapped {name}" if len(flight.driving) > 1 else name
        timing = "behind a lag τ and a delay d"
        if flight.input.measured:
            timing = "measured; motion follows d later (below zero: their stamps are late)"
        of_terms = "".join(f"; {term.symbols}" for term in self.added if term.symbols)
        symbols = f"U = cos(tilt) × {names} (map: {flight.input_map}), {timing}{of_terms}"
        panels = [flight.plot_data("climb rate\n[m/s]", of="velocity_z", reference="reference_velocity_z")]
        if "position_z" in flight.recording.channels:
            height = on_grid(flight.recording.channel("position_z"), flight.grid)[0]
            reference = flight.reference_on_grid("reference_position_z")
            target = None if reference is None else flight.where_logged(reference, "reference_position_z")
            panels.insert(0, PlotData("height [m]", flight.where_logged(height, "position_z"), target))
        return motion.FlightView(symbols, tuple(panels))

    def _check(self, options: FlightOptions) -> None:
        regression.check_terms(options, self.rotor_radius)
        if options.input_map not in ("", FIT_MAP):
            input_map(options.input_map)

    def _for_flights(self, flights: motion.Flights, options: FlightOptions) -> Vertical:
        regression.check_flights(flights, options)
        added = tuple(regression.TERMS[word] for word in options.terms)
        radius = self.rotor_radius if options.rotor_radius is None else options.rotor_radius
        known = mean_voltage(flights) if self.mean_voltage is None else self.mean_voltage
        return replace(self, added=added, rotor_radius=radius, mean_voltage=known)

    def _of_vehicle(self, vehicle: str) -> Vertical:
        return replace(self, rotor_radius=load_vehicle(vehicle).rotor_radius)

    def _restored(self, record: object) -> Vertical:
        if record is None:
            return self
        known = record if isinstance(record, Mapping) else {}
        radius, volts = known.get("rotor_radius"), known.get("mean_voltage")
        if known and isinstance(radius, int | float | None) and isinstance(volts, int | float | None):
            return replace(self, rotor_radius=radius, mean_voltage=volts)
        remedy = "Identify the flight again with eivor identify --json."
        raise InputError("a result with rotor_radius and mean_voltage of its terms", f"{record!r}", remedy)
