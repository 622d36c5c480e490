r"""The equations of the spectral generalized instrumental variables, and their solution.

    sum of w c Re{ d_j^H C^-1 (U* r + s sigma_u^2) } = 0        for each parameter j
    sum of c Re{ psi^H C^-1 r } = 0                             for each nuisance

over bins: instruments of the least variance are what the parameters do to the residuals, whitened twice. The
term s sigma_u^2 takes off what the input's noise adds, the compensation of (28)-(31) in frequency.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import EstimationError
from eivor.estimation.spectral.noise_model import fitted_noise
from eivor.estimation.spectral.pair_spectrum import Pair, PairSpectrum
from eivor.estimation.spectral.pilot import Pilot
from eivor.estimation.spectral.sampled_motion import SampledMotion
from eivor.estimation.spectral.weights import corrected_spectrum, held_back, signal_weights
from eivor.shapes import Complex, Float

#: Passes of spectrum and equations, Newton's steps in each, and the relative change that ends them.
PASSES, STEPS, STILL = 8, 12, 1e-7
#: Relative change of the parameters in a pass below which they rest.
AT_REST = 1e-4
#: Largest share of a parameter that one step may change it by.
LARGEST_SHARE = 0.5
#: Fewest samples with ramps among the nuisances.
RAMP_SAMPLES = 400


@dataclass(frozen=True)
class SpectralSolution:
    """Solution of the equations, with what its covariance is made of.

    Parameters
    ----------
    motion : SampledMotion
        Parameters.
    nuisances : ndarray, shape (q,)
        Transient, and ramps.
    spectrum : PairSpectrum
        C.
    instrument : ndarray, shape (bins,)
        U, or what instruments say of it.
    input_variance : float
        sigma_u^2; zero with instruments that do not share the input's noise.
    weights, factors : ndarray, shape (bins,)
        w and c.
    free_blend : bool
        Whether rho is a parameter.
    change : float
        Relative change of the parameters in the last pass.
    """

    motion: SampledMotion
    nuisances: Float[np.ndarray, " q"]
    spectrum: PairSpectrum
    instrument: Complex[np.ndarray, " bins"]
    input_variance: float
    weights: Float[np.ndarray, " bins"]
    factors: Float[np.ndarray, " bins"]
    free_blend: bool
    change: float = np.inf

    @property
    def settled(self) -> bool:
        """Whether the last pass left the parameters where they were."""
        return self.change < AT_REST

    @property
    def parameters(self) -> int:
        """How many: K, b, and rho where it is free."""
        return 3 if self.free_blend else 2

    @property
    def residual(self) -> Pair:
        """r, without the nuisances' part."""
        return self.motion.whole(self.nuisances, self.nuisance_shapes)

    @property
    def nuisance_shapes(self) -> Complex[np.ndarray, "q 2 bins"]:
        """What nuisances do to the residuals: psi."""
        return self.motion.nuisance_shapes(self.nuisances.size > 1)

    @property
    def tests(self) -> Complex[np.ndarray, "n 2 bins"]:
        """Test functions before C^-1: w c U d_j, and c psi."""
        own = self.motion.directions[: self.parameters] * (self.weights * self.factors * self.instrument)
        return np.concatenate([own, self.nuisance_shapes * self.factors])

    def scores(self) -> Float[np.ndarray, " n"]:
        """Left sides of the equations."""
        weighted = self.spectrum.solved(self.residual)
        found = np.einsum("jkb,kb->j", self.tests.conj(), weighted).real
        if self.input_variance:
            shared = self.spectrum.solved(self.motion.input_noise) * (self.weights * self.factors)
            own = self.motion.directions[: self.parameters]
            found[: self.parameters] += self.input_variance * np.einsum("jkb,kb->j", own.conj(), shared).real
        return found

    def stepped(self) -> SampledMotion:
        """Parameters after one of Newton's steps."""
        step = -np.linalg.solve(self.sensitivities().sum(axis=2), self.scores())
        return moved_by(self.motion, step[: self.parameters])

    def sensitivities(self) -> Float[np.ndarray, "n n bins"]:
        """Share of each bin in the derivative of the equations by parameters and nuisances."""
        count = self.parameters
        own, nuisances = self.motion.directions[:count], self.nuisance_shapes
        moved = np.concatenate([own * self.motion.record.input, nuisances])
        weighted = np.stack([self.spectrum.solved(one) for one in moved])
        found = np.einsum("jkb,lkb->jlb", self.tests.conj(), weighted).real
        if self.input_variance:
            plain = np.stack([self.spectrum.solved(one) for one in own])
            taken = np.einsum("jkb,lkb->jlb", own.conj(), plain).real * (self.weights * self.factors)
            found[:count, :count] -= self.input_variance * taken
        return found


def solved_equations(
    pilot: Pilot,
    input_variance: float,
    instrument: Complex[np.ndarray, " bins"] | None = None,
    free_blend: bool = False,
) -> SpectralSolution:
    """Solve from a pilot, with instruments of the input's own spectrum or another.

    Raises
    ------
    EstimationError
        When a step has no solution, or friction or gain leave what the relation can hold.
    """
    record = pilot.motion.record
    ramps = record.count >= RAMP_SAMPLES
    closed = instrument is not None
    bins = record.input if instrument is None else instrument
    weights = np.ones(bins.size) if closed else signal_weights(record.input, input_variance)
    nuisances = np.array([pilot.transient, 0.0, 0.0])[: 3 if ramps else 1]
    noise, leverage = pilot.noise, np.zeros(bins.size)
    now = SpectralSolution(
        pilot.motion,
        nuisances,
        noise.spectrum(pilot.motion),
        bins,
        0.0 if closed else input_variance,
        weights,
        np.ones(bins.size),
        free_blend,
    )
    for number in range(PASSES):
        residual = now.residual
        noise = fitted_noise(now.motion, residual, noise, pilot.prior) if number else noise
        C = corrected_spectrum(noise.spectrum(now.motion), residual, leverage)
        now = replace(now, spectrum=C, factors=held_back(residual, C))
        before = now.motion
        now, leverage = _newton(now)
        change = abs(now.motion.friction / before.friction - 1.0) + abs(now.motion.gain / before.gain - 1.0)
        now = replace(now, change=change)
        if now.settled:
            break
    return now


def _newton(now: SpectralSolution) -> tuple[SpectralSolution, Float[np.ndarray, " bins"]]:
    """Newton's steps at fixed weights; the leverage of each bin at their beginning."""
    shares = now.sensitivities()
    total = shares.sum(axis=2)
    try:
        inverse = np.linalg.inv(total)
    except np.linalg.LinAlgError as error:
        raise EstimationError(
            "an input that moves the vehicle", "equations without a unique solution", "Excite it more."
        ) from error
    for _ in range(STEPS):
        step = -inverse @ now.scores()
        largest = float(np.max(np.abs(step[:2]) / np.abs([now.motion.friction, now.motion.gain])))
        if largest > LARGEST_SHARE:
            step *= LARGEST_SHARE / largest
        motion = moved_by(now.motion, step[: now.parameters])
        now = replace(now, motion=motion, nuisances=now.nuisances + step[now.parameters :])
        if largest < STILL:
            break
    return now, np.clip(np.einsum("jl,ljb->b", inverse, shares), 0.0, None)


def moved_by(motion: SampledMotion, step: Float[np.ndarray, " n"]) -> SampledMotion:
    """Motion whose friction, gain, and rho where the step has one, are moved."""
    friction, gain, blend = np.array([motion.friction, motion.gain, motion.blend]) + np.pad(
        step, (0, 3 - step.size)
    )
    return replace(motion, friction=float(friction), gain=float(gain), blend=float(blend))
