"""Dynamics of the rigid body: coefficients and effective parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, TypeAlias

import numpy as np

from eivor.errors import UsageError
from eivor.motions.rigid_body.vehicle import Vehicle
from eivor.signals.filters import time_derivative
from eivor.signals.recording import GRAVITY
from eivor.tools import Float

#: A number of one flight, or those of several, or of several samples.
Value: TypeAlias = float | Float[np.ndarray, "..."]
#: Where a rotor is, three components, and its spin; or all rotors as arrays of shape (rotors, flights).
Place: TypeAlias = tuple[Value, Value, Value, Value]


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Every number of the equations of motion; see `Vehicle` and `Rotors` for what they mean."""

    gyroscopic: bool
    weight_acceleration: float  # g [m/s^2]
    mass: Value  # shape (flights,), [kg]
    inertia: tuple[Value, ...]  # [kg m^2 and its inverse]
    inverse_inertia: tuple[Value, ...]  # [kg m^2 and its inverse]
    places: tuple[Place, ...]  # Position [m] and spin of each rotor
    thrust_linear: Value  # shape (flights,)
    thrust_quadratic: Value  # shape (flights,)
    torque_ratio: Value  # shape (flights,)
    rotor_inertia: Value  # shape (flights,)
    rate_up: Value  # shape (flights,), [1/s]
    rate_down: Value  # shape (flights,), [1/s]
    drag: Value  # shape (flights,)
    inflow: Value  # shape (flights,)
    translational_lift: Value  # shape (flights,)
    flapping: Value  # shape (flights,)
    body: tuple[tuple[Value, ...], ...]  # Linear, quadratic and rotational drag along or about each axis


#: Coefficients that rotors hold under the same name.
OF_ROTORS = (
    *("thrust_linear", "thrust_quadratic", "torque_ratio"),
    *("drag", "inflow", "translational_lift", "flapping"),
)


def coefficients_of(vehicle: Vehicle, gravity: float = GRAVITY) -> Coefficients:
    """Coefficients of one vehicle, all of them floats."""
    rotors, drag, matrix = vehicle.rotors, vehicle.drag, vehicle.inertia_matrix
    places = zip(rotors.positions, rotors.spins, strict=True)
    return Coefficients(
        gyroscopic=rotors.inertia > 0.0,
        weight_acceleration=gravity,
        mass=vehicle.mass,
        inertia=elements(matrix),
        inverse_inertia=elements(np.linalg.solve(matrix, np.eye(3))),
        places=tuple((x, y, z, float(spin)) for (x, y, z), spin in places),
        rotor_inertia=rotors.inertia,
        rate_up=1.0 / rotors.lag_up,
        rate_down=1.0 / rotors.lag_down,
        body=(drag.linear, drag.quadratic, drag.rotational),
        **{name: getattr(rotors, name) for name in OF_ROTORS},
    )


def side_by_side(vehicles: Sequence[Vehicle], gravity: float = GRAVITY) -> Coefficients:
    """Coefficients of several vehicles as arrays, or of one for arrays of any length."""
    counts = sorted({vehicle.rotors.count for vehicle in vehicles})
    if len(counts) != 1:
        raise UsageError("vehicles with equally many rotors", f"{counts} rotors", "Simulate them separately.")
    coefficients = [coefficients_of(vehicle, gravity) for vehicle in vehicles]
    # (rotors, 4, flights): of every rotor position and spin
    positions = np.array([item.places for item in coefficients]).transpose(1, 2, 0)
    x, y, z, spin = (np.ascontiguousarray(positions[:, part]) for part in range(4))
    return stacked(
        coefficients,
        gyroscopic=any(item.gyroscopic for item in coefficients),
        weight_acceleration=gravity,
        places=((x, y, z, spin),),
    )


def elements(matrix: Float[np.ndarray, "3 3"]) -> tuple[float, ...]:
    """Elements of a symmetric matrix: xx, yy, zz, xy, xz, yz."""
    return tuple(float(matrix[pair]) for pair in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))


def stacked(values: Sequence[Any], **replaced: Any) -> Any:
    """Values stacked into arrays, dataclasses by field (some of them replaced) and tuples by element."""
    if is_dataclass(values[0]):
        names = [item.name for item in fields(values[0]) if item.name not in replaced]
        fields_made = {name: stacked([getattr(value, name) for value in values]) for name in names}
        kind: Any = type(values[0])
        return kind(**fields_made, **replaced)
    if isinstance(values[0], tuple):
        return tuple(stacked(parts) for parts in zip(*values, strict=True))
    return np.array(values, dtype=np.float64)


def together(items: Sequence[Any]) -> Any:
    """Floats of one flight as they are, those of several as arrays whose last axis is the flight."""
    return items[0] if len(items) == 1 else stacked(items)


@dataclass(frozen=True, slots=True)
class EffectiveParameters:
    """Combined parameters of the equations of motion, at hover in still air."""

    gyroscopic_ratios: tuple[float, float, float]
    torque_gains: tuple[float, float, float]  # [rad/s^2 per metre and unit of phi]
    rate_damping: tuple[float, float, float]  # d_p, d_q, d_r [1/s]
    thrust_gain: float  # alpha_z [m/s^2 per unit of phi]
    drag: tuple[float, float, float]  # d_x, d_y, d_z [1/s]
    rotor_rate_drag: tuple[float, float, float]  # e_p, e_q, e_r [1/s per m^2 and rad/s]
    rotor_drag: tuple[float, float, float]  # e_x, e_y, e_z [1/s per rad/s]
    quadratic_drag: tuple[float, float, float]  # c_x, c_y, c_z [1/m]
    translational_lift: float  # h [1/m]
    rotor_reaction: float  # j, inertia of a rotor over that of the body about z
    lag_up: float  # [s]
    lag_down: float  # [s]
    delay: float  # [s]


def effective_parameters(vehicle: Vehicle) -> EffectiveParameters:
    """Identifiable combinations of the vehicle's parameters."""
    rotors, mass, speed = vehicle.rotors, vehicle.mass, vehicle.hover_speed
    ix, iy, iz = vehicle.inertia[:3]
    gain = rotors.thrust_quadratic or rotors.thrust_linear
    forward = sum(x * x for x, _, _ in rotors.positions)
    sideways = sum(y * y for _, y, _ in rotors.positions)
    heights, upward = (sum(z**power for _, _, z in rotors.positions) for power in (1, 2))
    drag, inflow = rotors.drag * speed, rotors.inflow * speed
    body, rotational = vehicle.drag, vehicle.drag.rotational
    high = drag * upward - rotors.flapping * speed * heights  # of rotors above or below the centre of mass
    of_rotors = np.array([drag, drag, inflow])
    dx, dy, dz = ((rotors.count * of_rotors + np.array(body.linear)) / mass).tolist()
    cx, cy, cz = (of_body / mass for of_body in body.quadratic)
    return EffectiveParameters(
        gyroscopic_ratios=((iy - iz) / ix, (iz - ix) / iy, (ix - iy) / iz),
        torque_gains=(gain / ix, gain / iy, rotors.torque_ratio * gain / iz),
        rate_damping=(
            (inflow * sideways + high + rotational[0]) / ix,
            (inflow * forward + high + rotational[1]) / iy,
            (drag * (forward + sideways) + rotational[2]) / iz,
        ),
        thrust_gain=gain / mass,
        drag=(dx, dy, dz),
        rotor_rate_drag=(rotors.inflow / ix, rotors.inflow / iy, rotors.drag / iz),
        rotor_drag=(rotors.drag / mass, rotors.drag / mass, rotors.inflow / mass),
        quadratic_drag=(cx, cy, cz),
        translational_lift=rotors.count * rotors.translational_lift / mass,
        rotor_reaction=rotors.inertia / iz,
        lag_up=rotors.lag_up,
        lag_down=rotors.lag_down,
        delay=rotors.delay,
    )


ATTITUDE = tuple(f"attitude_{part}" for part in "wxyz")
VELOCITY, POSITION = (tuple(f"{name}_{axis}" for axis in "xyz") for name in ("velocity", "position"))

Triple: TypeAlias = tuple[Value, Value, Value]
#: Of a rotation from body to world.
Rows: TypeAlias = tuple[Triple, Triple, Triple]
#: The components of a body's state: a list of floats, or an array of shape (13, flights).
Body: TypeAlias = list[Value] | Float[np.ndarray, "13 ..."]

#: Components of anything, one after the other.
Components: TypeAlias = Sequence[Value] | Float[np.ndarray, "parts ..."]

#: Components of a body's state: position, velocity, attitude, rates.
BODY = 13
#: What is summed up begins here, as a float or as the array that is added.
ZERO: Value = 0.0


def speed_derivative(
    coefficients: Coefficients, speeds: Sequence[Value], command: Sequence[Value]
) -> list[Value]:
    """Change of each rotor's speed towards its command, with the time constant of its direction."""
    up, down = coefficients.rate_up, coefficients.rate_down
    difference = up - down
    return [
        (item - speed) * (down + difference * (item > speed))
        for speed, item in zip(speeds, command, strict=True)
    ]


def body_derivative(
    coefficients: Coefficients,
    body: Body,
    speeds: Sequence[Value],
    spin_up: Sequence[Value],
    wind: Triple,
    disturbance: Triple,
) -> list[Value]:
    """Time derivative of the 13 components of a body's state."""
    _, _, _, vx, vy, vz, w, x, y, z, p, q, r = body
    rows = rotation(w, x, y, z)
    air = into_body(rows, vx - wind[0], vy - wind[1], vz - wind[2])
    force, torque = wrench(coefficients, air, (p, q, r), speeds)
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rows
    fx, fy, fz = force
    mass = coefficients.mass
    torque = torque[0] + disturbance[0], torque[1] + disturbance[1], torque[2] + disturbance[2]
    turning = _rate_derivative(coefficients, (p, q, r), torque, speeds, spin_up)
    ax = (r00 * fx + r01 * fy + r02 * fz) / mass
    ay = (r10 * fx + r11 * fy + r12 * fz) / mass
    az = (r20 * fx + r21 * fy + r22 * fz) / mass - coefficients.weight_acceleration
    w_dot, x_dot = -0.5 * (x * p + y * q + z * r), 0.5 * (w * p + y * r - z * q)
    y_dot, z_dot = 0.5 * (w * q + z * p - x * r), 0.5 * (w * r + x * q - y * p)
    return [vx, vy, vz, ax, ay, az, w_dot, x_dot, y_dot, z_dot, *turning]


def specific_force(coefficients: Coefficients, body: Body, speeds: Sequence[Value], wind: Triple) -> Triple:
    """Specific force at the centre of mass on the body's axes [m/s^2]: +g upward in hover."""
    _, _, _, vx, vy, vz, w, x, y, z, p, q, r = body
    air = into_body(rotation(w, x, y, z), vx - wind[0], vy - wind[1], vz - wind[2])
    fx, fy, fz = wrench(coefficients, air, (p, q, r), speeds)[0]
    return fx / coefficients.mass, fy / coefficients.mass, fz / coefficients.mass


def rotation(w: Value, x: Value, y: Value, z: Value) -> Rows:
    """Rows of the rotation from body to world; a quaternion of any length will do."""
    double = 2.0 / (w * w + x * x + y * y + z * z)
    dx, dy, dz = double * x, double * y, double * z
    wx, wy, wz = dx * w, dy * w, dz * w
    xx, yy, zz = dx * x, dy * y, dz * z
    xy, xz, yz = dx * y, dx * z, dy * z
    return (
        (1.0 - yy - zz, xy - wz, xz + wy),
        (xy + wz, 1.0 - xx - zz, yz - wx),
        (xz - wy, yz + wx, 1.0 - xx - yy),
    )


def turned(attitude: Components, x: Value, y: Value, z: Value) -> list[Value]:
    """Attitude of length 1, turned about its own axes by small angles [rad], to their first order."""
    a, b, c, d = attitude
    x, y, z = 0.5 * x, 0.5 * y, 0.5 * z
    w, x, y, z = (
        a - b * x - c * y - d * z,
        b + a * x + c * z - d * y,
        c + a * y + d * x - b * z,
        d + a * z + b * y - c * x,
    )
    scale = (w * w + x * x + y * y + z * z) ** -0.5
    return [w * scale, x * scale, y * scale, z * scale]


def vector_part(
    first: Float[np.ndarray, "4 *shape"], second: Float[np.ndarray, "4 *shape"]
) -> Float[np.ndarray, "3 *shape"]:
    """Vector part of the inverse of an attitude times a quaternion: half of a small turn between them."""
    (a, b, c, d), (w, x, y, z) = first, second
    return np.stack(
        [a * x - b * w - c * z + d * y, a * y + b * z - c * w - d * x, a * z - b * y + c * x - d * w]
    )


def continuous(parts: Float[np.ndarray, "4 n"]) -> Float[np.ndarray, "4 n"]:
    """Attitudes without jumps to the opposite quaternion."""
    known = np.flatnonzero(np.isfinite(parts).all(axis=0))
    result = parts.copy()
    if known.size > 1:
        cosines = (parts[:, known[1:]] * parts[:, known[:-1]]).sum(axis=0)
        result[:, known[1:]] *= np.cumprod(np.where(cosines < 0.0, -1.0, 1.0))
    return result


def into_body(rows: Rows, x: Value, y: Value, z: Value) -> Triple:
    """Vector of the world on the body's axes."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def felt(rows: Rows, velocity: Float[np.ndarray, "3 n"], step_s: float) -> Float[np.ndarray, "3 n"]:
    """Specific force on the body's axes that follows from the velocity in the world."""
    x, y, z = (time_derivative(axis, step_s) for axis in velocity)
    return np.stack(into_body(rows, x, y, z + GRAVITY))


def wrench(
    coefficients: Coefficients, air: Triple, rates: Triple, speeds: Sequence[Value]
) -> tuple[Triple, Triple]:
    """Force [N] and torque [N m] of rotors and air on the body's axes."""
    c = coefficients
    u, v, w = air
    p, q, r = rates
    airspeed = (u * u + v * v + w * w) ** 0.5
    (x1, y1, z1), (x2, y2, z2), (x3, y3, z3) = c.body
    fx = fy = fz = mx = my = mz = ZERO
    linear, quadratic, torque_ratio = c.thrust_linear, c.thrust_quadratic, c.torque_ratio
    drag, inflow, lifting, flapping = c.drag, c.inflow, c.translational_lift, c.flapping
    for (x, y, z, spin), speed in zip(c.places, speeds, strict=True):
        lx, ly, lz = u + q * z - r * y, v + r * x - p * z, w + p * y - q * x
        lift = (linear + quadratic * speed) * speed
        dragged, flapped = drag * speed, flapping * speed
        back, right = dragged * lx, dragged * ly
        up = lift + lifting * (lx * lx + ly * ly) - inflow * speed * lz
        fx, fy, fz = fx - back, fy - right, fz + up
        mx = mx + y * up + z * right - flapped * ly
        my = my - z * back - x * up + flapped * lx
        mz = mz - x * right + y * back + spin * torque_ratio * lift
    if not isinstance(fx, float):
        fx, fy, fz, mx, my, mz = (over_rotors(part) for part in (fx, fy, fz, mx, my, mz))
    return (
        (fx - (x1 + x2 * airspeed) * u, fy - (y1 + y2 * airspeed) * v, fz - (z1 + z2 * airspeed) * w),
        (mx - x3 * p, my - y3 * q, mz - z3 * r),
    )


def over_rotors(value: Value) -> Value:
    """Sum over the rows of an array, which are rotors; floats have been added up."""
    return value if isinstance(value, float) else np.add.reduce(value, axis=0)


def _rate_derivative(
    coefficients: Coefficients,
    rates: Triple,
    torque: Triple,
    speeds: Sequence[Value],
    spin_up: Sequence[Value],
) -> Triple:
    p, q, r = rates
    xx, yy, zz, xy, xz, yz = coefficients.inertia
    lx, ly, lz = xx * p + xy * q + xz * r, xy * p + yy * q + yz * r, xz * p + yz * q + zz * r
    mx, my, mz = torque
    if coefficients.gyroscopic:
        spinning = spun_up = ZERO
        for (_, _, _, spin), speed, change in zip(coefficients.places, speeds, spin_up, strict=True):
            spinning, spun_up = spinning + spin * speed, spun_up + spin * change
        lz = lz - coefficients.rotor_inertia * over_rotors(spinning)
        mz = mz + coefficients.rotor_inertia * over_rotors(spun_up)
    mx, my, mz = mx - q * lz + r * ly, my - r * lx + p * lz, mz - p * ly + q * lx
    xx, yy, zz, xy, xz, yz = coefficients.inverse_inertia
    return xx * mx + xy * my + xz * mz, xy * mx + yy * my + yz * mz, xz * mx + yz * my + zz * mz
