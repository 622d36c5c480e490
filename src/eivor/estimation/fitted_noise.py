"""Noises that were fitted together with an estimate: how strong, of which order, and how well told."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FittedNoise:
    """A noise whose spectrum is strength^2 |difference|^(2 order).

    Parameters
    ----------
    of : str
        What it is the noise of: velocity, acceleration, or the disturbance.
    strength, strength_error : float
        Strength and its standard error, zero where it was declared.
    order, order_error : float
        Order and its standard error, zero where it was declared or is known: 0 is white, -1 a random walk.
    measure : str
        What the strength counts in, in words.
    """

    of: str
    strength: float
    strength_error: float
    order: float
    order_error: float
    measure: str

    @property
    def sentence(self) -> str:
        """What is told of it."""
        strength = f"{self.strength:.3g}"
        if self.strength_error:
            strength += f" ± {self.strength_error:.1g}"
        order = f"{self.order:z.2f}" + (f" ± {self.order_error:.1g}" if self.order_error else "")
        return f"{self.of} {strength} {self.measure}, order {order}"
