"""The axes about which a vehicle turns: channels, parameters and references of each.

With (p, q, r) the rates about forward, left and up axes, u what the actuators make of the torque setpoint,
and G the control effectiveness (the alpha of the rigid body times what the allocation makes of a unit):

    p' = G_p u_p - D_p p + b,   q' and r' alike, and of yaw  + J u_r'

Torque about the yaw axis is that of the rotors' drag and of their own change of speed: the reaction to
their acceleration goes with the rate of change of what the actuators do. The gyroscopic couplings q r, p r
and p q are left out: they are products of rates, which references of one axis do not move.
"""

from __future__ import annotations

from dataclasses import dataclass

from eivor.flights.references import ReferenceSource
from eivor.models.equation import Parameter


@dataclass(frozen=True)
class Axis:
    """One axis.

    Parameters
    ----------
    name : str
        "roll", "pitch" or "yaw".
    letter : str
        Of its channels: "x", "y" or "z".
    number : int
        From 0.
    reacts : bool
        The rotors' own acceleration turns the vehicle.
    """

    name: str
    letter: str
    number: int
    reacts: bool = False

    @property
    def rate(self) -> str:
        """Channel of the rate."""
        return f"angular_rate_{self.letter}"

    @property
    def torque(self) -> str:
        """Channel of the setpoint."""
        return f"torque_setpoint_{self.letter}"

    @property
    def effectiveness(self) -> Parameter:
        """Control effectiveness G."""
        return Parameter(f"{self.name}_effectiveness", "rad/s^2")

    @property
    def damping(self) -> Parameter:
        """Damping D."""
        return Parameter(f"{self.name}_damping", "1/s")

    @property
    def reaction(self) -> Parameter:
        """Reaction to the rotors' acceleration J."""
        return Parameter(f"{self.name}_reaction", "rad/s")

    @property
    def references(self) -> tuple[ReferenceSource, ...]:
        """Channels that may be instruments: what is injected, the pilot's or planner's attitude, the stick.

        Sticks that set anything else than attitude or rates move the vehicle too slowly to tell. The
        attitude setpoint that a position loop computes answers the vehicle, slowly. The rate setpoint
        of an attitude loop answers it at once; in acro mode, where it is the stick's, it is what moves the
        vehicle.
        """
        return (
            ReferenceSource(f"injected_torque_{self.letter}", axis=self.name),
            ReferenceSource(f"reference_{self.name}", axis=self.name),
            ReferenceSource(f"reference_angular_rate_{self.letter}", axis=self.name),
            ReferenceSource(f"pilot_{self.name}", in_control="pilot_sets_attitude", axis=self.name),
            ReferenceSource(f"feedback_reference_{self.name}", axis=self.name),
        )


ROLL, PITCH, YAW = Axis("roll", "x", 0), Axis("pitch", "y", 1), Axis("yaw", "z", 2, reacts=True)
AXES = (ROLL, PITCH, YAW)
#: Family of the setpoints.
TORQUE = "torque_setpoint"
