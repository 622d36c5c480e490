"""Equations of the rigid body: parameters, words, symbols and columns of their terms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.models.regression import Parameter
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.tools import Float

TURNING = ("roll", "pitch", "yaw")
ALONG = ("x", "y", "z")
#: Numbers of the equations: turning first, then the specific force along each axis.
ROLL_EQUATION, PITCH_EQUATION, YAW_EQUATION, FORCE_X_EQUATION = range(4)
FORCE_Z_EQUATION = 5
#: Axes along which a velocity turns the vehicle about each axis.
ALONG_OTHERS = ((1, 2), (0, 2), (0, 1))

COUPLING = tuple(Parameter(f"{name}_coupling", "") for name in TURNING)
DAMPING = tuple(Parameter(f"{name}_damping", "1/s") for name in TURNING)
DRAG = tuple(Parameter(f"drag_{name}", "1/s") for name in ALONG)
#: Of the body, which goes with the size of the velocity, beside what the rotors drag.
QUADRATIC_DRAG = tuple(Parameter(f"quadratic_drag_{name}", "1/m") for name in ALONG)
#: Of the linear and the quadratic drag along z together, at the speeds of a flight.
FRICTION = Parameter("viscous_friction", "1/s")
LIFT = Parameter("translational_lift", "1/m")
#: What the lift of rotors that meet unequal air turns: k_h / I, which is h alpha_p / (N alpha_z) of N rotors.
LIFT_MOMENT = (Parameter("roll_by_lift", "1/m^3"), Parameter("pitch_by_lift", "1/m^3"))
#: What drag beside the centre of mass turns: of each axis, by the velocities along the other two.
DRAG_MOMENT = tuple(
    tuple(Parameter(f"{name}_by_drag_{ALONG[along]}", "1/(m s)") for along in others)
    for name, others in zip(TURNING, ALONG_OTHERS, strict=True)
)
ALL_DRAG_MOMENTS = tuple(item for pair in DRAG_MOMENT for item in pair)
#: Of rotors that spin: J / Ixx and J / Iyy.
GYROSCOPIC_MOMENT = (Parameter("roll_by_spin", ""), Parameter("pitch_by_spin", ""))
GAIN = tuple(
    Parameter(f"{name}_gain", unit)
    for name, unit in zip(TURNING, ("rad/s^2/m", "rad/s^2/m", "rad/s^2"), strict=True)
)
OFFSET = (Parameter("roll_offset", "rad/s^2"), Parameter("pitch_offset", "rad/s^2"))
REACTION = Parameter("rotor_reaction", "")
THRUST = Parameter("thrust_gain", "m/s^2")


@dataclass(frozen=True, slots=True)
class RotorSums:
    """Sums over the rotors, see `KnownVehicle.sums`."""

    state: Float[np.ndarray, "7 n"]
    thrust: Float[np.ndarray, "7 n"]
    spin_up: Float[np.ndarray, " n"]  # Derivative in time of the states with their spins


@dataclass(frozen=True)
class BodyMotion:
    """Rotors, velocity through the air and rates on the body's axes, at samples or starts."""

    vehicle: KnownVehicle
    usual: float  # State of a rotor for which damping and drag are
    rotors: RotorSums
    velocity: Float[np.ndarray, "3 n"]
    rates: Float[np.ndarray, "3 n"]

    def dragged(self, axis: int) -> Float[np.ndarray, " n"]:
        """Sum over the rotors of usual states times the velocity at each: along an axis, or about one."""
        total, x, y, xx, xy, yy, _ = self.rotors.state / self.usual
        (u, v, w), (p, q, r) = self.velocity, self.rates
        if axis == ROLL_EQUATION:
            return w * y + p * yy - q * xy
        if axis == PITCH_EQUATION:
            return q * xx - p * xy - w * x
        if axis == YAW_EQUATION:
            return v * x - u * y + r * (xx + yy)
        if axis == FORCE_Z_EQUATION:
            return w * total + p * y - q * x
        return u * total - r * y if axis == FORCE_X_EQUATION else v * total + r * x

    @cached_property
    def across(self) -> Float[np.ndarray, "rotors n"]:
        """Square of the velocity across each rotor [(m/s)^2]."""
        x, y, yaw_rate = -self.vehicle.pitch, self.vehicle.roll, self.rates[2]
        forward, left = self.velocity[0] - np.outer(y, yaw_rate), self.velocity[1] + np.outer(x, yaw_rate)
        return forward**2 + left**2

    def gyroscopic(self, axis: int) -> Float[np.ndarray, " n"]:
        """What rotors that spin turn about x or y, but for their inertia over the body's."""
        spin, (p, q, _) = self.rotors.state[6], self.rates
        return q * spin if axis == ROLL_EQUATION else -p * spin


@dataclass(frozen=True)
class RigidTerm:
    """A parameter times a column, in one equation."""

    parameter: Parameter
    words: str
    symbol: str
    equation: int
    index: int  # Among the terms of its kind
    formula: Callable[[BodyMotion, int], Float[np.ndarray, " n"]]
    moves: bool = True  # With lag and delay
    driving: bool = False  # What the rotors do by themselves
    by_velocity: bool = False  # Only where the velocity on the body's axes is known

    def column(self, of: BodyMotion) -> Float[np.ndarray, " n"]:
        """Its column at samples or starts."""
        return self.formula(of, self.index)


def _terms(
    parameters: Iterable[Parameter],
    words: str,
    symbols: str,
    equations: Iterable[int],
    formula: Callable[[BodyMotion, int], Float[np.ndarray, " n"]],
    *,
    moves: bool = True,
    driving: bool = False,
    by_velocity: bool = False,
) -> Iterator[RigidTerm]:
    """Terms of one kind; `words` hold the name of what an equation is of."""
    rows = zip(parameters, symbols.split(), equations, strict=True)
    for index, (parameter, symbol, equation) in enumerate(rows):
        named = words.format((*TURNING, *ALONG)[equation], along=parameter.name[-1])
        yield RigidTerm(parameter, named, symbol, equation, index, formula, moves, driving, by_velocity)


def _rolled(of: BodyMotion) -> tuple[Float[np.ndarray, " n"], ...]:
    """Thrusts with the arms by which they turn about each axis."""
    thrust = of.rotors.thrust
    return thrust[2], -thrust[1], thrust[6]


def _damped(of: BodyMotion, axis: int) -> Float[np.ndarray, " n"]:
    _, _, _, xx, _, yy, _ = of.vehicle.sums.sum(axis=1).tolist()
    return -of.dragged(axis) / (yy, xx, xx + yy)[axis]


def _drag_moment(of: BodyMotion, index: int) -> Float[np.ndarray, " n"]:
    """Mean of the velocities at the rotors."""
    along = ALONG_OTHERS[index // 2][index % 2]
    return of.dragged(FORCE_X_EQUATION + along) / of.vehicle.count


_TILTING, _AXES, _FORCES = range(2), range(3), range(3, 6)
#: Terms of all equations, those first that no lag moves.
TERMS = (
    *_terms(
        COUPLING,
        "{} coupling",
        "β_1 β_2 β_3",
        _AXES,
        lambda of, axis: of.rates[(axis + 1) % 3] * of.rates[(axis + 2) % 3],
        moves=False,
    ),
    *_terms(
        QUADRATIC_DRAG,
        "quadratic drag along {}",
        "c_x c_y c_z",
        _FORCES,
        lambda of, along: -np.linalg.norm(of.velocity, axis=0) * of.velocity[along],
        moves=False,
        by_velocity=True,
    ),
    *_terms(
        LIFT_MOMENT,
        "{} by lift",
        "h_p h_q",
        _TILTING,
        lambda of, axis: (of.vehicle.roll, of.vehicle.pitch)[axis] @ of.across,
        moves=False,
        by_velocity=True,
    ),
    *_terms(GAIN, "{} gain", "α_p α_q α_r", _AXES, lambda of, axis: _rolled(of)[axis], driving=True),
    *_terms(DAMPING, "{} damping", "d_p d_q d_r", _AXES, _damped),
    *_terms(OFFSET, "{} offset", "o_p o_q", _TILTING, lambda of, _: of.rotors.thrust[0], driving=True),
    *_terms([REACTION], "rotor reaction", "j", [2], lambda of, _: of.rotors.spin_up, driving=True),
    *_terms(GYROSCOPIC_MOMENT, "{} by spin", "j_p j_q", _TILTING, BodyMotion.gyroscopic),
    *_terms(
        ALL_DRAG_MOMENTS,
        "{} by drag along {along}",
        "L_y L_z M_x M_z N_x N_y",
        (0, 0, 1, 1, 2, 2),
        _drag_moment,
        by_velocity=True,
    ),
    *_terms([THRUST], "thrust gain", "α_z", [5], lambda of, _: of.rotors.thrust[0], driving=True),
    *_terms(
        DRAG,
        "drag along {}",
        "d_x d_y d_z",
        _FORCES,
        lambda of, along: -of.dragged(FORCE_X_EQUATION + along) / of.vehicle.count,
    ),
    *_terms([LIFT], "translational lift", "h", [5], lambda of, _: of.across.mean(axis=0), by_velocity=True),
)
#: Parameters of what the rotors drive.
DRIVING = tuple(term.parameter for term in TERMS if term.driving)
