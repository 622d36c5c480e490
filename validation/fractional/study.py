"""Study: bias, spread and coverage of fractional difference equations' coefficients and orders.

    python -m validation.fractional.study --runs 1000 [--sharper] [--page docs/fractional-equations.md]

Every run draws a record of a known equation with noise on input and output, 40 dB below each signal, and
asks each method of the paper for coefficients, order and 95 % intervals.
"""

from __future__ import annotations

import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np

import eivor as ev
from eivor.errors import EstimationError, WeakInstrumentsWarning
from eivor.estimation.method import Method
from eivor.models.regression import Column
from eivor.signals.filters import filtered
from eivor.tools import Float
from validation.pages import markdown
from validation.studies import Option, StudyCommand

Series = Float[np.ndarray, " n"]

#: Spacing and reach of log r: the integrand falls as r^alpha on both sides.
SPACING, RATE_REACH = 0.05, 40.0


def _rates(alpha: float) -> tuple[Series, Series]:
    log_rate = np.arange(-RATE_REACH / alpha, RATE_REACH / alpha, SPACING)
    rate = np.exp(log_rate)
    power = rate**alpha
    weight = np.sin(alpha * np.pi) / np.pi * power / (power**2 + 2.0 * power * np.cos(alpha * np.pi) + 1.0)
    return rate, SPACING * weight


def step_response(time: Sequence[float] | Series, alpha: float) -> Series:
    """1 - E_alpha(-t^alpha)."""
    rate, weight = _rates(alpha)
    return np.array([float(weight @ -np.expm1(-rate * t)) for t in time])


def ramp_response(time: Sequence[float] | Series, alpha: float) -> Series:
    """T (1 - E_{alpha,2}(-t^alpha))."""
    rate, weight = _rates(alpha)

    def at(t: float) -> float:
        late = t + np.expm1(-rate * t) / rate
        return float(weight @ np.where(rate * t < 1e-4, rate * t**2 / 2.0, late))

    return np.array([at(t) for t in time])


def driven(current: Float[np.ndarray, " k"], ramp: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Response at the samples to an input that is a line between them, zero at first."""
    bends = np.diff(current, n=2, prepend=[0.0, 0.0])
    # The line bends at a sample and is felt after it.
    return filtered(np.append(bends[1:], 0.0), ramp)


ORDER = ev.UnknownOrder("order", 0.3, 1.1)
#: Lags of instruments: they reach as far as the memory that tells an order.
REACH = (0, 1, 2, 4, 8, 12, 16, 24, 32, 48, 64, 96)
#: As far as the input's own memory too.
FAR = (*REACH, 128, 192, 256, 384)


class KnownEquation(ABC):
    """A fractional difference equation with its numbers, and records of it."""

    name: str
    about: str
    model: ev.FractionalDifferenceModel
    truth: ClassVar[Mapping[str, float]]
    guess: ClassVar[Mapping[str, float]]
    rate_hz: float = 1.0
    samples: int = 1000

    @abstractmethod
    def exact(self, rng: np.random.Generator) -> tuple[Series, Series]:
        """Input and output without noise."""

    def record(self, seed: int, signal_to_noise_db: float = 40.0) -> ev.Signals:
        """A record with white noise on input and output, each so far below its own standard deviation."""
        rng = np.random.default_rng([seed, 12])
        true = dict(zip(("input", "output"), self.exact(rng), strict=True))
        share = 10.0 ** (-signal_to_noise_db / 20.0)
        noise = {name: ev.WhiteNoise(share * float(series.std())) for name, series in true.items()}
        measured = {name: series + noise[name].sample(self.samples, rng) for name, series in true.items()}
        return ev.Signals(self.rate_hz, measured | {"reference": true["input"]}, noise=noise)


@dataclass(frozen=True)
class Relaxation(KnownEquation):
    """y + 8 Delta^0.7 y = u, driven by an input with a memory of some samples."""

    name = "relaxation"
    about = "y + 8 Δ^0.7 y = u, 1,000 samples"
    model = ev.FractionalDifferenceModel((0.0, ORDER), (0.0,))
    truth: ClassVar[Mapping[str, float]] = {
        "output_coefficient_2": 8.0,
        "input_coefficient_1": 1.0,
        "order": 0.7,
    }
    guess: ClassVar[Mapping[str, float]] = {
        "output_coefficient_2": 6.0,
        "input_coefficient_1": 1.0,
        "order": 0.6,
    }

    def exact(self, rng: np.random.Generator) -> tuple[Series, Series]:
        u = filtered(0.8 ** np.arange(100.0), rng.standard_normal(self.samples))
        return u, self.model.simulate(self.truth, u)


#: A cell: ohmic and ZARC resistance [ohm], time constant [s], order.
OHMIC, ARC, TIME_CONSTANT, ARC_ORDER = 0.010, 0.020, 2.0, 0.8


@dataclass(frozen=True)
class Cell(KnownEquation):
    """V + tau^alpha D^alpha V = (R0 + R1) I + R0 tau^alpha D^alpha I, its voltage not by any recursion."""

    name = "cell"
    about = "R0 + R1/(1 + (s τ)^0.8), 20 Hz, 2,000 samples"
    model = ev.FractionalDifferenceModel((0.0, ORDER), (0.0, ORDER), ev.FractionalDerivative())
    truth: ClassVar[Mapping[str, float]] = {
        "output_coefficient_2": TIME_CONSTANT**ARC_ORDER,
        "input_coefficient_1": OHMIC + ARC,
        "input_coefficient_2": OHMIC * TIME_CONSTANT**ARC_ORDER,
        "order": ARC_ORDER,
    }
    guess: ClassVar[Mapping[str, float]] = {
        "output_coefficient_2": 1.0,
        "input_coefficient_1": 0.0,
        "input_coefficient_2": 0.0,
        "order": 0.7,
    }
    rate_hz = 20.0
    samples = 2000
    memory_s = 2.0

    def exact(self, rng: np.random.Generator) -> tuple[Series, Series]:
        """Current of 10 A, smooth over two seconds, and voltage."""
        fade = np.exp(-np.arange(self.samples) / (self.rate_hz * self.memory_s))
        white = rng.standard_normal(self.samples)
        white[0] = 0.0
        current = filtered(fade, filtered(fade, white))
        current *= 10.0 / current.std()
        voltage = OHMIC * current + ARC * driven(current, _ramp(self.samples, self.rate_hz))
        return current, voltage


@cache
def _ramp(samples: int, rate_hz: float) -> Series:
    """Response of the arc to a current that grows by one per sample."""
    time = np.arange(samples) / (rate_hz * TIME_CONSTANT)
    return ramp_response(time, ARC_ORDER) * (rate_hz * TIME_CONSTANT)


@dataclass(frozen=True, slots=True)
class Formula:
    method: Method  # Which
    instruments: tuple[Column, ...] = ()  # May be empty
    rounds: int = 1  # Estimates one after the other, each divided by the output's side at the one before it

    def estimate(self, equation: KnownEquation, record: ev.Signals) -> ev.Estimate:
        """Estimate that is divided by the output's side at the equation's guess first."""
        guess = equation.guess
        for _ in range(self.rounds):
            problem = equation.model.problem(record, self.instruments, divided_by_output_at=guess)
            result = ev.identify(problem, self.method)
            guess = result.parameters
        return result


def formulas() -> dict[str, Formula]:
    current, reference = (tuple(ev.Column(name, lag) for lag in REACH) for name in ("input", "reference"))
    return {
        "least_squares": Formula(ev.methods.least_squares()),
        "total_least_squares": Formula(ev.methods.total_least_squares()),
        "bias_compensated_least_squares": Formula(ev.methods.bias_compensated_least_squares()),
        "extended_iv, reference": Formula(ev.methods.extended_iv(), reference),
        "generalized_iv": Formula(ev.methods.generalized_iv(), current),
        "generalized_iv, two-stage": Formula(ev.methods.generalized_iv(ev.methods.TwoStage()), current),
        "generalized_iv_tls": Formula(ev.methods.generalized_iv_tls(), current),
    }


def sharper_ways() -> dict[str, Formula]:
    """Methods that allow for the noise, with instruments that reach further, or a second round."""
    current, reference = (tuple(ev.Column(name, lag) for lag in FAR) for name in ("input", "reference"))
    return {
        "total_least_squares, again": Formula(ev.methods.total_least_squares(), rounds=2),
        "bias_compensated_least_squares, again": Formula(
            ev.methods.bias_compensated_least_squares(), rounds=2
        ),
        "extended_iv, reference, far": Formula(ev.methods.extended_iv(), reference),
        "generalized_iv, far": Formula(ev.methods.generalized_iv(), current),
    }


PART, SHARPER_PART = "fractional study", "sharper orders"
SCENARIOS: tuple[KnownEquation, ...] = (Relaxation(), Cell())
HEADER = ("method", "answers", "parameter", "truth", "bias %", "sd %", "largest error", "coverage")


def answers(
    scenario: KnownEquation, formula: Formula, seeds: Sequence[int]
) -> Float[np.ndarray, "answers parameters 2"]:
    """Error of each parameter, and whether its interval covers the truth; one line for each answer."""
    lines = []
    for seed in seeds:
        try:
            result = formula.estimate(scenario, scenario.record(seed))
        except EstimationError:
            continue
        line = []
        for name, value in scenario.truth.items():
            low, high = result.interval(name)
            line.append((result.parameters[name] - value, float(low <= value <= high)))
        lines.append(line)
    return np.array(lines).reshape(-1, len(scenario.truth), 2)


def lines_of(scenario: KnownEquation, runs: int, chosen: Mapping[str, Formula]) -> Iterator[tuple[str, ...]]:
    for name, formula in chosen.items():
        result = answers(scenario, formula, range(runs))
        for index, (parameter, value) in enumerate(scenario.truth.items()):
            errors, covered = result[:, index, 0], result[:, index, 1]
            yield (
                f"`{name}`" if index == 0 else "",
                f"{len(result)}" if index == 0 else "",
                f"`{parameter}`",
                f"{value:.4g}",
                f"{100.0 * errors.mean() / value:+.2f}",
                f"{100.0 * errors.std() / abs(value):.2f}",
                f"{np.abs(errors).max():.4f}",
                f"{100.0 * covered.mean():.1f} %",
            )


def tables(runs: int) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WeakInstrumentsWarning)
        return "\n\n".join(
            f"**{scenario.name}**: {scenario.about}; {runs:,} runs.\n\n"
            + markdown(HEADER, lines_of(scenario, runs, formulas()))
            for scenario in SCENARIOS
        )


def sharper(runs: int) -> str:
    """Table of the cell by ways that tell its order better."""
    cell = Cell()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WeakInstrumentsWarning)
        return f"**cell**, {runs:,} runs.\n\n" + markdown(HEADER, lines_of(cell, runs, sharper_ways()))


OPTIONS: dict[str, Option] = {
    "--runs": {"type": int, "default": 20, "help": "seeds of each scenario"},
    "--sharper": {"action": "store_true", "help": "the cell with further lags, or a second round"},
}
main = StudyCommand(
    "validation.fractional.study",
    __doc__,
    lambda chosen: SHARPER_PART if chosen.sharper else PART,
    lambda chosen: ((sharper if chosen.sharper else tables)(chosen.runs), ()),
    OPTIONS,
).main

if __name__ == "__main__":
    sys.exit(main())
