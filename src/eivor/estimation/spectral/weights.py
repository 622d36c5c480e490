r"""Weights of bins: how much of the input is signal, how far a residual is out, and the spectrum of both.

The spectrum of the residuals is the fitted noise model's, corrected by what the residuals themselves say:
their periodogram, whitened by the model, averaged over neighbours, drawn towards the identity, and coloured
again. A model that is wrong then costs efficiency and no consistency.
"""

from __future__ import annotations

import numpy as np

from eivor.estimation.spectral.pair_spectrum import Pair, PairSpectrum, inner
from eivor.shapes import Complex, Float

#: Neighbours of a bin, on each side, that tell the power of its input without itself.
INPUT_NEIGHBOURS = 3
#: A bin is a line of the input where its power exceeds its noise and its neighbours' power by this factor.
LINE = 12.0
#: Least share of signal in the input's power.
LEAST_SHARE = 1e-3
#: Squared distance of a pair of residuals beyond which it is held back.
FAR = 12.0
#: Neighbours on each side that periodograms are averaged over, at least and at most, and how many averaged
#: ones the identity counts for.
FEWEST, MOST, IDENTITY = 6, 100, 6.0
#: Largest leverage that a residual is corrected for.
LARGEST_LEVERAGE = 3.0


def signal_weights(
    spectrum: Complex[np.ndarray, " bins"], noise_variance: float
) -> Float[np.ndarray, " bins"]:
    """w, the squared share of signal in the input's power near each bin.

    The power is that of the neighbours. A bin's own power would correlate its weight with its noise, which
    biases the equations. Only a line counts its own: its weight is near one whatever its noise.
    """
    own, around = np.abs(spectrum) ** 2, power_around(spectrum)
    line = own > LINE * np.maximum(around, noise_variance)
    share = 1.0 - noise_variance / np.where(line, own, around)
    weights: Float[np.ndarray, " bins"] = np.clip(share, LEAST_SHARE, 1.0) ** 2
    return weights


def power_around(spectrum: Complex[np.ndarray, " bins"]) -> Float[np.ndarray, " bins"]:
    """Power near each bin, without the bin itself."""
    power = np.abs(spectrum) ** 2
    index = np.arange(power.size)
    first = np.maximum(index - INPUT_NEIGHBOURS, 0)
    last = np.minimum(index + INPUT_NEIGHBOURS + 1, power.size)
    sums = np.concatenate([[0.0], np.cumsum(power)])
    around = (sums[last] - sums[first] - power) / np.maximum(last - first - 1, 1)
    found: Float[np.ndarray, " bins"] = np.maximum(around, np.finfo(np.float64).tiny)
    return found


def held_back(residual: Pair, C: PairSpectrum) -> Float[np.ndarray, " bins"]:
    """min(1, 12 / r^H C^-1 r)."""
    distance = inner(residual, C.solved(residual)).real
    factors: Float[np.ndarray, " bins"] = np.minimum(1.0, FAR / np.maximum(distance, 1e-300))
    return factors


def corrected_spectrum(
    model: PairSpectrum, residual: Pair, leverage: Float[np.ndarray, " bins"]
) -> PairSpectrum:
    """Spectrum of the residuals, the model corrected by their own periodogram.

    `leverage` is the share of each bin in the information about the parameters, summed over them: a residual
    is that much smaller than an error.
    """
    lost = np.sqrt(1.0 - np.minimum(leverage, LARGEST_LEVERAGE) / 4.0)
    white = model.whitened(residual) / lost
    index = np.arange(white.shape[1])
    half = np.clip(index + 1, FEWEST, MOST)
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, index.size)
    count = (last - first).astype(np.float64)

    def averaged(values: np.ndarray) -> np.ndarray:
        sums = np.concatenate([np.zeros(1, values.dtype), np.cumsum(values)])
        return (sums[last] - sums[first]) / count

    products = np.stack([np.abs(white[0]) ** 2, np.abs(white[1]) ** 2], axis=1)
    one, two = shrunk(np.stack([averaged(each) for each in products.T], axis=1), count).T
    across = averaged(white[0] * white[1].conj()) * (count / (count + IDENTITY))
    return recoloured(model, one, two, across)


def shrunk(
    powers: Float[np.ndarray, "bins k"], count: Float[np.ndarray, " bins"]
) -> Float[np.ndarray, "bins k"]:
    """Averaged powers of what should be one, drawn to that by as much as it counts beside them."""
    share = (count / (count + IDENTITY))[:, None]
    drawn: Float[np.ndarray, "bins k"] = share * powers + 1.0 - share
    return drawn


def recoloured(
    model: PairSpectrum,
    one: Float[np.ndarray, " bins"],
    two: Float[np.ndarray, " bins"],
    across: Complex[np.ndarray, " bins"],
) -> PairSpectrum:
    """L P L^H of a model L L^H and powers P of what it whitened."""
    top, below, bottom = model.root
    # L = [top 0; below bottom]
    return PairSpectrum(
        top**2 * one,
        np.abs(below) ** 2 * one + bottom**2 * two + 2.0 * (below * across * bottom).real,
        top * (one * below.conj() + across * bottom),
    )
