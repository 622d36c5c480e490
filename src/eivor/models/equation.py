"""Equations: a response, and a parameter for each column it is explained by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.models.column import Column
from eivor.models.parameter import Parameter
from eivor.models.regression import Regression
from eivor.signals.noise import WhiteNoise
from eivor.signals.signals import Signals


@dataclass(frozen=True, slots=True)
class Equation:
    """``response = sum of parameter * column + error``.

    Parameters
    ----------
    response : Column
        Left side.
    terms : tuple of (Parameter, Column)
        Right side, in the order of the parameter vector.
    """

    response: Column
    terms: tuple[tuple[Parameter, Column], ...]

    def regression(self, signals: Signals, instruments: tuple[Column, ...] = ()) -> Regression:
        """Cut the equation's rows out of `signals`; rows start at the largest lag of any column.

        Raises
        ------
        MissingChannelError
            When a channel is absent.
        TooFewSamplesError
            When the record is shorter than the largest lag and the number of parameters.
        """
        regressors = tuple(column for _, column in self.terms)
        first = max(column.lag for column in (self.response, *regressors, *instruments))
        rows = np.ones(signals.sample_count - first, dtype=np.bool_)
        if signals.valid is not None:
            rows = _all_valid(signals.valid, first)
        return Regression(
            self.response.values(signals, first)[rows],
            np.column_stack([column.values(signals, first) for column in regressors])[rows],
            np.column_stack([column.values(signals, first) for column in instruments])[rows]
            if instruments
            else np.empty((int(rows.sum()), 0)),
            tuple(parameter for parameter, _ in self.terms),
            regressors,
            instruments,
            self._error_scale(signals),
        )

    def _error_scale(self, signals: Signals) -> np.ndarray | None:
        """Declared standard deviations of the columns' errors; None when one is not declared."""
        scales = []
        for column in (*(column for _, column in self.terms), self.response):
            noise = signals.noise.get(column.channel)
            if column.channel and not isinstance(noise, WhiteNoise):
                return None
            scales.append(abs(column.gain) * noise.std if isinstance(noise, WhiteNoise) else 0.0)
        return np.array(scales)


def _all_valid(valid: np.ndarray, lag: int) -> np.ndarray:
    """Say for each row from `lag` on whether this sample and the `lag` before it are all valid."""
    broken = np.concatenate([[0], np.cumsum(~valid)])
    return np.asarray(broken[lag + 1 :] - broken[: valid.size - lag] == 0)
