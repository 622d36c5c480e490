"""A number that somebody supplies, with how well it is known."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.errors import ParameterError
from eivor.inference.quantiles import normal_quantile
from eivor.motions.rigid_body.parameter_ranges import finite, non_negative


@dataclass(frozen=True, slots=True)
class KnownNumber:
    """A value from outside the flight.

    Parameters
    ----------
    value : float
        In the unit of what it is.
    std : float
        Standard deviation of its error; zero for a number that counts as exact.

    Raises
    ------
    ParameterError
        When the value is not finite, or the standard deviation below zero.
    """

    value: float
    std: float = 0.0

    def __post_init__(self) -> None:
        finite("value", self.value)
        non_negative("std", self.std)

    @property
    def interval(self) -> tuple[float, float]:
        """95 %, of the normal distribution."""
        half = normal_quantile(0.95) * self.std
        return self.value - half, self.value + half

    def check(self, name: str, low: float, high: float, unit: str) -> None:
        """Refuse what cannot be such a number, or is not told from zero by its own uncertainty.

        Parameters
        ----------
        name : str
            What messages call it.
        low, high : float
            Least and greatest value.
        unit : str
            With a blank before it, or empty.

        Raises
        ------
        ParameterError
            With what came instead.
        """
        if not low <= self.value <= high:
            raise ParameterError(
                f"a {name} between {low:g} and {high:g}{unit}",
                f"{self.value:g}",
                "Check its unit." if unit else "Correct the vehicle's description.",
            )
        if self.value > 0.0 and self.std > LARGEST_STD * self.value:
            raise ParameterError(
                f"a standard deviation of the {name} of at most {LARGEST_STD:g} of its value",
                f"{self.value:g} with {self.std:g}",
                "Leave it out: so little known, it tells nothing.",
            )


#: Largest standard deviation, as a share of the value.
LARGEST_STD = 0.4
