"""What spectral methods take from a regression: a sampled motion, its input's noise, instruments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import InstrumentError, MissingNoiseError, UsageError
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
    noise_sought : bool
        Whether the noise of the input is unknown, and `input_variance` but where the search of it begins.
    """

    problem: SignalRegression
    record: SampledRecord
    input_variance: float
    instrument: Complex[np.ndarray, " bins"] | None
    declared: tuple[MeasurementNoise | None, MeasurementNoise | None]
    noise_sought: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Friction and gain."""
        return self.problem.parameters


def problem_of_motion(problem: Problem, method: str) -> SignalRegression:
    """Take a problem for a spectral method; without instruments it has lagged inputs.

    Raises
    ------
    UsageError
        When it is no regression in signals, its equation no sampled motion, or the input's noise not white.
    MissingNoiseError
        When nothing is declared of the noise of the input.
    """
    if not isinstance(problem, SignalRegression):
        raise UsageError(
            f"a record of one motion for {method}, sampled evenly",
            type(problem).__name__,
            "Make it of signals: ev.VerticalMotion(intercept=False).regression(signals, instruments).",
        )
    driver = motion_of(problem, method)[2]
    noise = problem.signals.noise.get(driver)
    if noise is None:
        raise MissingNoiseError(
            f"the noise of {driver}, which {method} takes off",
            "none that is declared",
            "Declare it: Signals(..., noise={'input': ev.WhiteNoise(0.01)}); zero says that it is exact. To "
            "a likelihood it is a disturbance that moves the vehicle. ev.methods.spectral_giv() seeks it.",
        )
    if not isinstance(noise, WhiteNoise):
        raise UsageError(
            f"white noise of {driver} for {method}", f"a {type(noise).__name__}", "Use generalized_iv."
        )
    return with_instruments(problem, driver)


def without_spectra(problem: SignalRegression) -> tuple[str, str] | None:
    """Why a record has no spectra that could be told, and what to do; None where it has."""
    signals = problem.signals
    gaps = 0 if signals.valid is None else int((~signals.valid).sum())
    if gaps:
        return (
            f"{gaps} of {signals.sample_count} samples are not valid, and it needs a record without gaps",
            "Give the longest stretch between gaps, or repair the samples.",
        )
    if signals.sample_count < FEWEST_SAMPLES:
        return (
            f"there are {signals.sample_count} samples, and it needs {FEWEST_SAMPLES} at least",
            "Give a longer record.",
        )
    return None


def sampled_problem(problem: SignalRegression, method: str) -> SampledProblem:
    """Spectra of a problem that has them, see `problem_of_motion` and `without_spectra`.

    Raises
    ------
    InstrumentError
        When instruments of another channel are mixed with inputs.
    """
    state, response, driver = motion_of(problem, method)
    signals = problem.signals
    noise = signals.noise[driver]
    own = is_own_instrument(problem, driver)
    record = SampledRecord(
        signals.step_s,
        signals.sample_count,
        *(unitary_bins(signals.channel(name)) for name in (response, state, driver)),
    )
    instrument = None if own else unitary_bins(_projected(problem, driver, method))
    declared = signals.noise.get(state), signals.noise.get(response)
    return SampledProblem(problem, record, noise.std**2, instrument, declared)


def with_instruments(problem: SignalRegression, driver: str) -> SignalRegression:
    """The problem with lags of its input as instruments, where it brings none."""
    if problem.instrument_columns:
        return problem
    return replace(problem, instrument_columns=lags(driver, *PILOT_LAGS))


def is_own_instrument(problem: SignalRegression, driver: str) -> bool:
    """Whether the instruments are lags of the input itself."""
    return {column.channel for column in problem.instrument_columns} == {driver}


def motion_of(problem: SignalRegression, method: str) -> tuple[str, str, str]:
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
