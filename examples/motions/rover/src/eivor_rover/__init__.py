"""The forward motion of a ground vehicle, as a motion of Eivor."""

from eivor_rover.motion import Rover

__all__ = ["Rover"]
