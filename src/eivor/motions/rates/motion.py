"""The motion of the turning rates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from eivor.errors import InputError, MissingChannelError
from eivor.estimation.estimate import Estimate
from eivor.flights.grid import Active, Grid, airborne_by_log, on_grid
from eivor.flights.motion import (
    Abilities,
    Flights,
    FlightView,
    LogChannels,
    Motion,
    Prediction,
)
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import InputFamily, PreparedFlight, Selection, chosen_input
from eivor.flights.quantity import (
    PlotData,
    QuantityEstimate,
    Trace,
)
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import InstrumentRule
from eivor.motions.equation import (
    AxisEquation,
    Term,
    equation_prediction,
    equation_problem,
    equation_quantities,
    equation_traces,
    simple_models,
)
from eivor.motions.rates.verdict import (
    AXES,
    EQUATION,
    PARTS,
    PITCH,
    QUANTITIES,
    ROLL,
    RULES,
    THRUST,
    TORQUE,
    WORDS,
    Axis,
)
from eivor.signals.recording import ROTARY_WING, Channel, Finding, Recording
from eivor.tools import Float

# -- Equations --

#: Lags of each reference: how many, and their time constant [s]. Rates follow within a tenth of a second.
REFERENCE_LAGS = (4, 0.06)
#: Lags and delays to search [s]. A lag of 1/D with a damping of 1/tau turns the vehicle as a lag of tau with
#: a damping of D does, but for the gain. No rotor is as slow as damping is, which takes seconds: longer lags
#: are not searched.
LAGS_S = np.geomspace(0.004, 0.15, 30)
DELAYS_S = (0.0, 0.005, 0.010, 0.015, 0.020, 0.030)


def _equation(axis: Axis) -> AxisEquation:
    """P' = G u - D p, with the reaction J u' where the axis has one."""
    letter = "pqr"[axis.number]
    damping, effect, reaction = axis.damping, axis.effectiveness, axis.reaction
    terms = [
        Term(damping.name, f"-{axis.rate}", f"D_{letter}", damping.unit),
        Term(effect.name, axis.torque, f"G_{letter}", effect.unit, behind=True),
    ]
    if axis.reacts:
        terms.append(Term(reaction.name, f"ddt({axis.torque})", "J", reaction.unit, behind=True))
    return AxisEquation(
        axis.name,
        axis.torque,
        (f"ddt({axis.rate})",),
        tuple(terms),
        (f"{axis.name} acceleration", "rad/s²", "G u − D ω", "G u"),
        axis.references,
        REFERENCE_LAGS,
        (axis.rate, f"{axis.name} rate", "rad/s"),
    )


EQUATIONS = tuple(_equation(axis) for axis in AXES)


# -- Rate panel --


def rate_panel(flight: PreparedFlight, axis: Axis) -> PlotData:
    """Rate about one axis, and its setpoint where the log has one."""
    setpoint = flight.reference_on_grid(f"reference_{axis.rate}")
    measured = np.rad2deg(flight.signals.channel(axis.rate))
    return PlotData(
        f"{axis.name} rate\n[deg/s]", measured, None if setpoint is None else np.rad2deg(setpoint)
    )


# -- Select --

INPUTS = (InputFamily(TORQUE, numbered=False),)
REFERENCES = tuple(source for axis in AXES for source in axis.references)
#: Band of spectral rows [Hz], of rates that are logged fast; else up to this share of their rate.
BAND_HZ = (0.3, 8.0)
BAND_SHARE = 0.2
#: Steps of the grid [s], and from which rate of the gyroscope on the fine one is taken [Hz].
FINE_STEP_S, STEP_S, FINE_FROM_HZ = 0.005, 0.010, 95.0
#: What determines that a vehicle flies where no land detector is logged, by its mean.
LEVELS = ("input", "rotor_command", "rotor_speed")
#: No vehicle turns so fast; values beyond are in degrees a second [rad/s].
FASTEST_RATE = 40.0


def multirotor_input(
    log: Recording, families: tuple[InputFamily, ...], wanted: str, *, remedy: str, other: str
) -> tuple[InputFamily, tuple[Channel, ...]]:
    """Family and channels of the input of a multirotor, see `chosen_input`; others are refused."""
    if log.vehicle not in ("", ROTARY_WING):
        received = f"{log.name}, which says that it is of a {log.vehicle}"
        raise InputError("a log of a multirotor", received, other)
    return chosen_input(log, families, wanted, remedy=remedy)


def selected(log: Recording, options: FlightOptions) -> Selection:
    """Channels of a log by role."""
    family, _ = multirotor_input(
        log,
        INPUTS,
        options.input,
        remedy="Log the torque setpoints at 50 Hz or more",
        other="Rotors turn it by their thrust; name another motion with --model if you have one.",
    )
    for axis in (ROLL, PITCH):
        if axis.torque not in log.channels:
            needed = f"{axis.torque} in {log.name}"
            remedy = "Log the torque setpoints of roll and pitch."
            raise MissingChannelError(needed, "a log without it", remedy)
        log.channel(axis.rate)
    axes = [axis for axis in AXES if axis.torque in log.channels and axis.rate in log.channels]
    rates = {axis.name: log.channel(axis.rate) for axis in axes}
    for rate in rates.values():
        refuse_degrees(rate, log)
    slowest = min(rate.rate_hz for rate in rates.values())
    no_yaw = "Torque setpoint or rate of yaw is not logged: roll and pitch are looked at alone."
    return Selection(
        family,
        tuple(log.channel(axis.torque) for axis in axes),
        states=rates,
        responses={},
        band_hz=(BAND_HZ[0], min(BAND_HZ[1], BAND_SHARE * slowest)),
        findings=(Finding("no_yaw", no_yaw),) if len(axes) < len(AXES) else (),
        issued_within_s=float(np.median(np.diff(log.channel(ROLL.rate).time_s))),  # once a rate, or oftener
        step_s=FINE_STEP_S if slowest >= FINE_FROM_HZ else STEP_S,
        matched_interpolation_filter=True,
        active=active,
    )


def refuse_degrees(rate: Channel, log: Recording) -> None:
    """Refuse a rate that is faster than any vehicle turns."""
    fastest = float(np.nanmax(np.abs(rate.values), initial=0.0))
    usual = float(np.nanquantile(np.abs(rate.values), 0.99)) if rate.values.size else 0.0
    if usual > FASTEST_RATE:
        raise InputError(
            f"body rates in rad/s in {log.name}",
            f"{rate.name} up to {fastest:.3g}, which look like degrees",
            'State the unit in a channel map (unit = "deg/s").',
        )


def active(log: Recording, grid: Grid, _input_level: Float[np.ndarray, " n"], /) -> Active:
    """Samples in the air: torque setpoints do not identify, so by the land detector."""
    members = next((members for family in LEVELS if (members := log.family(family))), [])
    if not members and "landed" not in log.channels:
        why = "nothing: neither a land detector nor thrust is logged"
        return Active(np.ones(grid.count, dtype=np.bool_), why)
    level = (
        np.mean([on_grid(member, grid)[0] for member in members], axis=0) if members else np.ones(grid.count)
    )
    return airborne_by_log(log, grid, level)


def rates_std(flights: tuple[PreparedFlight, ...], axes: tuple[Axis, ...]) -> list[float]:
    """Standard deviation of the rate about each axis over the time used [deg/s]."""
    rates = [
        np.concatenate([flight.signals.channel(axis.rate)[flight.used] for flight in flights])
        for axis in axes
    ]
    return [float(np.rad2deg(np.std(rate))) for rate in rates]


# -- Motion --


def excitation(flights: Flights) -> str:
    """Standard deviations of the rates of roll and pitch."""
    roll, pitch = rates_std(flights, (ROLL, PITCH))
    return f"Roll turned at {roll:.2g} and pitch at {pitch:.2g} deg/s (standard deviations)."


@dataclass(frozen=True)
class Rates(Motion[LaggedRuns]):
    """p' = G u - D p + b about each axis, behind the lag of the actuators."""

    name = "rates"
    words = WORDS
    equation = EQUATION
    quantities = QUANTITIES
    rules = RULES
    parts = PARTS
    channels = LogChannels(
        INPUTS,
        (ROLL.rate, PITCH.rate),
        REFERENCES,
        parameters=(
            "IMU_GYRO_RATEMAX",
            "IMU_GYRO_CUTOFF",
            "IMU_DGYRO_CUTOFF",
            "MC_ROLLRATE_P",
            "MC_PITCHRATE_P",
            "MC_YAWRATE_P",
            "SYS_AUTOSTART",
            "CA_ROTOR_COUNT",
            "SDLOG_PROFILE",
        ),
        vehicle_parameters=("SYS_AUTOSTART", "THR_MDL_FAC", "CA_ROTOR_COUNT"),
    )
    abilities = Abilities(
        prediction=Prediction(simple_models, multi_step=partial(equation_prediction, EQUATIONS)),
        excitation=excitation,
        coupled_axes=(THRUST,),
    )

    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Rates and torque setpoints."""
        return selected(log, options)

    def problem(self, flights: Flights, rule: InstrumentRule) -> LaggedRuns:
        """Regressions of the flights for each lag and delay."""
        return equation_problem(EQUATIONS, flights, rule, lags_s=LAGS_S, delays_s=DELAYS_S)

    def derive(self, problem: LaggedRuns, estimate: Estimate) -> Mapping[str, QuantityEstimate]:
        """Parameters of the axes that are logged, and the lag."""
        return equation_quantities(QUANTITIES, problem, estimate)

    def traces(self, problem: LaggedRuns, estimate: Estimate) -> tuple[Trace, ...]:
        """Angular acceleration about each axis within the band."""
        return equation_traces(EQUATIONS, problem, estimate)

    def view(self, flight: PreparedFlight) -> FlightView:
        """What u is, and the rates of roll and pitch."""
        symbols = f"u = {flight.input.name} of each axis, behind a lag τ and a delay d that all share"
        return FlightView(symbols, tuple(rate_panel(flight, axis) for axis in (ROLL, PITCH)))
