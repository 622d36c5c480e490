"""What spectral methods take from a regression: a sampled motion, its input's noise, instruments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import InstrumentError, MissingNoiseError, TooFewSamplesError, UsageError
from eivor.estimation.method import Problem
from eivor.estimation.spectral.sampled_motion import SampledRecord, unitary_bins
from eivor.models.column import lags
from eivor.models.equation import Parameter
from eivor.models.signal_regression import SignalRegression
from eivor.shapes import Complex, Float
from eivor.signals.noise import MeasurementNoise, WhiteNoise

#: Fewest samples that spectra can be told from.
FEWEST_SAMPLES = 64
#: Lags of the input that are instruments of the pilot when the problem brings none.
PILOT_LAGS = (0, 10)


@dataclass(frozen=True)
class SampledProblem:
    """A record of one motion, sampled evenly.

    Parameters
    ----------
    problem : SignalRegression
        With instruments.
    record : SampledRecord
        Its spectra.
    input_variance : float
        Of the noise of the input; zero with instruments of another channel, which do not share it.
    instrument : ndarray, shape (bins,), or None
        What instruments of another channel say of the input; None where it is its own.
    declared : tuple of MeasurementNoise or None
        Noises of z' and of z'', where the record declares them.
    """

    problem: SignalRegression
    record: SampledRecord
    input_variance: float
    instrument: Complex[np.ndarray, " bins"] | None
    declared: tuple[MeasurementNoise | None, MeasurementNoise | None]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Friction and gain."""
        return self.problem.parameters


def sampled_problem(problem: Problem, method: str) -> SampledProblem:
    """Take a problem for a spectral method.

    Raises
    ------
    UsageError
        When it is no regression in signals, its equation no sampled motion, or the record has gaps.
    MissingNoiseError
        When nothing is declared of the noise of the input.
    TooFewSamplesError
        When spectra cannot be told.
    """
    if not isinstance(problem, SignalRegression):
        raise UsageError(
            f"a record of one motion for {method}, sampled evenly",
            type(problem).__name__,
            "Make it of signals: ev.VerticalMotion(intercept=False).regression(signals, instruments).",
        )
    state, response, driver = _motion_of(problem, method)
    signals = problem.signals
    if signals.valid is not None and not signals.valid.all():
        raise UsageError(
            f"a record without gaps for {method}",
            f"one with {int((~signals.valid).sum())} samples that are not valid",
            "Give a stretch of it, or use generalized_iv.",
        )
    if signals.sample_count < FEWEST_SAMPLES:
        raise TooFewSamplesError(
            f"at least {FEWEST_SAMPLES} samples for {method}", f"{signals.sample_count}", "Record longer."
        )
    noise = signals.noise.get(driver)
    if noise is None:
        raise MissingNoiseError(
            f"the noise of {driver}, which {method} takes off",
            "none that is declared",
            "Declare it: Signals(..., noise={'input': ev.WhiteNoise(0.01)}); zero says that it is exact. Or "
            "have it estimated: ev.methods.generalized_iv_unknown_noise().",
        )
    if not isinstance(noise, WhiteNoise):
        raise UsageError(
            f"white noise of {driver} for {method}", f"a {type(noise).__name__}", "Use generalized_iv."
        )
    if not problem.instrument_columns:
        problem = replace(problem, instrument_columns=lags(driver, *PILOT_LAGS))
    record = SampledRecord(
        signals.step_s,
        signals.sample_count,
        *(unitary_bins(signals.channel(name)) for name in (response, state, driver)),
    )
    own = {column.channel for column in problem.instrument_columns} == {driver}
    instrument = None if own else unitary_bins(_projected(problem, driver, method))
    declared = signals.noise.get(state), signals.noise.get(response)
    return SampledProblem(problem, record, noise.variance, instrument, declared)


def _motion_of(problem: SignalRegression, method: str) -> tuple[str, str, str]:
    """Channels of the state, of its derivative and of the input."""
    equation = problem.equation
    columns = [column for _, column in equation.terms]
    plain = [(column.channel, column.lag, column.gain, column.gain_channel) for column in columns]
    state = equation.derivative_of
    if not state or len(plain) != 2 or plain[0] != (state, 0, -1.0, "") or plain[1][1:] != (0, 1.0, ""):
        raise UsageError(
            f"the motion a = -K v + b u for {method}, where a is the derivative of v, without an intercept",
            f"{equation.response.name} explained by {', '.join(column.name for column in columns)}",
            "Use ev.VerticalMotion(intercept=False); means are taken off.",
        )
    return state, equation.response.channel, plain[1][0]


def _projected(problem: SignalRegression, driver: str, method: str) -> Float[np.ndarray, " samples"]:
    """What the instruments say of the input, by least squares; its mean before their first row."""
    if driver in {column.channel for column in problem.instrument_columns}:
        raise InstrumentError(
            f"instruments of the input alone, or of other channels alone, for {method}",
            ", ".join(column.name for column in problem.instrument_columns),
            "Under control give lags of the reference.",
        )
    Psi = np.column_stack([problem.column(column) for column in problem.instrument_columns])
    values = problem.signals.channel(driver)
    centred = Psi - Psi.mean(axis=0)
    told = centred @ np.linalg.lstsq(centred, values[problem.first :] - values.mean(), rcond=None)[0]
    return np.concatenate([np.zeros(problem.first), told])
