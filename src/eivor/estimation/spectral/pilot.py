"""Where a spectral method begins: generalized instrumental variables, and noises that fit what they leave."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from eivor.errors import WeakInstrumentsWarning
from eivor.estimation.estimate import Estimate
from eivor.estimation.methods import generalized_iv
from eivor.estimation.spectral.noise_fit import NoisePrior, fitted_noise, prior_of
from eivor.estimation.spectral.noise_model import NoiseModel
from eivor.estimation.spectral.sampled_motion import SampledMotion
from eivor.models.signal_regression import SignalRegression
from eivor.signals.noise import MeasurementNoise


@dataclass(frozen=True)
class Pilot:
    """Start of a search.

    Parameters
    ----------
    motion : SampledMotion
        Parameters.
    transient : float
        t.
    noise : NoiseModel
        Noises that fit.
    prior : NoisePrior
        What was known of them.
    """

    motion: SampledMotion
    transient: float
    noise: NoiseModel
    prior: NoisePrior


def consistent_estimate(problem: SignalRegression) -> Estimate:
    """Generalized IV of the same problem, without its warnings: what it says is used, or told, later."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WeakInstrumentsWarning)
        return generalized_iv().estimate(problem)


def pilot_at(
    motion: SampledMotion,
    input_variance: float,
    declared: tuple[MeasurementNoise | None, MeasurementNoise | None] = (None, None),
) -> Pilot:
    """Noises that fit the residuals at some parameters; those of z' and z'' as declared, where they are."""
    transient = first_transient(motion)
    residual = motion.whole(np.array([transient]), motion.nuisance_shapes(ramps=False))
    prior = prior_of(motion, residual, input_variance, declared)
    return Pilot(motion, transient, fitted_noise(motion, residual, prior.centre, prior), prior)


def first_transient(motion: SampledMotion) -> float:
    """The transient t by least squares on the second residual."""
    shape, residual = motion.memory, motion.residuals()[1]
    return float((shape.conj() * residual).real.sum() / (np.abs(shape) ** 2).sum())
