"""The noise of a sensor as its data sheet states it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from eivor import checks
from eivor.errors import UsageError


@dataclass(frozen=True, slots=True)
class DataSheet:
    """White noise and rounding of a sensor, as a data sheet tells them.

    Parameters
    ----------
    density : float
        Noise density, in the channel's unit per square root of a hertz.
    bandwidth_hz : float, optional
        Noise bandwidth of the sensor's filter [Hz], 1.57 times the cut-off of one of first order. Default:
        half the rate at which the channel is logged.
    step : float
        Quantisation step, in the channel's unit.

    Raises
    ------
    UsageError
        When a number is negative or not finite, or nothing is stated.
    """

    density: float = 0.0
    bandwidth_hz: float | None = None
    step: float = 0.0

    def __post_init__(self) -> None:
        stated = {"density": self.density, "step": self.step}
        if self.bandwidth_hz is not None:
            stated["bandwidth_hz"] = self.bandwidth_hz
        for name, value in stated.items():
            checks.number(name, value)
            if not 0.0 <= value < math.inf:
                raise UsageError(f"a {name} of zero or more", f"{value:g}", "Correct what the sheet says.")
        if not (self.density > 0.0 or self.step > 0.0):
            raise UsageError(
                "a noise density or a quantisation step above zero",
                "neither",
                "Give DataSheet(density=0.002, bandwidth_hz=50.0), for example.",
            )

    def std(self, rate_hz: float) -> float:
        """Standard deviation of one sample of a channel that is logged at that rate, in its unit.

        The root of density^2 times the bandwidth plus step^2 / 12.
        """
        bandwidth = 0.5 * rate_hz if self.bandwidth_hz is None else self.bandwidth_hz
        return math.sqrt(self.density**2 * bandwidth + self.step**2 / 12.0)
