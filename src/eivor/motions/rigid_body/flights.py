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
from eivor.motions.rigid_body.across import lift_moments, squares_across
from eivor.motions.rigid_body.beside import ALL_DRAG_MOMENTS, ALONG_OTHERS, spin_moment
from eivor.motions.rigid_body.body_velocity import NEEDED, body_velocity, force_by_velocity, swift_velocity
from eivor.motions.rigid_body.inertia_ratios import InertiaRatios
from eivor.motions.rigid_body.inferred_velocity import FROM_HZ as INFERRED_FROM_HZ
from eivor.motions.rigid_body.inferred_velocity import inferred_velocity
from eivor.motions.rigid_body.instruments import AxisInstruments, Columns
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.motions.rigid_body.onboard_filters import OnboardFilter, as_logged, onboard_filter
from eivor.motions.rigid_body.parameters import (
    ALONG,
    COUPLING,
    DAMPING,
    DRAG,
    DRAG_MOMENT,
    FORCE_X,
    FORCE_Z,
    GAIN,
    LIFT,
    LIFT_MOMENT,
    MOVING,
    OFFSET,
    PITCH,
    QUADRATIC_DRAG,
    REACTION,
    ROLL,
    SPIN_MOMENT,
    THRUST,
    YAW,
)
from eivor.motions.rigid_body.steps import before, change_over_step, mean_over_step
from eivor.shapes import Float
from eivor.signals.actuator import actuator_state, shifted_by
from eivor.signals.input_map import input_map

#: Bands of spectral rows [Hz]: of turning, and of forces.
TURNING_BAND_HZ = (0.05, 20.0)
FORCE_BAND_HZ = (0.05, 8.0)
#: No band reaches beyond this share of the rate of what is measured.
BAND_SHARE = 0.2
#: Lags and delays that a search begins with [s]: in a band up to 20 Hz neighbours differ by little.
LAGS_S = np.geomspace(0.005, 0.2, 12)
DELAYS_S = np.linspace(0.0, 0.03, 4)
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


@dataclass(frozen=True, slots=True)
class RotorSums:
    """Sums over a flight's rotors, see `RotorLayout.sums`.

    Parameters
    ----------
    state, thrust : ndarray, shape (7, n)
        Of their states, and of what thrust goes with, at each sample.
    mean_thrust : ndarray, shape (7, n)
        The latter's mean over the step that ends there.
    """

    state: Float[np.ndarray, "7 n"]
    thrust: Float[np.ndarray, "7 n"]
    mean_thrust: Float[np.ndarray, "7 n"]


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
    _last: tuple[tuple[float, float], RotorSums] | None = None

    def at(self, lag_s: float, delay_s: float) -> RotorSums:
        """Sums over the rotors at a lag and a delay."""
        if self._last is None or self._last[0] != (lag_s, delay_s):
            thrust_of, weights = input_map(self.flight.input_map), self.layout.sums
            half_s = 0.5 * self.flight.signals.step_s
            state, between = (self._moved(lag_s, delay_s + later) for later in (0.0, half_s))
            thrust, halfway = (weights @ thrust_of(one).T for one in (state, between))
            # Simpson's rule: a rotor follows its command smoothly within a step
            mean = (before(thrust) + 4.0 * halfway + thrust) / 6.0
            self._last = (lag_s, delay_s), RotorSums(weights @ state.T, thrust, mean)
        return self._last[1]

    @cached_property
    def across(self) -> Float[np.ndarray, " n"]:
        """Square of the velocity across the rotors, its mean over them."""
        return squares_across(self.layout, self.velocity, self.rates[2]).mean(axis=0)

    @cached_property
    def rates(self) -> Float[np.ndarray, "3 n"]:
        """Body rates."""
        return np.stack([self.flight.signals.channel(axis.rate) for axis in AXES])

    @cached_property
    def velocity(self) -> Float[np.ndarray, "3 n"]:
        """Velocity through the air on the body's axes; zero where it is not known, nor can be inferred."""
        found = body_velocity(self.flight.signals)
        if found is not None:
            return np.ascontiguousarray(found.T)
        unknown, along_z = np.zeros_like(self.rates), inferred_velocity(self.flight.signals, self.flight.runs)
        unknown[2] = 0.0 if along_z is None else along_z
        return unknown

    @cached_property
    def _logged(self) -> Float[np.ndarray, "n rotors"]:
        """What was logged of the rotors, each rotor's values side by side in memory."""
        return np.asfortranarray(self.flight.signals.family(self.flight.input.name))

    def _moved(self, lag_s: float, delay_s: float) -> Float[np.ndarray, "n rotors"]:
        step_s = self.flight.signals.step_s
        if self.flight.input.measured:
            return shifted_by(self._logged, step_s=step_s, delay_s=delay_s)
        return actuator_state(self._logged, step_s=step_s, lag_s=lag_s, delay_s=delay_s)


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
    one_spin : InertiaRatios, optional
        By which rotors that spin turn all axes with one inertia; see `eivor.motions.rigid_body.one_spin`.
    """

    states: RotorStates
    axis: int
    moving: tuple[Parameter, ...]
    usual: float
    one_spin: InertiaRatios | None = None

    def __call__(self, at: Values) -> Float[np.ndarray, "n k"]:
        """Columns at a lag and a delay, of the parameters of this equation."""
        found = self._of_axis(self.states.at(at[ACTUATOR_LAG.name], at[DELAY.name]))
        own = {one: found[one] for one in (self.moving[place] for place in self.places)}
        return np.stack(list(as_logged(own, self.axis, self._sensor).values())).T

    @cached_property
    def places(self) -> tuple[int, ...]:
        """Places of this equation's parameters among those of all moving columns."""
        own = {*MOVING[self.axis], REACTION} if self._spun_alike else {*MOVING[self.axis]}
        return tuple(place for place, one in enumerate(self.moving) if one in own)

    @property
    def _spun_alike(self) -> bool:
        """Whether the rotors' inertia turns this axis as one with that of yaw."""
        return self.one_spin is not None and self.axis in (ROLL, PITCH)

    @cached_property
    def _sensor(self) -> OnboardFilter | None:
        return onboard_filter(self.states.flight, self.states.layout.vehicle, self.axis)

    def _of_axis(self, sums: RotorSums) -> dict[Parameter, Float[np.ndarray, " n"]]:
        axis, (count, _, _, xx, _, yy, _) = self.axis, self.states.layout.sums.sum(axis=1).tolist()
        dragged = -dragged_by(axis, sums.state, self.states.velocity, self.states.rates) / self.usual
        if axis >= FORCE_X:
            return {
                DRAG[axis - FORCE_X]: dragged / count,
                THRUST: sums.thrust[0],
                LIFT: self.states.across,
            }
        damped, mean = mean_over_step(dragged), sums.mean_thrust
        beside = self._beside(sums)
        if axis == YAW:
            spinning = change_over_step(sums.state[6], self.states.flight.signals.step_s)
            return {GAIN[YAW]: mean[6], REACTION: spinning, DAMPING[YAW]: damped / (xx + yy), **beside}
        arms, square = ((mean[2], yy), (-mean[1], xx))[axis]
        spinning = mean_over_step(spin_moment(axis, self.states.rates, sums.state[6]))
        return {
            GAIN[axis]: arms,
            OFFSET[axis]: mean[0],
            DAMPING[axis]: damped / square,
            **self._spun(spinning),
            **beside,
        }

    def _spun(self, spinning: Float[np.ndarray, " n"]) -> dict[Parameter, Float[np.ndarray, " n"]]:
        """What rotors that spin turn about roll or pitch, by the parameter that it goes with."""
        if self.one_spin is None:
            return {SPIN_MOMENT[self.axis]: spinning}
        return {REACTION: self.one_spin.of_axis(self.axis) * spinning}

    def _beside(self, sums: RotorSums) -> dict[Parameter, Float[np.ndarray, " n"]]:
        """What drag beside the centre of mass turns: the means of the velocities at the rotors."""
        states, found = self.states, {}
        for parameter, along in zip(DRAG_MOMENT[self.axis], ALONG_OTHERS[self.axis], strict=True):
            dragged = dragged_by(FORCE_X + along, sums.state, states.velocity, states.rates)
            found[parameter] = mean_over_step(dragged) / (states.layout.count * self.usual)
        return found


def dragged_by(
    axis: int,
    state: Float[np.ndarray, "7 n"],
    velocity: Float[np.ndarray, "3 n"],
    rates: Float[np.ndarray, "3 n"],
) -> Float[np.ndarray, " n"]:
    """Sum over the rotors of state times the velocity at each: along an axis, or its moment about one.

    Parameters
    ----------
    axis : int
        Number of the equation.
    state : ndarray, shape (7, n)
        Sums over the rotors, see `RotorLayout.sums`.
    velocity, rates : ndarray, shape (3, n)
        Of the body through the air, on its own axes.
    """
    total, x, y, xx, xy, yy, _ = state
    (u, v, w), (p, q, r) = velocity, rates
    if axis == ROLL:
        return w * y + p * yy - q * xy
    if axis == PITCH:
        return q * xx - p * xy - w * x
    if axis == YAW:
        return v * x - u * y + r * (xx + yy)
    if axis == FORCE_Z:
        return w * total + p * y - q * x
    return u * total - r * y if axis == FORCE_X else v * total + r * x


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
        The velocity on the body's axes is known; else that along z is inferred.
    """

    forces: tuple[int, ...]
    velocity: bool

    @property
    def fixed(self) -> tuple[Parameter, ...]:
        """Parameters of the columns that stay."""
        body = tuple(QUADRATIC_DRAG[along] for along in self.forces) if self.velocity else ()
        return (*COUPLING, *body, *(LIFT_MOMENT if self.velocity else ()))

    @property
    def moving(self) -> tuple[Parameter, ...]:
        """Parameters of the columns that move with lag and delay."""
        drag = tuple(DRAG[along] for along in self.forces)
        lift = (LIFT,) if self.velocity and 2 in self.forces else ()
        thrust = (THRUST,) if 2 in self.forces else ()
        beside = (*SPIN_MOMENT, *(ALL_DRAG_MOMENTS if self.velocity else ()))
        return (*GAIN, *DAMPING, *OFFSET, REACTION, *beside, *thrust, *drag, *lift)

    @property
    def told_by_lags(self) -> tuple[Parameter, ...]:
        """Those of them whose columns are instruments at several lags."""
        return tuple(one for one in self.moving if one not in {*SPIN_MOMENT, *ALL_DRAG_MOMENTS})


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
    states, instruments = RotorStates(flight, layout), AxisInstruments(flight, layout, rule)
    slowest = min(rate for role, rate in flight.rates_hz.items() if rate and role != "command")

    def columns(axis: int, responses: Float[np.ndarray, "n r"]) -> AxisColumns:
        staying = np.zeros((len(responses), len(terms.fixed)))
        for parameter, one in _staying(axis, terms, states).items():
            staying[:, terms.fixed.index(parameter)] = one
        low, high = TURNING_BAND_HZ if axis < FORCE_X else FORCE_BAND_HZ
        if axis >= FORCE_X and not terms.velocity:
            low = INFERRED_FROM_HZ
        moving = RotorColumns(states, axis, terms.moving, usual)

        def columns_of(other: PreparedFlight) -> Columns:
            return replace(moving, states=RotorStates(other, layout), moving=terms.told_by_lags)

        return AxisColumns(
            signals.step_s,
            flight.runs,
            responses,
            staying,
            moving,
            instruments.of_axis(axis, columns_of),
            number,
            axis,
            (low, min(high, BAND_SHARE * slowest)),
            flight.usable,
            moving.places,
        )

    changes = change_over_step(states.rates, signals.step_s)
    turning = [columns(axis, changes[axis][:, None]) for axis in (ROLL, PITCH, YAW)]
    by_velocity = force_by_velocity(signals) if terms.velocity else None
    forces = []
    for along in terms.forces:
        measured = [signals.channel(f"specific_force_body_{ALONG[along]}")]
        if by_velocity is not None:
            sensor = onboard_filter(flight, layout.vehicle, FORCE_X + along)
            measured.append(_behind(sensor, by_velocity[:, along]))
        forces.append(columns(FORCE_X + along, np.column_stack(measured)))
    return [*turning, *forces]


def _staying(axis: int, terms: Terms, states: RotorStates) -> dict[Parameter, Float[np.ndarray, " n"]]:
    """Columns of an equation that no lag moves."""
    layout, velocity, rates = states.layout, states.velocity, states.rates
    if axis >= FORCE_X:
        if not terms.velocity:
            return {}
        swift = -swift_velocity(velocity.T)[:, axis - FORCE_X]
        sensor = onboard_filter(states.flight, layout.vehicle, axis)
        return {QUADRATIC_DRAG[axis - FORCE_X]: _behind(sensor, swift)}
    found = {COUPLING[axis]: rates[(axis + 1) % 3] * rates[(axis + 2) % 3]}
    if terms.velocity and axis != YAW:
        found[LIFT_MOMENT[axis]] = lift_moments(layout, velocity, rates[YAW])[axis]
    return {parameter: mean_over_step(one) for parameter, one in found.items()}


def _behind(sensor: OnboardFilter | None, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """A column behind a sensor's filter, where one is known."""
    return column if sensor is None else sensor(column)


def usual_state(flights: tuple[PreparedFlight, ...]) -> float:
    """State of a rotor that gives the mean thrust of flights."""
    chosen = input_map(flights[0].input_map)
    return chosen.inverse(float(np.mean([chosen(flight.used_input).mean() for flight in flights])))
