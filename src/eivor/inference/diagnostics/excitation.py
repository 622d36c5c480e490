"""Whether a record excites every parameter: information matrix, and input against residual by frequency.

The information is mean(G G') for direct methods and A' mean(psi psi')^-1 A for instrumental ones. It is
scaled to a unit diagonal, so that an eigenvector names a combination of the columns and units do not count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.inference.diagnostics.diagnostic import Diagnostic, Row, Subject
from eivor.inference.diagnostics.equation_products import EquationProducts
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float

#: Variance below this share of a column's largest square is rounding: the column is constant.
VANISHING = 1e-24
#: Samples of a stretch whose spectrum is taken, how many stretches, and how many bands.
STRETCH = 4096
STRETCHES = 16
BANDS = 8
#: Condition of the scaled information from which a combination is called badly determined.
BADLY_CONDITIONED = 1e3


@dataclass(frozen=True)
class Information(Diagnostic):
    """Scaled information matrix.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Unit diagonal.
    eigenvalues : ndarray, shape (n,)
        Increasing; all one when no column can be mistaken for others.
    eigenvectors : ndarray, shape (n, n)
        Columns, in the order of `eigenvalues`; the first is the combination that is determined worst.
    """

    matrix: Float[np.ndarray, "n n"]
    eigenvalues: Float[np.ndarray, " n"]
    eigenvectors: Float[np.ndarray, "n n"]

    @property
    def condition(self) -> float:
        """Largest over smallest eigenvalue; the square root is a ratio of standard errors."""
        smallest = float(self.eigenvalues[0])
        return float(self.eigenvalues[-1]) / smallest if smallest > 0.0 else float("inf")

    def worst(self, names: tuple[str, ...]) -> str:
        """The combination that is determined worst, in words: ``0.71 gain - 0.71 friction``."""
        v = self.eigenvectors[:, 0]
        v = v * np.sign(v[np.argmax(np.abs(v))])
        told = [j for j in np.argsort(-np.abs(v), kind="stable") if abs(v[j]) >= 0.1]
        text = " ".join(f"{'-' if v[j] < 0.0 else '+'} {abs(v[j]):.2f} {names[j]}" for j in told)
        return text.removeprefix("+ ")

    def rows(self, _of: Subject, /) -> Iterator[Row]:
        """The condition."""
        yield Row("information_condition", "", self.condition, None)

    def lines(self, of: Subject, /) -> Iterator[str]:
        """The condition, and which combination is determined worst."""
        yield f"information          {self.condition:>10.4g}  condition; worst: {self.worst(of.names)}"

    def reasons(self, of: Subject, /) -> Iterator[Reason]:
        """A combination that is determined badly."""
        if self.condition > BADLY_CONDITIONED:
            yield Reason(
                Status.WEAK,
                f"One combination of the parameters is determined {np.sqrt(self.condition):.0f} times "
                f"worse than another: {self.worst(of.names)}, each in units of its column's rms.",
                "Excite them apart from each other, or fix one of them.",
            )


@dataclass(frozen=True)
class BandPower(Diagnostic):
    """Power of the model part against that of the residual in bands.

    Parameters
    ----------
    low_hz, high_hz : ndarray, shape (bands,)
        Ends of each band [Hz]; cycles per sample when the rate is not known.
    input_power : ndarray, shape (bands, n)
        Power of each column times its parameter, in the response's unit squared.
    residual_power : ndarray, shape (bands,)
        The residual's.
    share_above : ndarray, shape (n,)
        Share of each column's power in bands where it is above the residual's.
    """

    low_hz: Float[np.ndarray, " bands"]
    high_hz: Float[np.ndarray, " bands"]
    input_power: Float[np.ndarray, "bands n"]
    residual_power: Float[np.ndarray, " bands"]
    share_above: Float[np.ndarray, " n"]

    @property
    def excited(self) -> np.ndarray:
        """In which bands the power of each column is above the residual's, shape (bands, n)."""
        return self.input_power > self.residual_power[:, None]

    def rows(self, of: Subject, /) -> Iterator[Row]:
        """Share of each column above the residual, and both powers in every band."""
        linear = of.names[: self.share_above.size]
        for name, share in zip(linear, self.share_above, strict=True):
            if not math.isnan(share):
                yield Row("power_above", name, float(share), None)
        for b, (low, high) in enumerate(zip(self.low_hz, self.high_hz, strict=True)):
            for j, name in enumerate(linear):
                power, residual = float(self.input_power[b, j]), float(self.residual_power[b])
                yield Row("band_power", f"{name}, {low:.3g} to {high:.3g} Hz", power, residual)

    def lines(self, of: Subject, /) -> Iterator[str]:
        """Share of each column above the residual."""
        for name, share in zip(of.names, self.share_above, strict=False):
            if not math.isnan(share):
                yield f"power above residual {share:>10.0%}  {name}"

    def reasons(self, of: Subject, /) -> Iterator[Reason]:
        """Columns that contribute mostly where the residual is stronger."""
        for name, share in zip(of.names, self.share_above, strict=False):
            if share < 0.5:
                yield Reason(
                    Status.IDENTIFIED,
                    f"{1.0 - share:.0%} of what {name} contributes lies in bands where the residual is "
                    "stronger.",
                    "Excite at other frequencies, or harder.",
                )


def largest(series: Float[np.ndarray, " rows"]) -> float:
    """Largest absolute value, without an array of them."""
    return max(float(series.max()), -float(series.min()))


def information(products: EquationProducts, *, instrumental: bool) -> Information:
    """Information about the parameters, scaled. Performs no checks.

    Parameters
    ----------
    products : EquationProducts
        At the estimate.
    instrumental : bool
        By way of the instruments, as A' mean(psi psi')^-1 A; False takes mean(G G').
    """
    matrix = products.regressor_mean
    if instrumental:
        a = products.whitening.T @ products.sensitivity
        matrix = a.T @ a
    length = np.sqrt(np.diag(matrix))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    matrix = np.outer(scale, scale) * matrix
    values, vectors = np.linalg.eigh(matrix)
    return Information(matrix, values, vectors)


def band_power(
    columns: Sequence[Float[np.ndarray, " rows"]],
    factors: Sequence[float],
    residual: Float[np.ndarray, " rows"],
    rate_hz: float = 1.0,
) -> BandPower:
    """Spectra of what each column contributes and of the residual, in bands of equal ratio.

    Parameters
    ----------
    columns : sequence of ndarray, shapes (rows,)
        Columns of the model, in time order.
    factors : sequence of float
        Their parameters.
    residual : ndarray, shape (rows,)
        e.
    rate_hz : float
        Samples per second.

    Notes
    -----
    Performs no checks. Hann windows over at most 16 stretches of at most 4096 samples, evenly spread over
    the record (Welch 1967), so that the cost does not grow with it. Frequencies below those of a stretch
    are not seen.
    """
    length = min(STRETCH, residual.size)
    number = min(STRETCHES, residual.size // length)
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    bins = length // 2
    power = np.zeros((len(columns) + 1, bins))
    for start in np.linspace(0, residual.size - length, number).astype(np.int64):
        block = np.stack([series[start : start + length] for series in (*columns, residual)])
        block = (block - block.mean(axis=1, keepdims=True)) * window
        spectrum = np.fft.rfft(block, axis=1)[:, 1 : bins + 1]
        power += spectrum.real**2 + spectrum.imag**2
    # one-sided, over the window's power: the bins add up to the variance (the last bin counts once)
    power *= 2.0 / (number * length * float(window @ window))
    if length % 2 == 0:
        power[:, -1] *= 0.5
    power[:-1] *= np.square(np.asarray(factors, dtype=np.float64))[:, None]
    edges = np.unique(np.round(np.geomspace(1, bins + 1, BANDS + 1)).astype(np.int64)) - 1
    banded = np.add.reduceat(power, edges[:-1], axis=1).T
    above = np.where(banded[:, :-1] > banded[:, -1:], banded[:, :-1], 0.0).sum(axis=0)
    total = banded[:, :-1].sum(axis=0)
    frequency = np.arange(1, bins + 1) * (rate_hz / length)
    moving = [
        # The sum of squares is above the largest: what exceeds its share needs no search for that.
        power > VANISHING * factor**2 * float(one @ one) or power > VANISHING * (factor * largest(one)) ** 2
        for power, factor, one in zip(total.tolist(), factors, columns, strict=True)
    ]
    return BandPower(
        frequency[edges[:-1]],
        frequency[edges[1:] - 1],
        banded[:, :-1],
        banded[:, -1],
        # A constant column, or one without a part in the model, has no spectrum to compare.
        np.divide(above, total, out=np.full_like(total, np.nan), where=np.array(moving, dtype=np.bool_)),
    )
