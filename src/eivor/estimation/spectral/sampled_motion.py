r"""The motion a = -K v + b u between samples, in frequency, and the residuals of its two equations.

With a = exp(-K T), D = 1/(1 - a z^-1) and h = (1 - a)/K z^-1 D, the velocity answers an input u by g u,

    g = b h [(1 - rho) + rho z],

where rho says what the input does between samples: 0 when it is held, 1/2 when it is linear. The spectra A of
z'', V of z' and U of the input, unitary and without their means, leave

    r_1 = A + K V - b U,        r_2 = V - g U - t D,

where t is one real number: what the velocities at both ends of the record add to every bin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.estimation.spectral.pair_spectrum import Pair, PairSpectrum
from eivor.shapes import Complex, Float

Bins = Complex[np.ndarray, " bins"]


def unitary_bins(values: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " bins"]:
    """Unitary spectrum of a series without its mean, at bins 1 to ceil(n/2) - 1."""
    count = values.size
    spectrum: Complex[np.ndarray, " bins"] = np.fft.rfft(values - values.mean())
    return spectrum[1 : -(-count // 2)] / np.sqrt(count)


@dataclass(frozen=True)
class SampledRecord:
    """Spectra of a record of z', z'' and u.

    Parameters
    ----------
    step_s : float
        Time between samples [s].
    count : int
        Number of samples.
    acceleration, velocity, input : ndarray, shape (bins,)
        Unitary spectra.
    """

    step_s: float
    count: int
    acceleration: Bins
    velocity: Bins
    input: Bins

    @cached_property
    def angle(self) -> Float[np.ndarray, " bins"]:
        """Angular frequency of each bin, in radians per sample."""
        return 2.0 * np.pi * np.arange(1, self.input.size + 1) / self.count

    @cached_property
    def earlier(self) -> Bins:
        """z^-1 of each bin."""
        return np.exp(-1j * self.angle)

    @cached_property
    def later(self) -> Bins:
        """Each bin of z."""
        return self.earlier.conj()

    @cached_property
    def ramp(self) -> Bins:
        """Spectrum of a line from -1/2 to 1/2 over the record."""
        return unitary_bins(np.linspace(-0.5, 0.5, self.count))

    @cached_property
    def log_scale(self) -> Float[np.ndarray, " bins"]:
        """log(2 sin(w/2))."""
        scale: Float[np.ndarray, " bins"] = np.log(2.0 * np.sin(0.5 * self.angle))
        return scale

    def power(self, order: float) -> Float[np.ndarray, " bins"]:
        """Spectrum of Delta^order of white noise of variance one."""
        spectrum: Float[np.ndarray, " bins"] = np.exp(2.0 * order * self.log_scale)
        return spectrum


@dataclass(frozen=True)
class SampledMotion:
    """The motion at some parameters.

    Parameters
    ----------
    record : SampledRecord
        Whose bins.
    friction, gain : float
        K [1/s] and b = K_u.
    blend : float
        rho.
    """

    record: SampledRecord
    friction: float
    gain: float
    blend: float = 0.0

    @property
    def log_scale(self) -> Float[np.ndarray, " bins"]:
        """Of the record, see `SampledRecord.log_scale`."""
        return self.record.log_scale

    @property
    def decay(self) -> float:
        """exp(-K T)."""
        return float(np.exp(-self.friction * self.record.step_s))

    @cached_property
    def memory(self) -> Bins:
        """D."""
        return 1.0 / (1.0 - self.decay * self.record.earlier)

    @property
    def held(self) -> float:
        """(1 - a)/K, and T where K is zero."""
        K, step = self.friction, self.record.step_s
        return float(-np.expm1(-K * step) / K) if K != 0.0 else step

    @cached_property
    def pushed(self) -> Bins:
        """h, the velocity that an acceleration held between samples makes."""
        return self.held * self.record.earlier * self.memory

    @cached_property
    def pushed_by_friction(self) -> Bins:
        """dh/dK."""
        step, K = self.record.step_s, self.friction
        by_held = (step * self.decay - self.held) / K if K != 0.0 else -0.5 * step**2
        moved = by_held - self.held * step * self.decay * self.record.earlier * self.memory
        return self.record.earlier * self.memory * moved

    @cached_property
    def _between(self) -> Bins:
        return (1.0 - self.blend) + self.blend * self.record.later

    @cached_property
    def response(self) -> Bins:
        """Response of the velocity to the input: g."""
        return self.gain * self.pushed * self._between

    @cached_property
    def response_by_friction(self) -> Bins:
        """dg/dK."""
        return self.gain * self._between * self.pushed_by_friction

    @cached_property
    def directions(self) -> Complex[np.ndarray, "3 2 bins"]:
        """d_K, d_b and d_rho: derivatives of the residuals by the parameters, over the true input."""
        found = np.empty((3, 2, self.response.size), dtype=np.complex128)
        found[0] = self.response, -self.response_by_friction
        found[1, 0] = -1.0
        found[1, 1] = self.pushed * -self._between
        found[2, 0] = 0.0
        found[2, 1] = (-self.gain * self.pushed) * (self.record.later - 1.0)
        return found

    @cached_property
    def input_noise(self) -> Pair:
        """The pair s = [b; g]: minus what an error of the input does to the residuals."""
        return np.stack([np.full_like(self.response, self.gain), self.response])

    def residuals(self) -> Pair:
        """r_1 and r_2 without the transient."""
        record = self.record
        return np.stack(
            [
                record.acceleration + self.friction * record.velocity - self.gain * record.input,
                record.velocity - self.response * record.input,
            ]
        )

    def shapes(self) -> tuple[PairSpectrum, PairSpectrum, PairSpectrum, PairSpectrum]:
        """C of one unit of noise of the input, of z', of z'' and of a disturbance that moves the vehicle."""
        ones = np.ones(self.response.size)
        K, b, h = self.friction, self.gain, self.pushed
        return (
            PairSpectrum(b * b * ones, np.abs(self.response) ** 2, b * self.response.conj()),
            PairSpectrum(K * K * ones, ones, K * ones.astype(complex)),
            PairSpectrum(ones, 0.0 * ones, 0.0j * ones),
            PairSpectrum(ones, np.abs(h) ** 2, h.conj()),
        )

    def whole(self, nuisances: Float[np.ndarray, " q"], shapes: Complex[np.ndarray, "q 2 bins"]) -> Pair:
        """Residuals with the nuisances' parts taken off: r + sum of c psi."""
        found: Pair = self.residuals()
        for one, shape in zip(nuisances.tolist(), shapes, strict=True):
            found += one * shape
        return found

    def nuisance_shapes(self, ramps: bool) -> Complex[np.ndarray, "q 2 bins"]:
        """psi: [0; -D], and with ramps [-F; 0] and [0; -F]."""
        found = np.zeros((3 if ramps else 1, 2, self.memory.size), dtype=np.complex128)
        found[0, 1] = -self.memory
        if ramps:
            found[1, 0] = found[2, 1] = -self.record.ramp
        return found
