"""Equation (1) in body rates: what changes the state of a rigid body on rotors.

    x' = v                          m v' = R f - m g e3
    attitude' = attitude (0, w)/2   I w' = torque - w x (I w + h e3) - h' e3,   h = -J sum_i s_i n_i

The force f and the torque are those of the rotors and of the air, in the body's axes; h is the angular
momentum that the rotors have because they spin. As printed, (1) has Euler angles in place of body rates,
which has the wrong sign of the coupling even at zero tilt, and g in place of m g.

A body's state is its position, velocity (world), attitude w, x, y, z (body to world) and rates p, q, r: 13
components. Everything is written in plain arithmetic on components, so that the same lines serve floats,
which are quickest for one flight, and arrays for flights side by side, or for samples in time. Of rotors
there are then as many floats, or a single array with a row for each; see `Coefficients`. The kernels perform
no checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from eivor.errors import ShapeError
from eivor.motions.rigid_body.coefficients import Coefficients, Value
from eivor.shapes import Float

Triple: TypeAlias = tuple[Value, Value, Value]
#: The components of a body's state: a list of floats, or an array of shape (13, flights).
Body: TypeAlias = list[Value] | Float[np.ndarray, "13 ..."]

#: Components of anything, one after the other.
Components: TypeAlias = Sequence[Value] | Float[np.ndarray, "parts ..."]

#: Components of a body's state: position, velocity, attitude, rates.
BODY = 13
#: What is summed up begins here, as a float or as the array that is added.
ZERO: Value = 0.0


def state_derivative(
    coefficients: Coefficients,
    state: Float[np.ndarray, "*batch components"],
    command: Float[np.ndarray, "*batch rotors"],
    wind: Float[np.ndarray, "*batch 3"],
) -> Float[np.ndarray, "*batch components"]:
    """Time derivative of the states of bodies and rotors.

    Parameters
    ----------
    coefficients : Coefficients
        Of `side_by_side`: of one vehicle, or of as many as there are states.
    state : ndarray, shape (batch, 13 + rotors)
        Position [m], velocity [m/s], attitude w, x, y, z, rates [rad/s], rotor speeds; or without a batch.
    command : ndarray, shape (batch, rotors)
        Rotor speeds that are asked for.
    wind : ndarray, shape (batch, 3)
        Of the air in the world [m/s].

    Raises
    ------
    ShapeError
        When state or command do not fit the rotors.
    """
    rotors = coefficients.rotors
    if state.shape[-1] != BODY + rotors or command.shape[-1] != rotors:
        raise ShapeError(
            f"states of {BODY + rotors} components and commands of {rotors}, for {rotors} rotors",
            f"{state.shape[-1]} and {command.shape[-1]}",
            "Put position, velocity, attitude, rates and rotor speeds into one row.",
        )
    flat = state.reshape(-1, BODY + rotors).T
    speeds, asked = [flat[BODY:]], [command.reshape(-1, rotors).T]
    air = wind.reshape(-1, 3).T
    change = speed_derivative(coefficients, speeds, asked)
    body = body_derivative(
        coefficients, flat[:BODY], speeds, change, (air[0], air[1], air[2]), (0.0, 0.0, 0.0)
    )
    return np.vstack([*body, *change]).T.reshape(state.shape)


def speed_derivative(
    coefficients: Coefficients, speeds: Sequence[Value], command: Sequence[Value]
) -> list[Value]:
    """Change of each rotor's speed towards its command, with the time constant of its direction."""
    up, down = coefficients.rate_up, coefficients.rate_down
    difference = up - down
    return [
        (asked - speed) * (down + difference * (asked > speed))
        for speed, asked in zip(speeds, command, strict=True)
    ]


def body_derivative(
    coefficients: Coefficients,
    body: Body,
    speeds: Sequence[Value],
    spin_up: Sequence[Value],
    wind: Triple,
    disturbance: Triple,
) -> list[Value]:
    """Time derivative of the 13 components of a body's state.

    Parameters
    ----------
    coefficients : Coefficients
        Of the vehicle.
    body : list, or ndarray of shape (13, flights)
        The state. The attitude's length does not matter to forces and torques.
    speeds, spin_up : sequence of components
        Rotor speeds, and their derivatives, which matter to rotors with inertia only.
    wind : three components
        Velocity of the air in the world [m/s].
    disturbance : three components
        Torque from outside on the body's axes [N m].
    """
    _, _, _, vx, vy, vz, w, x, y, z, p, q, r = body
    rows = rotation(w, x, y, z)
    air = into_body(rows, vx - wind[0], vy - wind[1], vz - wind[2])
    force, torque = wrench(coefficients, air, (p, q, r), speeds)
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rows
    fx, fy, fz = force
    mass = coefficients.mass
    p_dot, q_dot, r_dot = _rate_derivative(
        coefficients,
        (p, q, r),
        (torque[0] + disturbance[0], torque[1] + disturbance[1], torque[2] + disturbance[2]),
        speeds,
        spin_up,
    )
    return [
        vx,
        vy,
        vz,
        (r00 * fx + r01 * fy + r02 * fz) / mass,
        (r10 * fx + r11 * fy + r12 * fz) / mass,
        (r20 * fx + r21 * fy + r22 * fz) / mass - coefficients.weight_acceleration,
        -0.5 * (x * p + y * q + z * r),
        0.5 * (w * p + y * r - z * q),
        0.5 * (w * q + z * p - x * r),
        0.5 * (w * r + x * q - y * p),
        p_dot,
        q_dot,
        r_dot,
    ]


def specific_force(coefficients: Coefficients, body: Body, speeds: Sequence[Value], wind: Triple) -> Triple:
    """What an accelerometer in the centre of mass measures on the body's axes [m/s^2]: +g upward in hover.

    See `body_derivative` for the arguments.
    """
    _, _, _, vx, vy, vz, w, x, y, z, p, q, r = body
    air = into_body(rotation(w, x, y, z), vx - wind[0], vy - wind[1], vz - wind[2])
    fx, fy, fz = wrench(coefficients, air, (p, q, r), speeds)[0]
    return fx / coefficients.mass, fy / coefficients.mass, fz / coefficients.mass


def rotation(w: Value, x: Value, y: Value, z: Value) -> tuple[Triple, Triple, Triple]:
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
    short = (w * w + x * x + y * y + z * z) ** -0.5
    return [w * short, x * short, y * short, z * short]


def into_body(rows: tuple[Triple, Triple, Triple], x: Value, y: Value, z: Value) -> Triple:
    """Vector of the world on the body's axes."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def wrench(
    coefficients: Coefficients, air: Triple, rates: Triple, speeds: Sequence[Value]
) -> tuple[Triple, Triple]:
    """Force [N] and torque [N m] of rotors and air on the body's axes, without what the rotors' inertia does.

    Parameters
    ----------
    coefficients : Coefficients
        Of the vehicle.
    air : three components
        Velocity of the body against the air, on its own axes [m/s].
    rates : three components
        Body rates [rad/s].
    speeds : sequence of components
        Rotor speeds.
    """
    c = coefficients
    u, v, w = air
    p, q, r = rates
    swiftness = (u * u + v * v + w * w) ** 0.5
    (x1, y1, z1), (x2, y2, z2), (x3, y3, z3) = c.body_linear, c.body_quadratic, c.body_rotational
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
        (
            fx - (x1 + x2 * swiftness) * u,
            fy - (y1 + y2 * swiftness) * v,
            fz - (z1 + z2 * swiftness) * w,
        ),
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
    """Euler's equations with rotors that spin."""
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
