"""The identified equations as they carry a flight's state on, of the rotors' commands alone.

    p' = driven_p + beta_1 q r - d_p sum of what each rotor's inflow does,  q', r' alike
    v' = R (driven - drag + lift) - g e3,   x' = v,   attitude' = attitude (0, w)/2

"driven" is what the rotors' states do by gains, offsets and the reaction of yaw, and the trim of the run. The
states go as in `eivor.motions.rigid_body.dynamics`, the columns as in `RotorColumns`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.flights.ahead import Starts, trim
from eivor.flights.prepared import PreparedFlight
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import Values
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.across import lift_moments
from eivor.motions.rigid_body.beside import drag_moments, spin_moment
from eivor.motions.rigid_body.dynamics import BODY, Triple, into_body, rotation
from eivor.motions.rigid_body.flights import RotorStates, RotorSums, dragged_by, usual_state
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.motions.rigid_body.logged_state import LoggedState
from eivor.motions.rigid_body.parameters import (
    COUPLING,
    DAMPING,
    DRAG,
    DRAG_MOMENT,
    GAIN,
    LIFT,
    LIFT_MOMENT,
    OFFSET,
    QUADRATIC_DRAG,
    REACTION,
    SPIN_MOMENT,
    THRUST,
    YAW,
)
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float, Int
from eivor.signals.derivative import time_derivative


@dataclass(frozen=True)
class CarriedBody:
    """Rates of change of a body's state at the samples of a flight.

    Parameters
    ----------
    flight : PreparedFlight
        With the rotors' commands, or their speeds.
    layout : RotorLayout
        Of the rotors.
    values : mapping of str to float
        Parameters and nuisances; what is missing is zero. Drag and damping are told for the mean state of
        the flights that they come from, and count here for that of this flight: one vehicle hovers in both.
    logged : LoggedState
        What is known of the flight's state.
    starts : Starts
        Where predictions start.
    turns : tuple of bool
        Axes that the rotors turn; the rate of others stays.
    lifts : bool
        Whether thrust is known; else the velocity stays.
    """

    flight: PreparedFlight
    layout: RotorLayout
    values: Values
    logged: LoggedState
    starts: Starts
    turns: tuple[bool, ...]
    lifts: bool

    def __call__(
        self, body: Float[np.ndarray, "13 starts"], now: Int[np.ndarray, " starts"]
    ) -> Float[np.ndarray, "13 starts"]:
        """Rate of change of states side by side at samples, driven by what the rotors do there."""
        w, x, y, z, p, q, r = body[6:BODY]
        rows = rotation(w, x, y, z)
        turning, force = self._of_axes(body, rows, self._states[:, now])
        driven = self._forces[:, now]
        change = np.zeros_like(body)
        change[0:3] = body[3:6]
        if self.lifts and self.logged.moves:
            fx, fy, fz = (one + driven[3 + along] for along, one in enumerate(force))
            for row, (a, b, c) in enumerate(rows):
                change[3 + row] = a * fx + b * fy + c * fz
            change[5] -= GRAVITY
        change[6] = -0.5 * (x * p + y * q + z * r)
        change[7] = 0.5 * (w * p + y * r - z * q)
        change[8] = 0.5 * (w * q + z * p - x * r)
        change[9] = 0.5 * (w * r + x * q - y * p)
        for axis, turned in enumerate(self.turns):
            if turned:
                change[10 + axis] = turning[axis] + driven[axis]
        return change

    def _of_axes(
        self,
        body: Float[np.ndarray, "13 starts"],
        rows: tuple[Triple, Triple, Triple],
        sums: Float[np.ndarray, "7 starts"],
    ) -> tuple[Triple, Triple]:
        """What coupling and damping do to the rates, drag and lift to the velocity.

        Sums over the rotors of n, or of n times an arm, times the velocity at the hub, which is linear in
        the velocity of the body and in its rates: by the moments of n.
        """
        p, q, r = body[10:13]
        velocity = np.zeros_like(body[3:6])
        if self.logged.moves:
            velocity[:] = into_body(rows, body[3], body[4], body[5])
        dragged = [
            -share * dragged_by(axis, sums, velocity, body[10:13])
            for axis, share in enumerate(self._dragging)
        ]
        products = (q * r, p * r, p * q)
        beside = self._beside(velocity, body[10:13], sums[6])
        turning = [
            beta * product + drag + moment
            for beta, product, drag, moment in zip(self._coupling, products, dragged[:3], beside, strict=True)
        ]
        u, v, _ = velocity
        x, y = -self.layout.pitch, self.layout.roll
        around = r * r * float(np.mean(x * x + y * y)) + 2.0 * r * (v * float(x.mean()) - u * float(y.mean()))
        lift = self._value(LIFT.name) * (u * u + v * v + around)
        swiftness = np.sqrt((velocity * velocity).sum(axis=0))
        fx, fy, fz = (
            drag - self._value(one.name) * swiftness * along
            for drag, one, along in zip(dragged[3:], QUADRATIC_DRAG, velocity, strict=True)
        )
        return (turning[0], turning[1], turning[2]), (fx, fy, fz + lift)

    def _beside(
        self,
        velocity: Float[np.ndarray, "3 starts"],
        rates: Float[np.ndarray, "3 starts"],
        spin: Float[np.ndarray, " starts"],
    ) -> list[Float[np.ndarray, " starts"]]:
        """What drag beside the centre of mass, lift and rotors that spin do to the rates."""
        found = [
            sum(self._value(one.name) * part for one, part in zip(pair, parts, strict=True))
            for pair, parts in zip(
                DRAG_MOMENT, (drag_moments(axis, velocity) for axis in range(3)), strict=True
            )
        ]
        lifted = lift_moments(self.layout, velocity, rates[YAW])
        for axis, (lift, spinning) in enumerate(zip(LIFT_MOMENT, SPIN_MOMENT, strict=True)):
            found[axis] = (
                found[axis]
                + self._value(lift.name) * lifted[axis]
                + self._value(spinning.name) * spin_moment(axis, rates, spin)
            )
        return found

    @cached_property
    def _coupling(self) -> tuple[float, ...]:
        return tuple(self._value(one.name) for one in COUPLING)

    @cached_property
    def _dragging(self) -> tuple[float, ...]:
        """Damping and drag for rotors whose state is 1."""
        count, _, _, xx, _, yy, _ = self.layout.sums.sum(axis=1).tolist()
        squares = (yy, xx, xx + yy, count, count, count)
        return tuple(
            self._value(one.name) / (self._usual * square)
            for one, square in zip((*DAMPING, *DRAG), squares, strict=True)
        )

    def _value(self, name: str) -> float:
        return self.values.get(name, 0.0)

    @cached_property
    def _usual(self) -> float:
        return usual_state((self.flight,))

    @cached_property
    def _rotors(self) -> RotorSums:
        """Sums over the rotors."""
        lag_s, delay_s = self.values[ACTUATOR_LAG.name], self.values[DELAY.name]
        return RotorStates(self.flight, self.layout).at(lag_s, delay_s)

    @cached_property
    def _states(self) -> Float[np.ndarray, "7 n"]:
        """Sums of the rotors' states over each step."""
        return self.starts.over_step(self._rotors.state)

    @cached_property
    def _forces(self) -> Float[np.ndarray, "6 n"]:
        """What the rotors do to each axis over each step."""
        return self.starts.over_step(self._driven)

    @cached_property
    def _driven(self) -> Float[np.ndarray, "6 n"]:
        """What the rotors do to each axis, with the trims of the runs."""
        step_s = self.flight.signals.step_s
        state, thrust = self._rotors.state, self._rotors.thrust
        driven = np.zeros((6, state.shape[1]))
        for axis, arms in enumerate((thrust[2], -thrust[1], thrust[6])):
            driven[axis] = self._value(GAIN[axis].name) * arms
        for axis, offset in enumerate(OFFSET):
            driven[axis] += self._value(offset.name) * thrust[0]
        driven[2] += self._value(REACTION.name) * time_derivative(state[6], step_s)
        driven[5] = self._value(THRUST.name) * thrust[0]
        body = self.logged.body
        rows = rotation(body[6], body[7], body[8], body[9])
        turning, force = self._of_axes(body, rows, state)
        for axis, one in enumerate(AXES):
            slope = time_derivative(self.flight.signals.channel(one.rate), step_s)
            driven[axis] += trim(self.flight, slope - turning[axis] - driven[axis])
        if self.logged.moves:
            world = np.stack([time_derivative(one, step_s) for one in body[3:6]])
            felt = into_body(rows, world[0], world[1], world[2] + GRAVITY)
            for along in range(3):
                driven[3 + along] += trim(self.flight, felt[along] - force[along] - driven[3 + along])
        return driven
