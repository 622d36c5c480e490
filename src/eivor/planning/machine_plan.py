"""Plan of a machine's references: D-optimal sines or steps within limits, by the formula."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from eivor import checks
from eivor.errors import InputError, UsageError
from eivor.flights.quantity import Quantity
from eivor.inference.distributions import normal_quantile
from eivor.motions.equation import SLOW, Answers, faster
from eivor.motions.machine import Machine
from eivor.planning.vehicle import KINDS, STEP_S, Shape, candidates
from eivor.tools import Float

#: Candidates are so many times as quick as those of flights.
PACES = (0.25, 1.0, 4.0)
#: Length of what can be planned [s].
SECONDS = (10.0, 3600.0)
#: Intervals are wider than the formula by what those of the log were, within these.
WIDER = (1.0, 4.0)
#: References are so many times as quick as those of the log, at most.
BEYOND = 1.75
#: Any target.
ALL = "all"


@dataclass(frozen=True, slots=True)
class ExpectedWidth:
    """Half-width of a 95 % interval that a record is expected to give."""

    words: str
    value: float
    half_width: float
    unit: str


@dataclass(frozen=True)
class MachinePlan:
    """References of a machine, and what they are expected to identify."""

    machine: Machine
    target: str  # A parameter, or "all"
    shape: Shape  # Of the first reference
    references: Mapping[str, Float[np.ndarray, " n"]]  # Every `STEP_S`, about their levels in the log
    limits: Mapping[str, tuple[float, ...]]  # As in `Answers.sizes`
    predicted: Mapping[str, ExpectedWidth]

    @property
    def time_s(self) -> Float[np.ndarray, " n"]:
        """Time from the first setpoint [s]."""
        return STEP_S * np.arange(self.shape.offset.size)

    @property
    def is_informative(self) -> bool:
        """Whether the target, or the headline, is expected to be identified."""
        names = self.machine.headline if self.target == ALL else (self.target,)
        known = [self.predicted[name] for name in names if name in self.predicted]
        return all(item.half_width <= self.machine.half_widths[0] * abs(item.value) for item in known)

    @property
    def sentence(self) -> str:
        """What is planned and expected, in a sentence."""
        names = self.machine.headline if self.target == ALL else (self.target,)
        predicted = (self.predicted[name] for name in names if name in self.predicted)
        widths = (f"{item.words} within ± {item.half_width:.2g} {item.unit}".strip() for item in predicted)
        where = " and ".join(self.references)
        return f"{self.time_s.size * STEP_S:g} s of {self.shape.words} in {where}: {' and '.join(widths)}."

    def summary(self) -> str:
        """References and expected half-widths, as plain text."""
        rows = (
            f"{item.words:<18}{item.value:.3g} ± {item.half_width:.2g} {item.unit}".rstrip()
            for item in self.predicted.values()
        )
        return "\n".join([self.sentence, *rows])

    def __repr__(self) -> str:
        return f"<MachinePlan for {self.machine.name}: {self.sentence}>"

    def csv_text(self) -> str:
        """Setpoints at 100 Hz, under the names of their channels."""
        rows = np.column_stack([self.time_s, *self.references.values()])
        lines = [",".join(("time", *self.references)), *(",".join(f"{x:.6g}" for x in row) for row in rows)]
        return "\n".join(lines) + "\n"


def plan_machine(
    machine: Machine,
    quantities: Mapping[str, Quantity],
    record: object,
    limits: Mapping[str, tuple[float, ...]],
    seconds: float,
    seed: int,
    *,
    target: str = "",
    shape: str = "",
) -> MachinePlan:
    """References for the smallest joint uncertainty, or the smallest interval of one parameter."""
    try:
        answers = msgspec.convert(record, Answers)
    except msgspec.ValidationError as error:
        expected = "a result of a log whose references move, with prediction.flown in its JSON"
        raise InputError(
            expected, f"one without ({error})", "Log a reference, and identify it again."
        ) from None
    checks.text("target", target)
    checks.whole("seed", seed)
    checks.index_of("a shape", shape or KINDS[0], KINDS)
    values = {name: item.value for name, item in quantities.items()}
    known = [name for name in answers.std_errors if name in machine.quantities]
    target = target or ALL
    checks.index_of("a target", target, (ALL, *known))
    inputs = [item.name for item in machine.logged if item.role == "input"]
    allowed = {name: answers.sizes[name] for name in (*answers.references, *inputs)}
    for name, sizes in limits.items():
        checks.index_of("a channel", name, tuple(answers.sizes))
        if not sizes or not all(item > 0.0 for item in sizes):
            received = f"{tuple(sizes)} for {name}"
            raise UsageError("a size, and maybe a rate, above zero", received, "Such as 0.5.")
        allowed[name] = (*sizes, *allowed.get(name, ())[len(sizes) :])
    counted, least = machine.activity.counted, math.inf
    best: tuple[Shape, dict[str, Float[np.ndarray, " n"]], dict[str, float]] | None = None
    for shapes in _candidates(len(answers.references), seconds, (shape or KINDS[0],), seed):
        moves = _within(answers, shapes, allowed)
        ends = answers.highest_hz.items()
        if any(faster(moves[name], answers.step_s, BEYOND * high) > 2.0 * SLOW for name, high in ends):
            continue  # nobody knows how it would answer
        channels = answers.channels(moves)
        errors, volume = answers.expected(machine.axes, counted, channels, values, machine.delays_s)
        score = volume if target == ALL else errors.get(target, math.inf)
        if score < least:
            least, best = score, (shapes[0], moves, errors)
    if best is None:
        raise InputError("a reference that moves within its limits", f"{allowed}", "Widen the limits.")
    chosen, moves, errors = best
    wide, predicted = normal_quantile(0.95), {}
    for name in known:
        item = quantities[name]
        measured = item.half_width / (wide * answers.std_errors[name])
        factor = float(np.clip(measured, *WIDER)) if math.isfinite(measured) else WIDER[1]
        words = machine.quantities[name].words
        predicted[name] = ExpectedWidth(words, item.value, factor * wide * errors[name], item.unit)
    every = np.arange(chosen.offset.size) * STEP_S
    setpoints = {
        name: answers.levels[name] + _between(answers.step_s, series, every) for name, series in moves.items()
    }
    return MachinePlan(machine, target, chosen, setpoints, allowed, predicted)


def _candidates(count: int, seconds: float, kinds: tuple[str, ...], seed: int) -> Iterator[tuple[Shape, ...]]:
    """Shapes of one kind and pace for each reference."""
    for pace in PACES:
        yield from zip(*(candidates(seconds, kinds, seed + k, pace) for k in range(count)), strict=True)


def _within(
    answers: Answers, shapes: tuple[Shape, ...], limits: Mapping[str, tuple[float, ...]]
) -> dict[str, Float[np.ndarray, " n"]]:
    """References as large as limits of channels allow."""
    moves = {}
    for name, shape in zip(answers.references, shapes, strict=True):
        at = np.arange(0.0, STEP_S * shape.offset.size, answers.step_s)
        series = _between(STEP_S, shape.offset, at)
        moves[name] = series * _factor(series, answers.step_s, limits[name])
    channels = answers.channels(moves)
    levels = answers.levels
    factor = min(
        _factor(channels[name] - levels[name], answers.step_s, limit) for name, limit in limits.items()
    )
    return {name: min(factor, 1.0) * series for name, series in moves.items()}


def _factor(series: Float[np.ndarray, " n"], step_s: float, limit: Sequence[float]) -> float:
    """The largest scale within limits of a series, its rate and its acceleration."""
    used = (float(np.abs(np.diff(series, n)).max()) / step_s**n for n in range(len(limit)))
    return min(most / max(item, 1e-300) for item, most in zip(used, limit, strict=True))


def _between(
    step_s: float, series: Float[np.ndarray, " n"], at: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """A smooth curve through samples, at other times; it stays where it ends."""
    from scipy.interpolate import CubicSpline

    time = step_s * np.arange(series.size)
    return np.asarray(CubicSpline(time, series)(np.minimum(at, time[-1])))
