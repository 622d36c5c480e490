"""The rule that turns an estimate into verdicts, one ground at a time.

On the viscous friction K, which is the overall verdict:

* refused: no reference varies, a conditional first-stage F is below 10, or K cannot be told from zero
  (K <= 0, or an interval that reaches zero), or the input gain is not positive;
* provisional: no exogenous reference, so that a direct method had to serve;
* identified: K's half-width <= K/2, the lag's <= 0.1 s, the lag below the top of its grid, J's p-value
  >= .001 (in pools of ten or more flights a finding only), the command logged at 45 Hz or more,
  instruments that contain no feedback, and an intercept that is not clearly beyond 5 m/s^2;
* weak otherwise.

The gain, the hover input and the lag have verdicts of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights.result import Quantity
from eivor.inference.verdict import Reason, Status

STRONG_FIRST_STAGE = 10.0
FRICTION_SHARE = 0.5
GAIN_SHARE = 0.1
HOVER_SHARE = 0.05
LAG_HALF_WIDTH_S = 0.1
LAG_SHARE = 0.5
LAG_KNOWN_S = 0.01
J_P_VALUE = 0.001
COMMAND_RATE_HZ = 45.0
GAIN_RATE_HZ = 20.0
LARGE_POOL = 10
LARGE_INTERCEPT = 5.0

FLY = (
    "Fly vertical position steps or a sine sweep of about 2 m/s and 2 m for 60 s in position mode, calm air."
)
QUICKER = "Fly quicker steps, and log command and acceleration at 50 Hz or more."
LOG_REFERENCE = "Log the position setpoint, or the pilot's stick, at 50 Hz or more."


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What the verdict needs to know beside the numbers.

    Parameters
    ----------
    flights : int
        Number of flights used.
    command_rate_hz, response_rate_hz : float
        Slowest command, and the faster of velocity and acceleration over the slowest flight [Hz].
    exogenous : bool
        The instruments do not answer the vehicle.
    direct : bool
        The method uses no instruments.
    missing_reference : str
        Why there is no instrument; empty when there is one.
    constant_reference : bool
        A reference is logged, and constant.
    input_variation : float
        Standard deviation of the mapped input over its mean; NaN when it is not known.
    velocity_std : float
        Standard deviation of the vertical speed [m/s].
    """

    flights: int
    command_rate_hz: float
    response_rate_hz: float
    exogenous: bool
    direct: bool
    missing_reference: str = ""
    constant_reference: bool = False
    input_variation: float = float("nan")
    velocity_std: float = float("nan")

    @property
    def excitation(self) -> str:
        """How much the flight moved, as a sentence with a blank before it; empty when it is not known."""
        if not np.isfinite(self.input_variation):
            return ""
        return (
            f" The input varied by {self.input_variation:.1%} and the vertical speed by "
            f"{self.velocity_std:.2g} m/s (standard deviations)."
        )


def friction_reasons(estimate: Estimate, quantities: dict[str, Quantity], at: Circumstances) -> list[Reason]:
    """Grounds against the viscous friction."""
    reasons = _instrument_reasons(estimate, at)
    friction = quantities["viscous_friction"]
    if friction.value <= 0.0:
        reasons.append(
            Reason(
                Status.REFUSED,
                f"The viscous friction came out at {friction.value:.3g} 1/s, which no vehicle has: the air "
                f"or a feedback moved the vehicle more than the reference did.{at.excitation}",
                FLY,
            )
        )
    elif friction.interval[0] <= 0.0:
        low, high = friction.interval
        reasons.append(
            Reason(
                Status.REFUSED,
                f"The viscous friction cannot be told from zero: its interval is [{low:.2g}, {high:.2g}] "
                f"1/s.{at.excitation}",
                FLY,
            )
        )
    elif friction.half_width > FRICTION_SHARE * friction.value:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The viscous friction's interval is +-{friction.half_width / friction.value:.1%} wide; "
                f"identified asks for +-{FRICTION_SHARE:.0%}.{at.excitation}",
                "Fly longer, faster climbs and descents, or pool several flights.",
            )
        )
    reasons.extend(_rough_lag_reasons(estimate, quantities))
    reasons.extend(_unit_reasons(quantities))
    p_value = estimate.best.inference.over_identification[1]
    if p_value < J_P_VALUE and at.flights < LARGE_POOL:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The references disagree about the parameters (J p-value {p_value:.1g}): something "
                "moves the vehicle that the model does not have.",
                "Keep the tilt small, stay off the ground, and check the input map.",
            )
        )
    if at.command_rate_hz < COMMAND_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The command is logged at {at.command_rate_hz:.0f} Hz; below {COMMAND_RATE_HZ:.0f} Hz the "
                "intervals do not hold.",
                "Log the thrust setpoint or the rotor commands at 50 Hz or more.",
            )
        )
    return reasons


def _unit_reasons(quantities: dict[str, Quantity]) -> list[Reason]:
    """Grounds that speak of signs and units: a gain that pulls down, an intercept that no sensor has."""
    reasons = []
    if quantities["input_gain"].value <= 0.0:
        reasons.append(
            Reason(
                Status.REFUSED,
                "The input gain is not positive: the input, or the acceleration, has the wrong sign.",
                "Check the frame (z up, or NED), the input's sign and its map.",
            )
        )
    intercept = quantities.get("intercept")
    if intercept is not None and abs(intercept.value) - intercept.half_width > LARGE_INTERCEPT:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The intercept is {intercept.value:.1f} m/s^2, far beyond the bias of an accelerometer.",
                "Check the units and signs of velocity and acceleration, the clock, and the input map.",
            )
        )
    return reasons


def _instrument_reasons(estimate: Estimate, at: Circumstances) -> list[Reason]:
    if at.constant_reference:
        sentence = f"The reference never moved ({at.missing_reference}).{at.excitation}"
        return [Reason(Status.REFUSED, sentence, FLY)]
    if at.direct:
        if at.missing_reference:
            return [
                Reason(
                    Status.PROVISIONAL,
                    f"No reference can serve as an instrument ({at.missing_reference}), so the numbers "
                    "come from nonlinear least squares, which disturbances bias.",
                    LOG_REFERENCE,
                )
            ]
        return [
            Reason(
                Status.PROVISIONAL,
                "A direct method is biased by disturbances in closed loop.",
                "Use reference_iv for a verdict.",
            )
        ]
    strengths = estimate.best.inference.first_stage
    reasons = []
    if not np.all(strengths >= STRONG_FIRST_STAGE):
        weakest = int(np.argmin(strengths))
        reasons.append(
            Reason(
                Status.REFUSED,
                f"The instruments tell too little about the {estimate.names[weakest].replace('_', ' ')}: "
                f"first-stage F is {strengths[weakest]:.1f}, and {STRONG_FIRST_STAGE:.0f} is needed."
                f"{at.excitation}",
                FLY,
            )
        )
    if not at.exogenous:
        reasons.append(
            Reason(
                Status.WEAK,
                "The instruments answer the vehicle's own disturbances (past inputs, or a setpoint that a "
                "position loop computes).",
                "Log the trajectory's position setpoint.",
            )
        )
    return reasons


def _rough_lag_reasons(estimate: Estimate, quantities: dict[str, Quantity]) -> list[Reason]:
    if "actuator_lag" not in estimate.names:
        return []
    reasons = []
    half_width = quantities["effective_lag"].half_width
    if half_width > LAG_HALF_WIDTH_S:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The actuator's lag is known to +-{half_width * 1e3:.0f} ms only; "
                f"+-{LAG_HALF_WIDTH_S * 1e3:.0f} ms is needed.",
                QUICKER,
            )
        )
    profile = estimate.best.profile
    if profile.lag_s >= 0.999 * float(profile.lags_s[-1]):
        reasons.append(
            Reason(
                Status.WEAK,
                f"The lag ran into the top of its grid ({profile.lags_s[-1]:.1f} s).",
                "Check that the input is the command of this vehicle, and its time stamps.",
            )
        )
    return reasons


def gain_reasons(estimate: Estimate, gain: Quantity, at: Circumstances) -> list[Reason]:
    """Grounds against the input gain."""
    if gain.value <= 0.0:
        return [Reason(Status.REFUSED, "The input gain is not positive.", "Check the input's sign and map.")]
    reasons = []
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the input gain.", LOG_REFERENCE))
    else:
        strength = float(estimate.best.inference.first_stage[estimate.names.index("input_gain")])
        if strength < STRONG_FIRST_STAGE:
            sentence = _too_low("input gain", strength)
            reasons.append(Reason(Status.WEAK, sentence, FLY))
    if gain.half_width > GAIN_SHARE * gain.value:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The input gain's interval is +-{gain.half_width / gain.value:.1%} wide; identified asks "
                f"for +-{GAIN_SHARE:.0%}.{at.excitation}",
                "Fly quicker and larger steps, which change the thrust more.",
            )
        )
    if at.response_rate_hz < GAIN_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"Velocity and acceleration are logged at {at.response_rate_hz:.0f} Hz at most.",
                "Log one of them at 20 Hz or more.",
            )
        )
    return reasons


def hover_reasons(hover: Quantity, at: Circumstances) -> list[Reason]:
    """Grounds against the hover input."""
    if not (np.isfinite(hover.value) and hover.value > 0.0):
        return [Reason(Status.REFUSED, "The hover input is not positive.", "Check the input's sign and map.")]
    reasons = []
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the hover input.", LOG_REFERENCE))
    if not hover.half_width <= HOVER_SHARE * hover.value:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The hover input's interval is +-{hover.half_width / hover.value:.1%} wide; identified asks "
                f"for +-{HOVER_SHARE:.0%}.",
                "Fly longer, and come to rest between the climbs.",
            )
        )
    return reasons


def lag_reasons(estimate: Estimate, quantities: dict[str, Quantity], at: Circumstances) -> list[Reason]:
    """Grounds against the actuator's lag: those that count against the friction, and a rough lag."""
    reasons = _rough_lag_reasons(estimate, quantities)
    lag = quantities["effective_lag"]
    if lag.half_width > max(LAG_SHARE * lag.value, LAG_KNOWN_S):
        sentence = f"The lag's interval is +-{lag.half_width * 1e3:.0f} ms wide."
        reasons.append(Reason(Status.WEAK, sentence, QUICKER))
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the lag.", LOG_REFERENCE))
    elif "actuator_lag" in estimate.names:
        strength = float(estimate.best.inference.first_stage[estimate.names.index("actuator_lag")])
        if strength < STRONG_FIRST_STAGE:
            sentence = _too_low("lag", strength)
            reasons.append(Reason(Status.WEAK, sentence, QUICKER))
    return reasons


def _too_low(name: str, strength: float) -> str:
    return f"First-stage F of the {name} is {strength:.1f}, and {STRONG_FIRST_STAGE:.0f} is needed."
