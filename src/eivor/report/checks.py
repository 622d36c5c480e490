"""What was checked of a flight's estimate, a line each: the diagnostics in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite

from eivor.flights.result import FlightEstimate, Quantity
from eivor.flights.rule import STRONG_FIRST_STAGE

#: Level at which a check speaks, and the change by one segment, in standard errors, that is worth a look.
SIGNIFICANT = 0.01
LARGE_LEVERAGE = 1.5
COLUMNS = {"viscous_friction": "K", "input_gain": "K_u", "actuator_lag": "τ"}

#: Bias of least squares, in standard errors, that is worth a word.
NOTABLE_BIAS = 0.5

#: A check's title and its sentence.
Check = tuple[str, str]


def checks(result: FlightEstimate) -> tuple[Check, ...]:
    """Checks of an estimate, those left out that its method cannot make; none without an estimate."""
    if result.estimate is None:
        return ()
    numbers = result.diagnostics
    makers = (_strength, _agreement, _constancy, _memory, _leverage)
    found = [check for maker in makers for check in maker(numbers)]
    return (*found, *_least_squares(numbers, result.quantities["viscous_friction"]))


def _strength(numbers: Mapping[str, float]) -> Iterator[Check]:
    found = {symbol: numbers.get(f"first_stage_F_{name}", float("nan")) for name, symbol in COLUMNS.items()}
    known = [f"{F:.0f} for {symbol}" for symbol, F in found.items() if isfinite(F)]
    if known:
        yield "instruments", f"first-stage F {', '.join(known)} ({STRONG_FIRST_STAGE:.0f} is needed)"


def _agreement(numbers: Mapping[str, float]) -> Iterator[Check]:
    if numbers["instrument_rank"] > 0.0 and isfinite(numbers["over_identification_p_value"]):
        p_value = numbers["over_identification_p_value"]
        yield "agreement", f"the instruments {_told(p_value, 'disagree', 'agree')}"


def _least_squares(numbers: Mapping[str, float], friction: Quantity) -> Iterator[Check]:
    value = numbers["least_squares_viscous_friction"]
    if not isfinite(value):
        return
    off = (value - friction.value) / friction.std_error
    significant = numbers["least_squares_p_value"] < SIGNIFICANT and abs(off) > NOTABLE_BIAS
    remark = f", {off:+.1f} standard errors off" if significant else ""
    yield "least squares", f"would give K {value:.3g} 1/s{remark}"


def _constancy(numbers: Mapping[str, float]) -> Iterator[Check]:
    p_value = numbers["constancy_p_value"]
    if not isfinite(p_value):
        return
    sentence = f"the parameters {_told(p_value, 'change', 'stay the same')}"
    if p_value < SIGNIFICANT:
        change = numbers["constancy_change_viscous_friction"]
        sentence += (
            f", most likely {numbers['constancy_break']:.0%} into the time used: K by {change:+.2g} 1/s"
        )
    yield "constancy", sentence


def _memory(numbers: Mapping[str, float]) -> Iterator[Check]:
    memory, error = numbers["residual_memory"], numbers["residual_memory_std_error"]
    if isfinite(memory):
        drifting = " (it drifts)" if memory - 2.0 * error > 0.5 else ""
        yield "residual", f"memory {memory:.2f} ± {2.0 * error:.2f}{drifting}"


def _leverage(numbers: Mapping[str, float]) -> Iterator[Check]:
    by = numbers["leverage_viscous_friction"]
    if isfinite(by):
        look = ": look at it" if abs(by) > LARGE_LEVERAGE else ""
        which = f"part {numbers['leverage_segment']:.0f} of {numbers['leverage_segments']:.0f}"
        yield "leverage", f"without {which}, K moves by {by:+.1f} standard errors{look}"


def _told(p_value: float, rejected: str, kept: str) -> str:
    """Word for the outcome of a test, with its p-value."""
    word = rejected if p_value < SIGNIFICANT else kept
    return f"{word} (p {'<= 0.001' if p_value <= 0.001 else f'{p_value:.2g}'})"
