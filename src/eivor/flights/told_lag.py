"""What something in the log says of the actuators' lag, beside the motion whose lag it is."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

from eivor.flights.quantity import Unjudged
from eivor.models.separable import Prior


@dataclass(frozen=True)
class ToldLag:
    """The effective lag that telemetry, or another motion of the same flight, tells.

    Parameters
    ----------
    source : str
        "telemetry", or the name of the motion.
    who : str
        The same in words.
    told : Unjudged
        Lag and delay together, as they were estimated, systematic parts included [s].
    apart_s : float
        Standard deviation of what its sensors may be later or earlier by than those of the motion [s].
    apart : str
        The reason of that in words, after "with".
    """

    source: str
    who: str
    told: Unjudged
    apart_s: float
    apart: str

    @property
    def prior(self) -> Prior:
        """The same as what is known of the lag: half a 95 % interval is two standard errors at most."""
        own = max(0.5 * self.told.half_width, self.told.std_error)
        return Prior(self.told.value, hypot(own, self.apart_s))

    @property
    def sentence(self) -> str:
        """What it says, with its interval, and what is added to that."""
        known = self.prior
        low, high = (1e3 * max(end, 0.0) for end in self.told.interval)
        return (
            f"{1e3 * known.mean:.3g} [{low:.3g}, {high:.3g}] ms, with {self.apart} "
            f"± {1e3 * known.std:.2g} ms (one standard deviation)"
        )
