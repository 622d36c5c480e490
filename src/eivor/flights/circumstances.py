"""What a verdict is given beside the quantities: what instruments tell, and how the flights were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from eivor.flights.agreement import SensorAgreement
from eivor.flights.given_lag import GivenLag
from eivor.inference.sets.confidence_set import ConfidenceSet


@dataclass(frozen=True, slots=True)
class Searched:
    """A nuisance parameter that was searched for on a grid.

    Parameters
    ----------
    value : float
        Where the search ended.
    highest : float
        Top of the grid.
    """

    value: float
    highest: float


@dataclass(frozen=True, slots=True)
class Strength:
    """What the instruments tell, in numbers.

    Parameters
    ----------
    first_stage : mapping of str to float
        Conditional first-stage F of each joint parameter; NaN without instruments.
    p_value : float
        Of the over-identification test.
    searched : mapping of str to Searched
        Nuisance parameters that were searched for.
    robust : mapping of str to ConfidenceSet
        Sets that hold however weak the instruments are, of parameters whose interval is theirs: where
        instruments are weak, or where the sets have no bounds.
    """

    first_stage: Mapping[str, float]
    p_value: float
    searched: Mapping[str, Searched] = field(default_factory=dict)
    robust: Mapping[str, ConfidenceSet] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What a verdict needs to know beside the numbers.

    Parameters
    ----------
    flights : int
        Number of flights used.
    command_rate_hz, response_rate_hz : float
        Slowest command, and the fastest of what was measured over the slowest flight [Hz].
    exogenous : bool
        The instruments do not answer the vehicle.
    direct : bool
        The method uses no instruments.
    missing_reference : str
        Why there is no instrument; empty when there is one.
    constant_reference : bool
        A reference is logged, and constant.
    excitation : str
        How much the flights moved, as a sentence; empty when it is not known.
    single_frequency_hz : float
        The frequency of a reference that has only one; zero for others [Hz].
    numbers : mapping of str to float
        What the motion adds, see `Motion.diagnostics`.
    given_lag : GivenLag or None
        What was known of the lag from elsewhere.
    sensors : SensorAgreement or None
        Whether two measurements of one response agree.
    aligned : bool
        The differences between them that can be taken out are.
    used_s : float
        Time used of all flights [s].
    past_inputs : bool
        The instruments are past inputs, which a controller computes.
    """

    flights: int
    command_rate_hz: float
    response_rate_hz: float
    exogenous: bool
    direct: bool
    missing_reference: str = ""
    constant_reference: bool = False
    excitation: str = ""
    single_frequency_hz: float = 0.0
    numbers: Mapping[str, float] = field(default_factory=dict)
    given_lag: GivenLag | None = None
    sensors: SensorAgreement | None = None
    aligned: bool = False
    used_s: float = np.inf
    past_inputs: bool = False
