"""An interval without an end is refused as such: no sentence of a motion gives it a width."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.flights.motion import InstrumentStrength, Searched, VerdictInputs
from eivor.flights.quantity import QuantityEstimate
from eivor.flights.verdict import unbounded_reasons
from eivor.inference.verdict import Status
from eivor.motions.rates import verdict as rates
from eivor.motions.rates.verdict import AXES
from eivor.motions.rigid_body import verdict as rigid_body
from eivor.motions.vertical import verdict as vertical

ENDLESS = QuantityEstimate(1.0, "", np.inf, (0.5, np.inf))
AT = VerdictInputs(1, 100.0, 100.0, exogenous=True, direct=False, used_s=60.0)
KNOWN = QuantityEstimate(0.05, "s", 1e-3, (0.045, 0.055))


def strength(*names: str) -> InstrumentStrength:
    searched = {"actuator_lag": Searched(0.05, highest=0.3)}
    return InstrumentStrength(dict.fromkeys((*names, "actuator_lag"), 100.0), 0.5, searched)


def grounds_of_rates(lag: QuantityEstimate):
    axis = AXES[0]
    names = (axis.effectiveness.name, axis.damping.name)
    result = dict.fromkeys(names, ENDLESS)
    reported = strength(*names)
    return [
        *rates.effectiveness_reasons(axis, result[names[0]], AT),
        *rates.damping_reasons(axis, result[names[1]], AT),
        *rates.rough_lag_reasons({"effective_lag": lag}, reported),
    ]


def grounds_of_a_rigid_body(lag: QuantityEstimate):
    names = ("roll_gain", "roll_damping", "thrust_gain")
    grounds = rigid_body.all_reasons(
        dict.fromkeys(names, ENDLESS) | {"effective_lag": lag}, strength(*names), AT
    )
    return [reason for reasons in grounds.values() for reason in reasons]


def grounds_of_climbs(lag: QuantityEstimate):
    names = ("viscous_friction", "input_gain", "hover_input", "intercept")
    result = dict.fromkeys(names, ENDLESS) | {"effective_lag": lag, "delay": KNOWN}
    reported = strength(*names[:2])
    return [
        *vertical.friction_reasons(result, reported, AT),
        *vertical.gain_reasons(ENDLESS, reported, AT),
        *vertical.hover_reasons(ENDLESS, AT),
    ]


@pytest.mark.parametrize("reasons", [grounds_of_rates, grounds_of_a_rigid_body, grounds_of_climbs])
def test_no_sentence_gives_a_width_to_an_interval_without_an_end(reasons):
    assert [reason.sentence for reason in reasons(KNOWN)] == []
    of_lag = {reason.sentence for reason in reasons(QuantityEstimate(0.05, "s", np.inf, (0.02, np.inf)))}
    assert of_lag
    assert all("has no upper bound" in sentence for sentence in of_lag)
    assert not any("inf" in sentence.replace("information", "") for sentence in of_lag)


def test_it_is_refused_all_the_same():
    (reason,) = unbounded_reasons(ENDLESS, "roll gain", ())
    assert reason.status is Status.REFUSED
