"""Noise of an input that nobody declared: where the search of it begins, and what is told of it.

Generalized instrumental variables with unknown noise (Soderstrom 2011) tell it from the input's own past,
roughly; the spectral equations then solve for it with the parameters. Of an input without memory neither can.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import EivorError, MissingNoiseError
from eivor.estimation.estimate import Estimate
from eivor.estimation.fitted_noise import FittedNoise
from eivor.estimation.method import Problem
from eivor.estimation.methods import generalized_iv_unknown_noise
from eivor.estimation.spectral.noise_fit import MEASURE
from eivor.estimation.spectral.sampled_problem import is_own_instrument, motion_of, with_instruments
from eivor.inference.verdict import Status
from eivor.models.signal_regression import SignalRegression
from eivor.signals.noise import WhiteNoise

#: Least share of the input's variance that a search begins at.
LEAST_SHARE = 1e-6


@dataclass(frozen=True, slots=True)
class Begun:
    """A problem with a noise of its input to begin with.

    Parameters
    ----------
    problem : Problem
        As it was, or with a noise of its input.
    sought : bool
        Whether that noise is unknown.
    """

    problem: Problem
    sought: bool = False


def begun(problem: Problem, method: str) -> Begun | Estimate:
    """Begin with the noise that is declared, with none for instruments of other channels, or a rough one.

    Where the record does not tell it, what was made of it all the same is returned, refused.

    Raises
    ------
    UsageError
        When the equation is no sampled motion.
    MissingNoiseError
        When it could not even be tried.
    """
    if not isinstance(problem, SignalRegression):
        return Begun(problem)
    _, _, driver = motion_of(problem, method)
    if driver in problem.signals.noise:
        return Begun(problem)
    problem = with_instruments(problem, driver)
    if not is_own_instrument(problem, driver):
        return Begun(_with_noise(problem, driver, 0.0))  # nothing is taken off
    try:
        found = generalized_iv_unknown_noise().estimate(problem)
    except (EivorError, np.linalg.LinAlgError) as error:
        raise MissingNoiseError(
            f"the noise of {driver}, which {method} takes off, or an input that tells it",
            f"none that is declared; and {error}",
            "Declare it: Signals(..., noise={'input': ev.WhiteNoise(0.01)}); zero says that it is exact.",
        ) from error
    if found.status is Status.REFUSED:
        return replace(found, method=method)
    least = LEAST_SHARE * float(np.var(problem.signals.channel(driver)))
    variance = max(found.parameters[f"noise_variance_{driver}"], least)
    return Begun(_with_noise(problem, driver, float(np.sqrt(variance))), sought=True)


def _with_noise(problem: SignalRegression, driver: str, std: float) -> SignalRegression:
    noise = {**problem.signals.noise, driver: WhiteNoise(std)}
    return replace(problem, signals=replace(problem.signals, noise=noise))


def told_input(variance: float, error: float) -> FittedNoise:
    """Noise of the input as it was found; a variance below zero is none."""
    strength = float(np.sqrt(max(variance, 0.0)))
    by_root = 0.5 * error / strength if strength else float(np.sqrt(error))
    return FittedNoise("input", strength, by_root, 0.0, 0.0, MEASURE)
