"""Parameters of the rigid body's equations: which stand in which, and what moves with lag and delay.

    p'  = beta_1 q r + alpha_p sum y phi + o_p sum phi - d_p p + b
    q'  = beta_2 p r - alpha_q sum x phi + o_q sum phi - d_q q + b
    r'  = beta_3 p q + alpha_r sum s phi + j sum s n' - d_r r + b
    s_z = alpha_z sum phi - d_z v_z - c_z |v| v_z + h (v_x^2 + v_y^2) + b
    s_x = -d_x v_x - c_x |v| v_x + b, s_y alike

Rotors in a vehicle that turns as it flies across meet unequal air, so that their lift turns it: k_h / I_x
sum y (l_x^2 + l_y^2) about x, with l the velocity at a rotor, and y alike.

Drag that acts above, below or beside the centre of mass turns the vehicle as well, by what goes with the
velocity; so does the angular momentum of rotors that spin, -J sum s n, which goes round with the body:

    p' += L_y v_y + L_z v_z + j_p q sum s n
    q' += M_x v_x + M_z v_z - j_q p sum s n
    r' += N_x v_x + N_y v_y

phi is the input map of a rotor's state n, which lags behind its command: tau n' + n = command(t - d). v is
the velocity on the body's axes, through air at rest. o is what a centre of mass beside the middle of the
rotors does.
"""

from __future__ import annotations

from eivor.models.equation import Parameter

TURNING = ("roll", "pitch", "yaw")
ALONG = ("x", "y", "z")
#: Numbers of the equations: turning first, then the specific force along each axis.
ROLL, PITCH, YAW, FORCE_X, FORCE_Y, FORCE_Z = range(6)

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
    tuple(Parameter(f"{name}_by_drag_{along}", "1/(m s)") for along in others)
    for name, others in zip(TURNING, ("yz", "xz", "xy"), strict=True)
)
#: Of rotors that spin: J / Ixx and J / Iyy.
SPIN_MOMENT = (Parameter("roll_by_spin", ""), Parameter("pitch_by_spin", ""))
GAIN = (
    Parameter("roll_gain", "rad/s^2/m"),
    Parameter("pitch_gain", "rad/s^2/m"),
    Parameter("yaw_gain", "rad/s^2"),
)
OFFSET = (Parameter("roll_offset", "rad/s^2"), Parameter("pitch_offset", "rad/s^2"))
REACTION = Parameter("rotor_reaction", "")
THRUST = Parameter("thrust_gain", "m/s^2")

#: Parameters of what the rotors drive.
DRIVING = (*GAIN, *OFFSET, REACTION, THRUST)

#: Parameters of each equation that move with lag and delay.
MOVING = (
    (GAIN[ROLL], DAMPING[ROLL], OFFSET[ROLL], SPIN_MOMENT[ROLL], *DRAG_MOMENT[ROLL]),
    (GAIN[PITCH], DAMPING[PITCH], OFFSET[PITCH], SPIN_MOMENT[PITCH], *DRAG_MOMENT[PITCH]),
    (GAIN[YAW], DAMPING[YAW], REACTION, *DRAG_MOMENT[YAW]),
    (DRAG[0],),
    (DRAG[1],),
    (THRUST, DRAG[2], LIFT),
)
