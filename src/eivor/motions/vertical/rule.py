"""The rule that turns an estimate into verdicts, one ground at a time.

On the viscous friction K, which is the overall verdict:

* refused: the accelerometer feels a gravity that is off by more than 3 m/s^2, so that it is in another unit
  (gain, hover input and lag as well); no reference varies, K cannot be told from zero (K <= 0, or an interval
  that reaches zero), the input gain is not positive, or a conditional first-stage F is below 10 and K has no
  bounded set that holds however weak the instruments are;
* provisional: no exogenous reference, so that a direct method had to serve;
* identified: every first-stage F 10 or more, K's half-width <= K/2 with what is reserved for an estimator
  (and a lower end above that), the lag's <= 0.1 s, the lag below the
  top of its grid, J's p-value >= .001 (of a pool that of half its flights), the command logged
  at 45 Hz or more, 25 s of flight or more, instruments that contain no feedback, and an intercept that is
  not clearly beyond 5 m/s^2;
* weak otherwise.

Velocity and accelerometer that disagree make weak what their disagreement harms, see `sensors`: an offset the
lag and the gain, a scale gain and friction, a tilt the friction, anything else all three.

The gain, the hover input and the lag have verdicts of their own. Gain and hover input are weak where the
intercept is clearly beyond 0.4 m/s^2: thrust then grows with another power of the command than the input map
says, see `map_rule`.
"""

from __future__ import annotations

from collections.abc import Mapping

from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.grounds import given_lag_reasons
from eivor.flights.quantity import Unjudged
from eivor.inference.verdict import Reason
from eivor.motions.vertical.curve_rule import curve_reasons
from eivor.motions.vertical.friction_rule import friction_reasons
from eivor.motions.vertical.gain_rule import gain_reasons, hover_reasons, left_out_reasons
from eivor.motions.vertical.height import near_ground_reasons
from eivor.motions.vertical.lag_rule import delay_reasons, lag_reasons
from eivor.motions.vertical.map_rule import intercept_reasons, thrust_curve_reasons
from eivor.motions.vertical.sensor_rule import sensor_reasons, unit_reasons
from eivor.motions.vertical.sensors import OFFSET, SCALE, TILTS
from eivor.motions.vertical.sideways import fast_sideways_reasons, sideways_reasons
from eivor.motions.vertical.term_rule import term_reasons
from eivor.motions.vertical.terms import TERMS


def all_grounds(
    quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
) -> dict[str, tuple[Reason, ...]]:
    """Grounds against every quantity; those that one parameter decides share its grounds."""
    shared = (*given_lag_reasons(at), *unit_reasons(at))
    friction = (
        *friction_reasons(quantities, strength, at),
        *sensor_reasons(at, SCALE, *TILTS.values()),
        *sideways_reasons(at),
        *shared,
    )
    gain = (
        *gain_reasons(quantities["input_gain"], strength, at),
        *thrust_curve_reasons(quantities, at),
        *sensor_reasons(at, OFFSET, SCALE),
        *left_out_reasons(at),
        *near_ground_reasons(at),
        *fast_sideways_reasons(at),
        *shared,
    )
    lag = (*lag_reasons(quantities, strength, at), *sensor_reasons(at, OFFSET), *shared)
    found = (*curve_reasons(quantities, at), *sensor_reasons(at, OFFSET, SCALE), *shared)
    return {
        "viscous_friction": friction,
        "time_constant": friction,
        "input_gain": gain,
        "intercept": gain,
        "hover_input": (
            *hover_reasons(quantities["hover_input"], at),
            *intercept_reasons(quantities, at),
            *near_ground_reasons(at),
            *unit_reasons(at),
        ),
        "actuator_lag": lag,
        "delay": (*lag, *delay_reasons(quantities["delay"])),
        "effective_lag": lag,
        "thrust_curve": found,
        **{
            parameter.name: tuple(term_reasons(quantities[parameter.name], parameter, strength, at))
            for parameter in (term.parameter for term in TERMS.values())
            if parameter.name in quantities
        },
    }
