"""Ratios of a body's inertias, which gains and gyroscopic couplings tell of its flight.

Iyy / Ixx = alpha_p / alpha_q
Izz / Ixx = Iyy / Ixx - beta_1 = 1 + beta_2 Iyy / Ixx
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eivor.motions.rigid_body.parameters import COUPLING, GAIN, PITCH, ROLL

#: Parameters that tell them.
TELLING = (GAIN[ROLL].name, GAIN[PITCH].name, COUPLING[ROLL].name, COUPLING[PITCH].name)


@dataclass(frozen=True, slots=True)
class InertiaRatios:
    """Ratios of a body's inertias.

    Parameters
    ----------
    roll, pitch : float
        Izz / Ixx and Izz / Iyy.
    """

    roll: float
    pitch: float

    @classmethod
    def of_values(cls, values: Mapping[str, float]) -> InertiaRatios:
        """Those of gains and couplings that were identified, by name; of both couplings the mean."""
        over_roll = 0.5 * (by_roll_coupling(values) + by_pitch_coupling(values))
        return cls(over_roll, over_roll / pitch_over_roll(values))

    def of_axis(self, axis: int) -> float:
        """That of ROLL or PITCH."""
        return self.roll if axis == ROLL else self.pitch


def pitch_over_roll(values: Mapping[str, float]) -> float:
    """Iyy / Ixx."""
    return values[GAIN[ROLL].name] / values[GAIN[PITCH].name]


def by_roll_coupling(values: Mapping[str, float]) -> float:
    """Izz / Ixx by beta_1."""
    return pitch_over_roll(values) - values[COUPLING[ROLL].name]


def by_pitch_coupling(values: Mapping[str, float]) -> float:
    """Izz / Ixx by beta_2."""
    return 1.0 + values[COUPLING[PITCH].name] * pitch_over_roll(values)
