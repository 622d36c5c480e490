"""The combinations of a vehicle's parameters that a flight shows, as they stand in its equations of motion.

With phi = n^2 + (c1/c2) n of a rotor's speed n (phi = n for rotors whose thrust is linear), v the body's air
velocity on its own axes, and (x, y) the places of the rotors:

    p'  = beta_1 q r + alpha_p sum y phi - d_p p
    q'  = beta_2 p r - alpha_q sum x phi - d_q q
    r'  = beta_3 p q + alpha_r sum s phi + j sum s n' - d_r r
    s_z = alpha_z sum phi - d_z v_z + h (v_x^2 + v_y^2) - c_z |v| v_z
    s_x = -d_x v_x - c_x |v| v_x, and s_y alike

Exact for a diagonal inertia, but for two things that `eivor.motions.rigid_body.beside` knows (drag beside the
centre of mass, and the angular momentum of rotors that spin) and a third: what rotors drag goes with
their speed, so that every d is that of hover; with l the air velocity at a rotor it is, exactly,

    d_p p -> e_p sum y n l_z       d_q q -> -e_q sum x n l_z       d_r r -> e_r sum n (x l_y - y l_x)
    d_x v_x -> e_x sum n l_x, and y and z alike

plus what the body drags. On flights of a Crazyflie with steps of .25 rad, without noise, a constant d leaves
errors of 4 % in itself and of .3 % in the torque gains; the sums leave none.
"""

from __future__ import annotations

from dataclasses import dataclass

from eivor.motions.rigid_body.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class EffectiveParameters:
    """What the equations of motion hold, at hover in still air.

    Parameters
    ----------
    gyroscopic_ratios : tuple of float
        beta_1, beta_2, beta_3.
    torque_gains : tuple of float
        alpha_p, alpha_q [rad/s^2 per metre and unit of phi], alpha_r [rad/s^2 per unit of phi].
    rate_damping : tuple of float
        d_p, d_q, d_r [1/s].
    thrust_gain : float
        alpha_z [m/s^2 per unit of phi].
    drag : tuple of float
        d_x, d_y, d_z [1/s].
    rotor_rate_drag : tuple of float
        e_p, e_q, e_r [1/s per m^2 and rad/s].
    rotor_drag : tuple of float
        e_x, e_y, e_z [1/s per rad/s].
    quadratic_drag : tuple of float
        c_x, c_y, c_z [1/m].
    translational_lift : float
        h [1/m].
    rotor_reaction : float
        j, inertia of a rotor over that of the body about z.
    lag_up, lag_down, delay : float
        Of the rotors [s].
    """

    gyroscopic_ratios: tuple[float, float, float]
    torque_gains: tuple[float, float, float]
    rate_damping: tuple[float, float, float]
    thrust_gain: float
    drag: tuple[float, float, float]
    rotor_rate_drag: tuple[float, float, float]
    rotor_drag: tuple[float, float, float]
    quadratic_drag: tuple[float, float, float]
    translational_lift: float
    rotor_reaction: float
    lag_up: float
    lag_down: float
    delay: float


def effective_parameters(vehicle: Vehicle) -> EffectiveParameters:
    """Combinations that a flight of the vehicle shows.

    Parameters
    ----------
    vehicle : Vehicle
        Elements of its inertia off the diagonal are left out.
    """
    rotors, mass, speed = vehicle.rotors, vehicle.mass, vehicle.hover_speed
    ix, iy, iz = vehicle.inertia[:3]
    gain = rotors.thrust_quadratic or rotors.thrust_linear
    forward = sum(x * x for x, _, _ in rotors.positions)
    sideways = sum(y * y for _, y, _ in rotors.positions)
    heights, upward = (sum(z**power for _, _, z in rotors.positions) for power in (1, 2))
    drag, inflow = rotors.drag * speed, rotors.inflow * speed
    linear, quadratic, rotational = (
        vehicle.drag.linear,
        vehicle.drag.quadratic,
        vehicle.drag.rotational,
    )
    high = drag * upward - rotors.flapping * speed * heights  # of rotors above or below the centre of mass
    of_rotors = (rotors.count * drag, rotors.count * drag, rotors.count * inflow)
    dx, dy, dz = ((own + body) / mass for own, body in zip(of_rotors, linear, strict=True))
    cx, cy, cz = (body / mass for body in quadratic)
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
