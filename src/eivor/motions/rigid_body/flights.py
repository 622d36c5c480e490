"""A rigid body's flights: a separable problem with an equation for each axis of turning and of force.

Lag and delay of the rotors are shared by all. Every axis of every flight is whitened by itself, so that each
has the weight of its own noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.equation import Parameter
from eivor.models.instruments import InstrumentRule
from eivor.models.lagged_runs import (
    ACTUATOR_LAG,
    DELAY,
    AxisColumns,
    LaggedRuns,
    lag_and_delay,
    measured_state,
)
from eivor.models.separable import Nuisance, Prior, Values
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.body_velocity import NEEDED, body_velocity, force_by_velocity
from eivor.motions.rigid_body.instruments import AxisInstruments
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.motions.rigid_body.parameters import (
    ALONG,
    COUPLING,
    DAMPING,
    DRAG,
    FORCE_X,
    FORCE_Z,
    GAIN,
    LIFT,
    OFFSET,
    PITCH,
    REACTION,
    ROLL,
    THRUST,
    YAW,
)
from eivor.shapes import Float
from eivor.signals.actuator import actuator_state, shifted_by
from eivor.signals.derivative import time_derivative
from eivor.signals.input_map import input_map

#: Bands of spectral rows [Hz]: of turning, and of forces.
TURNING_BAND_HZ = (0.1, 20.0)
FORCE_BAND_HZ = (0.05, 8.0)
#: No band reaches beyond this share of the rate of what is measured.
BAND_SHARE = 0.2
#: Lags and delays to search [s].
LAGS_S = np.geomspace(0.005, 0.2, 24)
DELAYS_S = np.linspace(0.0, 0.03, 7)
#: Accuracy of both [s]: gains are wrong by 5 % for a delay that is wrong by a millisecond.
TOLERANCE_S = 3e-7


def searched_lag_and_delay(known: KnownNumber | None = None) -> tuple[Nuisance, Nuisance]:
    """Lag and delay of commands, both continuous; of a delay that is known, what is known of it [s]."""
    lag, delay = lag_and_delay(LAGS_S, DELAYS_S)
    if known is not None and not known.std:
        return replace(lag, tolerance=TOLERANCE_S), delay.known_at(known.value)
    if known is not None:
        delay = replace(delay, prior=Prior(known.value, known.std))
    return replace(lag, tolerance=TOLERANCE_S), replace(
        delay, discrete=False, halvings=0, tolerance=TOLERANCE_S
    )


@dataclass
class RotorStates:
    """What all axes ask of a flight's rotors; states at a lag and a delay are remembered for the next axis.

    Parameters
    ----------
    flight : PreparedFlight
        Of which log.
    layout : RotorLayout
        Where the rotors are.
    """

    flight: PreparedFlight
    layout: RotorLayout
    _last: tuple[tuple[float, float], Float[np.ndarray, "n rotors"], Float[np.ndarray, "n rotors"]] | None = (
        None
    )

    def at(
        self, lag_s: float, delay_s: float
    ) -> tuple[Float[np.ndarray, "n rotors"], Float[np.ndarray, "n rotors"]]:
        """States, and what thrust is a multiple of."""
        if self._last is None or self._last[0] != (lag_s, delay_s):
            state = self._moved(lag_s, delay_s)
            self._last = (lag_s, delay_s), state, input_map(self.flight.input_map)(state)
        return self._last[1:]

    @cached_property
    def across(self) -> Float[np.ndarray, " n"]:
        """Square of the velocity across the rotors."""
        return (self.hub_velocity[0] ** 2 + self.hub_velocity[1] ** 2).mean(axis=1)

    @cached_property
    def hub_velocity(self) -> tuple[Float[np.ndarray, "n rotors"], ...]:
        """Velocity through the air at each rotor; of turning alone where the vehicle's is not known."""
        signals = self.flight.signals
        velocity = body_velocity(signals)
        u, v, s = np.zeros((3, signals.sample_count, 1)) if velocity is None else velocity.T[:, :, None]
        p, q, r = (signals.channel(axis.rate)[:, None] for axis in AXES)
        x, y = -self.layout.pitch, self.layout.roll
        return u - r * y, v + r * x, s + p * y - q * x

    def _moved(self, lag_s: float, delay_s: float) -> Float[np.ndarray, "n rotors"]:
        signals, family = self.flight.signals, self.flight.input
        logged = signals.family(family.name)
        if family.measured:
            return shifted_by(logged, step_s=signals.step_s, delay_s=delay_s)
        return actuator_state(logged, step_s=signals.step_s, lag_s=lag_s, delay_s=delay_s)


@dataclass(frozen=True)
class RotorColumns:
    """Columns of what the rotors do to one axis, among those of all.

    Thrust and torque go with the map of a rotor's state; what a rotor drags through the air goes with its
    state and the air's velocity at its hub, (v_x - r y, v_y + r x, v_z + p y - q x). Drag and damping are
    for the state `usual`.

    Parameters
    ----------
    states : RotorStates
        Of a flight's rotors.
    axis : int
        Number of the equation.
    moving : tuple of Parameter
        Parameters of all moving columns.
    usual : float
        State of a rotor that drag and damping are told for.
    """

    states: RotorStates
    axis: int
    moving: tuple[Parameter, ...]
    usual: float

    def __call__(self, at: Values) -> Float[np.ndarray, "n m"]:
        """Columns at a lag and a delay; zeros for parameters of other equations."""
        state, thrust = self.states.at(at[ACTUATOR_LAG.name], at[DELAY.name])
        columns = np.zeros((len(self.moving), state.shape[0]))
        for parameter, values in self._of_axis(state, thrust).items():
            if parameter in self.moving:
                columns[self.moving.index(parameter)] = values
        return columns.T

    def _of_axis(
        self, state: Float[np.ndarray, "n rotors"], thrust: Float[np.ndarray, "n rotors"]
    ) -> dict[Parameter, Float[np.ndarray, " n"]]:
        layout, axis, count = self.states.layout, self.axis, self.states.layout.count
        hub = self.states.hub_velocity
        if axis >= FORCE_X:
            along = axis - FORCE_X
            found = {DRAG[along]: _summed(state, hub[along]) / (-self.usual * count)}
            if axis == FORCE_Z:
                found |= {THRUST: thrust.sum(axis=1), LIFT: self.states.across}
            return found
        x, y = -layout.pitch, layout.roll
        if axis == YAW:
            turned = _summed(state, x * hub[1] - y * hub[0]) / (-self.usual * float(x @ x + y @ y))
            spinning = time_derivative(state @ layout.yaw, self.states.flight.signals.step_s)
            return {GAIN[YAW]: thrust @ layout.yaw, REACTION: spinning, DAMPING[YAW]: turned}
        arms = (y, -x)[axis]
        inflow = _summed(state, arms * hub[2]) / (-self.usual * float(arms @ arms))
        return {GAIN[axis]: thrust @ arms, OFFSET[axis]: thrust.sum(axis=1), DAMPING[axis]: inflow}


def _summed(
    state: Float[np.ndarray, "n rotors"], velocity: Float[np.ndarray, "n rotors"]
) -> Float[np.ndarray, " n"]:
    """Sum of their products over the rotors."""
    return np.einsum("nr,nr->n", state, velocity)


def rigid_body_problem(
    flights: tuple[PreparedFlight, ...], layout: RotorLayout, rule: InstrumentRule
) -> LaggedRuns:
    """Regressions of the flights for each lag and delay.

    Parameters
    ----------
    flights : tuple of PreparedFlight
        All with runs.
    layout : RotorLayout
        Of their rotors.
    rule : InstrumentRule
        What serves as instruments.
    """
    terms, usual = _terms(flights), usual_state(flights)
    columns = tuple(
        one
        for number, flight in enumerate(flights)
        for one in _flight(number, flight, layout, rule, terms, usual)
    )
    measured = all(flight.input.measured for flight in flights)
    nuisances = measured_state() if measured else searched_lag_and_delay(layout.vehicle.delay)
    return LaggedRuns(columns, (*terms.fixed, *terms.moving), nuisances)


@dataclass(frozen=True)
class Terms:
    """What the equations of flights have, given what all of them logged.

    Parameters
    ----------
    forces : tuple of int
        Axes along which the specific force is known, from 0.
    velocity : bool
        The velocity on the body's axes is known.
    """

    forces: tuple[int, ...]
    velocity: bool

    @property
    def fixed(self) -> tuple[Parameter, ...]:
        """Parameters of the columns that stay."""
        return COUPLING

    @property
    def moving(self) -> tuple[Parameter, ...]:
        """Parameters of the columns that move with lag and delay."""
        drag = tuple(DRAG[along] for along in self.forces) if self.velocity else ()
        lift = (LIFT,) if self.velocity and 2 in self.forces else ()
        thrust = (THRUST,) if 2 in self.forces else ()
        return (*GAIN, *DAMPING, *OFFSET, REACTION, *thrust, *drag, *lift)


def _terms(flights: tuple[PreparedFlight, ...]) -> Terms:
    known = set.intersection(*(set(flight.signals.channels) for flight in flights))
    velocity = set(NEEDED) <= known
    forces = tuple(
        along
        for along, name in enumerate(ALONG)
        if f"specific_force_body_{name}" in known and (velocity or along == 2)
    )
    return Terms(forces, velocity)


def _flight(
    number: int,
    flight: PreparedFlight,
    layout: RotorLayout,
    rule: InstrumentRule,
    terms: Terms,
    usual: float,
) -> list[AxisColumns]:
    """Columns of every axis of a flight."""
    signals = flight.signals
    rates = np.column_stack([signals.channel(axis.rate) for axis in AXES])
    states, instruments = RotorStates(flight, layout), AxisInstruments(flight, rule)
    slowest = min(rate for role, rate in flight.rates_hz.items() if rate and role != "command")

    def columns(axis: int, responses: Float[np.ndarray, "n r"]) -> AxisColumns:
        staying = np.zeros((len(responses), len(terms.fixed)))
        if axis < FORCE_X:
            staying[:, axis] = rates[:, (axis + 1) % 3] * rates[:, (axis + 2) % 3]
        low, high = TURNING_BAND_HZ if axis < FORCE_X else FORCE_BAND_HZ
        return AxisColumns(
            signals.step_s,
            flight.runs,
            responses,
            staying,
            RotorColumns(states, axis, terms.moving, usual),
            instruments.of_axis(axis),
            number,
            axis,
            (low, min(high, BAND_SHARE * slowest)),
            flight.usable,
        )

    turning = [
        columns(axis, time_derivative(rates[:, axis], signals.step_s)[:, None]) for axis in (ROLL, PITCH, YAW)
    ]
    by_velocity = force_by_velocity(signals) if terms.velocity else None
    forces = []
    for along in terms.forces:
        measured = [signals.channel(f"specific_force_body_{ALONG[along]}")]
        if by_velocity is not None:
            measured.append(by_velocity[:, along])
        forces.append(columns(FORCE_X + along, np.column_stack(measured)))
    return [*turning, *forces]


def usual_state(flights: tuple[PreparedFlight, ...]) -> float:
    """State of a rotor that gives the mean thrust of flights."""
    chosen = input_map(flights[0].input_map)
    return chosen.inverse(float(np.mean([chosen(flight.used_input).mean() for flight in flights])))
