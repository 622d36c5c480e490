"""Cramer-Rao bounds of a problem with known noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from eivor import checks
from eivor.errors import ParameterError
from eivor.estimation import sampled_motion as sampling
from eivor.lab.experiments import VerticalExperiment
from eivor.lab.records import DisturbanceRoute, Intersample, Scenario, SimulatedRecord, simulate
from eivor.signals.noise import FractionalNoise, MeasurementNoise, WhiteNoise
from eivor.tools import Complex, Float

__all__ = ["CramerRaoBound", "cramer_rao"]

#: Records that an input's power is averaged over when none are requested, and at most.
RUNS, MOST_RUNS = 20, 10_000
#: Records that a disturbance's power is averaged over: in each bin it is then known within 7 %.
DISTURBED_RUNS = 200


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True)
class CramerRaoBound:
    """Least covariance of unbiased estimates of friction and gain."""

    covariance: Float[np.ndarray, "2 2"]  # Inverse of the information, averaged over records
    truth: Mapping[str, float]  # True parameters, in the order of the covariance

    @property
    def std_errors(self) -> dict[str, float]:
        """Least standard deviation of each parameter, in its unit."""
        return dict(zip(self.truth, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def relative(self) -> dict[str, float]:
        """The same over the size of the parameter."""
        return {name: error / abs(self.truth[name]) for name, error in self.std_errors.items()}


def cramer_rao(scenario: Scenario, runs: int = RUNS, seed: int = 0) -> CramerRaoBound:
    """Cramer-Rao bound of a scenario of vertical motion.

    Parameters
    ----------
    scenario : Scenario
        In open loop, with noise of every channel.
    runs : int
        Records over which the information is averaged: inputs, noises and disturbances differ.
    seed : int
        Of the records.

    Returns
    -------
    CramerRaoBound
        Of `viscous_friction` [1/s] and `input_gain` [m/s^2 per unit of input].

    Raises
    ------
    ParameterError
        Under control, where the input is no given one; or when a channel has no noise.

    Notes
    -----
    A disturbance counts as stationary and normal, with the mean spectrum that it has over records. A trend,
    and whatever else they have alike, counts as known; a disturbance that is given, the same in every record,
    as white.
    """
    checks.kind("scenario", scenario, Scenario, "a Scenario", "Make one: ev.Scenario(0.3, 0.02).")
    checks.whole("runs", runs)
    checks.seed(seed)
    if scenario.control is not None:
        expected = "a scenario in open loop, for its bound"
        remedy = "Leave the control out; its bound is that of the open loop with the same input."
        raise ParameterError(expected, "one under control, whose input depends on the noises", remedy)
    if not 1 <= runs <= MOST_RUNS:
        raise ParameterError(f"1 to {MOST_RUNS} records", f"runs={runs}", f"Leave it out for {RUNS}.")
    power = disturbance_power(scenario, seed)
    information = np.mean(
        [_information(scenario, record, power) for record in _records(scenario, seed, runs)], axis=0
    )
    return CramerRaoBound(np.linalg.inv(information), VerticalExperiment(scenario).truth)


def _records(scenario: Scenario, seed: int, runs: int) -> Iterator[SimulatedRecord]:
    return (simulate(scenario, np.random.default_rng([seed, run])) for run in range(runs))


def disturbance_power(scenario: Scenario, seed: int = 0) -> Float[np.ndarray, " bins"]:
    """Mean power of a scenario's disturbance in each bin, over records: of unitary bins, as a variance."""
    series = (record.truth.channel("disturbance") for record in _records(scenario, seed, DISTURBED_RUNS))
    first = next(series)
    equal, power = sampling.unitary_bins(first), np.abs(sampling.unitary_bins(first)) ** 2
    differs = False
    for other in series:
        differs = differs or not np.array_equal(first, other)
        bins = sampling.unitary_bins(other)
        equal, power = equal + bins, power + np.abs(bins) ** 2
    if not differs:
        return np.full(equal.size, float(first.var()))
    return (power - np.abs(equal) ** 2 / DISTURBED_RUNS) / (DISTURBED_RUNS - 1)


def _information(
    scenario: Scenario, record: SimulatedRecord, power: Float[np.ndarray, " bins"]
) -> Float[np.ndarray, "2 2"]:
    signals = record.signals
    U = sampling.unitary_bins(record.truth.channel("input"))
    bins = sampling.SampledRecord(signals.step_s, signals.sample_count, U, U, U)
    blend = 0.5 if scenario.intersample is Intersample.LINEAR else 0.0
    motion = sampling.SampledMotion(bins, scenario.viscous_friction, scenario.input_gain, blend)
    known = replace(noise_of_record(scenario, record), disturbance=power)
    C = known.spectrum(motion)
    d = motion.directions[:2]
    information = 2.0 * np.einsum("jkb,lkb,b->jl", d.conj(), C.solved(d), np.abs(U) ** 2).real
    if known.moves and power.any():
        information[0, 0] += _shaped_noise_information(known, motion)
    return np.asarray(information)


@dataclass(frozen=True)
class KnownNoise:
    """Noises of a simulated record as they really are."""

    noise: sampling.NoiseModel
    disturbance: Float[np.ndarray, " bins"]
    moves: bool

    def spectrum(self, motion: sampling.SampledMotion) -> sampling.PairSpectrum:
        """C of the residuals."""
        _, _, of_response, of_disturbance = motion.shapes()
        shape = of_disturbance if self.moves else of_response
        return self.noise.spectrum(motion) + shape * self.disturbance


def noise_of_record(scenario: Scenario, record: SimulatedRecord) -> KnownNoise:
    """Noises of one record of a scenario; its disturbance counts as white."""
    series = record.truth.channel("disturbance")
    white = np.full(sampling.unitary_bins(series).size, float(series.var()))
    return KnownNoise(_known_noise(record.signals.noise), white, scenario.route is DisturbanceRoute.DYNAMICS)


def _known_noise(noises: Mapping[str, MeasurementNoise]) -> sampling.NoiseModel:
    """Strengths and orders that a scenario's record really has; no disturbance."""
    variances, orders = [], []
    for name in ("input", "velocity_z", "acceleration_z"):
        noise = noises[name]
        if not isinstance(noise, WhiteNoise | FractionalNoise) or noise.std == 0.0:
            expected = "white or fractional noise of input, velocity and response, for a bound"
            received = f"{name} without" if noise.std == 0.0 else type(noise).__name__
            remedy = "Give every channel some noise; without, nothing bounds an estimate."
            raise ParameterError(expected, received, remedy)
        variances.append(noise.std**2)
        orders.append(noise.order if isinstance(noise, FractionalNoise) else 0.0)
    if orders[0] != 0.0:
        raise ParameterError("white noise of the input, for a bound", "fractional noise", "Use WhiteNoise.")
    return sampling.NoiseModel(variances[0], np.array([*variances[1:], 0.0]), np.array([*orders[1:], 0.0]))


def _shaped_noise_information(known: KnownNoise, motion: sampling.SampledMotion) -> float:
    """tr(R^-1 R_K R^-1 R_K), of a disturbance that the friction shapes, summed over bins."""
    record, h, noise = motion.record, motion.pushed, known.noise
    power = known.disturbance[:, None, None]
    by_friction = motion.pushed_by_friction
    q = np.stack([1.0 - motion.friction * h, h, 0.0 * h], axis=-1)
    q_K = np.stack([-h - motion.friction * by_friction, by_friction, 0.0 * h], axis=-1)
    R = power * _outer(q, q)
    index = np.arange(3)
    known_powers = zip(noise.variances[:2].tolist(), noise.orders[:2].tolist(), strict=True)
    velocity, acceleration = (
        variance * np.exp(2.0 * order * record.log_scale) for variance, order in known_powers
    )
    R[:, index, index] += np.stack([acceleration, velocity, np.full(h.size, noise.input_variance)], axis=-1)
    share = np.linalg.solve(R, power * (_outer(q_K, q) + _outer(q, q_K)))
    return float(np.einsum("bij,bji->", share, share).real)


def _outer(
    left: Complex[np.ndarray, "bins 3"], right: Complex[np.ndarray, "bins 3"]
) -> Complex[np.ndarray, "bins 3 3"]:
    return left[:, :, None] * right[:, None, :].conj()
