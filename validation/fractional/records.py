"""Records with known truth: a relaxation of samples, and a cell's current and voltage by analysis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np

import eivor as ev
from eivor.estimation.method import Method
from eivor.models.regression import Column
from eivor.signals.filters import filtered
from eivor.tools import Float
from validation.fractional.relaxation import driven, ramp_response

Series = Float[np.ndarray, " n"]
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
        """Input and output of the recursion."""
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
    """A method with its instruments."""

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
    """Methods of the paper by name."""
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
