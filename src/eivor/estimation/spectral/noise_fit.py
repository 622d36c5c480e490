r"""Fit of noises to residuals.

At given parameters of the motion the strengths and orders minimise

    sum over bins of log det C + r^H C^-1 r

with a weak prior on each: standard deviation 3 of the logarithm of a variance about its start, .5 of an order
about its start, -.2. Noises that are declared stay as they are. The strength of the input's noise is always
given: with a disturbance that moves the vehicle, the two enter C alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from eivor.errors import ConvergenceError
from eivor.estimation.fitted_noise import FittedNoise
from eivor.estimation.spectral.noise_model import USUAL_ORDER, NoiseModel, PairedEquations
from eivor.estimation.spectral.pair_spectrum import Pair, PairSpectrum
from eivor.shapes import Bool, Float, Int
from eivor.signals.noise import FractionalNoise, MeasurementNoise, WhiteNoise

#: Largest order: a random walk, -1, lies inside.
LARGEST_ORDER = 1.2
#: Share of it that an order may reach.
MOST_OF_IT = 1.0 - 1e-9
#: Standard deviations of what is known beforehand: of log variances, of orders.
PRIOR_STD = np.array([3.0, 3.0, 3.0, 0.5, 0.5, 0.5])
#: What strengths are, of a record that is sampled evenly.
MEASURE = "a sample, of the white noise behind it"
#: What has noise, in the order of variances and of orders.
WHAT = ("velocity", "acceleration", "disturbance")
#: Most steps of a search, the decrease that one promises when it has come to rest, and the least share of
#: what it promises that it must keep.
STEPS, AT_REST, LEAST_OF_IT = 200, 1e-8, 1e-4
#: Largest change in a step, of logarithms of variances and of what gives the orders.
LONGEST = 3.0
#: Bands are a twentieth of their frequency wide, and a bin at least.
BAND_SHARE = 20
#: Shares of the residuals' power over the upper half of the band that noises start from.
VELOCITY_SHARE, REST_SHARE = 0.8, 0.4
#: Least share of that for a variance that is declared: a channel without noise has no logarithm.
LEAST_DECLARED = 1e-9

ValueAndGradient = Callable[[np.ndarray], tuple[float, np.ndarray]]


@dataclass(frozen=True)
class NoisePrior:
    """What is known of the noises before they are fitted.

    Parameters
    ----------
    centre : NoiseModel
        Centres of what is searched over, and what is known.
    fitted : ndarray of bool, shape (6,)
        Which are searched over: variances of velocity, acceleration and disturbance, then their orders.
    """

    centre: NoiseModel
    fitted: Bool[np.ndarray, " 6"]

    def with_input_variance(self, variance: float) -> NoisePrior:
        """The same with another noise of the input."""
        return replace(self, centre=replace(self.centre, input_variance=variance))


def prior_of(
    pairs: PairedEquations,
    residual: Pair,
    input_variance: float,
    declared: tuple[MeasurementNoise | None, MeasurementNoise | None] = (None, None),
    *,
    disturbance_order: float | None = 0.0,
) -> NoisePrior:
    """Strengths from the residuals' power over the upper half of the band; declared ones of z' and z''.

    Bins are in the order of their frequencies. A disturbance has a given order, or with None one that is
    fitted.
    """
    upper = slice(residual.shape[1] // 2, None)
    scale = np.exp(2.0 * USUAL_ORDER * pairs.log_scale[upper])
    of_velocity = pairs.shapes()[1].second[upper]
    first, second = (np.abs(residual[:, upper]) ** 2).mean(axis=1).tolist()
    variances = [
        VELOCITY_SHARE * second / float((of_velocity * scale).mean()),
        REST_SHARE * first / float(scale.mean()),
    ]
    orders, fitted = [USUAL_ORDER] * 2, np.ones(6, dtype=bool)
    for index, noise in enumerate(declared):
        if isinstance(noise, WhiteNoise | FractionalNoise):
            variances[index] = max(noise.std**2, LEAST_DECLARED * variances[index])
            orders[index] = noise.order if isinstance(noise, FractionalNoise) else 0.0
            fitted[[index, 3 + index]] = False
    fitted[5] = disturbance_order is None
    disturbed = USUAL_ORDER if disturbance_order is None else disturbance_order
    (velocity, acceleration), (alpha, beta) = variances, orders
    centre = NoiseModel(input_variance, velocity, acceleration, REST_SHARE * first, alpha, beta, disturbed)
    return NoisePrior(centre, fitted)


def fitted_noise(pairs: PairedEquations, residual: Pair, start: NoiseModel, prior: NoisePrior) -> NoiseModel:
    """Noise model of the least penalised sum of log det C + r^H C^-1 r, from `start`.

    The search is made in coordinates in which the information at its start is the identity, and learns the
    curvature from there (Broyden, Fletcher, Goldfarb and Shanno). Steps that lead up are halved.
    """
    fit = _Fit(pairs, residual, prior.centre)
    origin, fitted = fit.vector(start), prior.fitted
    unit = np.linalg.inv(_information_root(fit, origin, fitted))

    def at(steps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " 6"]:
        vector = origin.copy()
        vector[fitted] += unit.T @ steps
        return vector

    def from_origin(steps: Float[np.ndarray, " n"]) -> tuple[float, Float[np.ndarray, " n"]]:
        value, gradient = fit.value_and_gradient(at(steps))
        return value, unit @ gradient[fitted]

    with np.errstate(all="ignore"):  # a step that goes too far is tried again, shorter
        return fit.model(at(_lowest(from_origin, unit.T)))


def _lowest(function: ValueAndGradient, moves: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " n"]:
    """Minimum of a function from the origin, where its curvature is near the identity.

    No step moves anything by more than `LONGEST`: far out, where one noise is all that counts, determinants
    are differences of numbers that agree in every digit.
    """
    size = moves.shape[1]
    x, inverse = np.zeros(size), np.eye(size)
    value, gradient = function(x)
    for _ in range(STEPS):
        step = -inverse @ gradient
        step *= min(1.0, LONGEST / float(np.abs(moves @ step).max(initial=LONGEST)))
        promised = -float(gradient @ step)
        if not promised > AT_REST:
            break
        there = function(x + step)
        while not -np.inf < there[0] <= value - LEAST_OF_IT * promised:
            step, promised = 0.5 * step, 0.5 * promised
            if promised < AT_REST:
                return x
            there = function(x + step)
        turned = there[1] - gradient
        x, (value, gradient) = x + step, there
        along = float(turned @ step)
        if along > 0.0:
            kept = np.eye(size) - np.outer(step, turned) / along
            inverse = kept @ inverse @ kept.T + np.outer(step, step) / along
    return x


def _information_root(
    fit: _Fit, vector: Float[np.ndarray, " 6"], fitted: Bool[np.ndarray, " 6"]
) -> Float[np.ndarray, "m m"]:
    """Triangular root of the information, L L'."""
    with np.errstate(all="ignore"):
        information = fit.information(vector)[np.ix_(fitted, fitted)]
    if np.isfinite(information).all():
        try:
            return np.asarray(np.linalg.cholesky(information))
        except np.linalg.LinAlgError:
            pass
    raise ConvergenceError(
        "residuals whose spectra tell the measurement noises",
        "residuals that are zero in the band, or too few of them",
        "Declare the noises, use a method that needs none, such as reference_iv, or record longer.",
    )


def told_noises(
    pairs: PairedEquations, residual: Pair, model: NoiseModel, prior: NoisePrior, measure: str
) -> tuple[FittedNoise, ...]:
    """What is told of the noises of a model that fits, with errors by its information and what was known."""
    fit = _Fit(pairs, residual, prior.centre)
    vector, fitted = fit.vector(model), prior.fitted
    errors = np.zeros(6)
    root = _information_root(fit, vector, fitted)
    errors[fitted] = np.linalg.norm(np.linalg.inv(root), axis=0)
    strengths, orders = np.sqrt(_variances(model)), _all_orders(model)
    by_strength, by_order = 0.5 * strengths * errors[:3], _order_slopes(orders) * errors[3:]
    told = zip(WHAT, strengths, by_strength, orders, by_order, strict=True)
    return tuple(
        FittedNoise(of, float(strength), float(error), float(order), float(order_error), measure)
        for of, strength, error, order, order_error in told
    )


def _variances(model: NoiseModel) -> Float[np.ndarray, " 3"]:
    return np.array([model.velocity_variance, model.acceleration_variance, model.disturbance_variance])


def _all_orders(model: NoiseModel) -> Float[np.ndarray, " 3"]:
    return np.array([model.velocity_order, model.acceleration_order, model.disturbance_order])


@lru_cache(maxsize=8)
def band_edges(count: int) -> Int[np.ndarray, " edges"]:
    """First bin of each band: single bins at first, then bands that grow with their frequency."""
    edges = [0]
    while edges[-1] < count:
        edges.append(min(edges[-1] + 1 + edges[-1] // BAND_SHARE, count))
    return np.array(edges)


class _Fit:
    """The objective, with its gradient, of periodograms averaged over narrow bands."""

    def __init__(self, pairs: PairedEquations, residual: Pair, centre: NoiseModel) -> None:
        self.known, self.centre = centre, np.append(np.log(_variances(centre)), _all_orders(centre))
        edges = band_edges(residual.shape[1])
        self.bins = np.diff(edges).astype(np.float64)

        def averaged(values: np.ndarray) -> np.ndarray:
            return np.add.reduceat(values, edges[:-1]) / self.bins

        seen = PairSpectrum(
            averaged(np.abs(residual[0]) ** 2),
            averaged(np.abs(residual[1]) ** 2),
            averaged(residual[0] * residual[1].conj()),
        )
        self.log_scale = averaged(pairs.log_scale)
        of_input, *others = (
            PairSpectrum(averaged(shape.first), averaged(shape.second), averaged(shape.cross))
            for shape in pairs.shapes()
        )
        self.base = of_input * centre.input_variance
        self.shapes = PairSpectrum(
            np.stack([shape.first for shape in others]),
            np.stack([shape.second for shape in others]),
            np.stack([shape.cross for shape in others]),
        )
        self.numbers = _numbers(self.shapes).swapaxes(0, 1)
        self.base_numbers, self.seen_numbers = _numbers(self.base), _numbers(seen)

    def vector(self, model: NoiseModel) -> Float[np.ndarray, " 6"]:
        """What is searched over: logarithms of variances, and what gives the orders in their bounds."""
        within = np.clip(_all_orders(model) / LARGEST_ORDER, -MOST_OF_IT, MOST_OF_IT)
        return np.append(np.log(_variances(model)), np.arctanh(within))

    def model(self, vector: Float[np.ndarray, " 6"]) -> NoiseModel:
        """Noise model of such a vector."""
        velocity, acceleration, disturbance = np.exp(vector[:3]).tolist()
        velocity_order, acceleration_order, disturbance_order = _orders(vector).tolist()
        return replace(
            self.known,
            velocity_variance=velocity,
            acceleration_variance=acceleration,
            disturbance_variance=disturbance,
            velocity_order=velocity_order,
            acceleration_order=acceleration_order,
            disturbance_order=disturbance_order,
        )

    def value_and_gradient(self, vector: Float[np.ndarray, " 6"]) -> tuple[float, Float[np.ndarray, " 6"]]:
        """Penalised sum, and its derivatives: of log det C + tr(C^-1 P) by C they are C^-1 - C^-1 P C^-1.

        Of each matrix four numbers are kept, see `_numbers`: arrays are short here, and calls what costs.
        """
        from_centre, slopes = self._prior(vector)
        powers = self._powers(vector)
        first, second, real, imaginary = self.base_numbers + (powers[:, None] * self.numbers).sum(axis=0)
        determinant = first * second - real**2 - imaginary**2
        a, b, x, y = np.stack([second, first, -real, -imaginary]) / determinant  # C^-1
        p, q, u, v = self.seen_numbers
        own, crossed = a * p + b * q, 2.0 * (x * u + y * v)
        value = float(self.bins @ (np.log(determinant) + own + crossed))
        size, product, straight, turned = x**2 + y**2, a * b, x**2 - y**2, 2.0 * x * y
        by_number = self.bins * np.stack(
            [
                a - a * (a * p + crossed) - size * q,
                b - b * (b * q + crossed) - size * p,
                2.0 * (x - x * own - straight * u - turned * v - product * u),
                2.0 * (y - y * own - turned * u + straight * v - product * v),
            ]
        )
        by_power = powers * (self.numbers * by_number).sum(axis=1)
        by_order = 2.0 * _order_slopes(_orders(vector)) * (by_power @ self.log_scale)
        found = np.concatenate([by_power.sum(axis=1), by_order])
        return value + 0.5 * float(from_centre @ from_centre), found + slopes * from_centre

    def information(self, vector: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "6 6"]:
        """Sum over bins of tr(C^-1 C_j C^-1 C_l), with what the prior adds."""
        C, moved = self._spectra(vector)
        whitened = moved.between(C)
        found = (whitened.first * self.bins) @ moved.first.T + (whitened.second * self.bins) @ moved.second.T
        found += 2.0 * ((whitened.cross.conj() * self.bins) @ moved.cross.T).real
        _, slopes = self._prior(vector)
        return found + np.diag(slopes**2)

    def _prior(
        self, vector: Float[np.ndarray, " 6"]
    ) -> tuple[Float[np.ndarray, " 6"], Float[np.ndarray, " 6"]]:
        """Distances from the centres over their standard deviations, and the slopes of these."""
        orders = _orders(vector)
        far = (np.append(vector[:3], orders) - self.centre) / PRIOR_STD
        return far, np.append(np.ones(3), _order_slopes(orders)) / PRIOR_STD

    def _powers(self, vector: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "3 bands"]:
        """Spectrum of each noise."""
        powers: Float[np.ndarray, "3 bands"] = np.exp(
            vector[:3, None] + 2.0 * _orders(vector)[:, None] * self.log_scale
        )
        return powers

    def _spectra(self, vector: Float[np.ndarray, " 6"]) -> tuple[PairSpectrum, PairSpectrum]:
        """C, and its derivatives by what is searched over."""
        parts = self.shapes * self._powers(vector)
        C = PairSpectrum(
            self.base.first + parts.first.sum(axis=0),
            self.base.second + parts.second.sum(axis=0),
            self.base.cross + parts.cross.sum(axis=0),
        )
        by_order = 2.0 * _order_slopes(_orders(vector))[:, None] * self.log_scale
        moved = (np.concatenate([part, part * by_order]) for part in (parts.first, parts.second, parts.cross))
        return C, PairSpectrum(*moved)


def _numbers(spectrum: PairSpectrum) -> Float[np.ndarray, "4 *shape bands"]:
    """Of each matrix what stands on its diagonal, and real and imaginary part of what stands across."""
    return np.stack([spectrum.first, spectrum.second, spectrum.cross.real, spectrum.cross.imag])


def _orders(vector: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 3"]:
    """Orders of the noises."""
    orders: Float[np.ndarray, " 3"] = LARGEST_ORDER * np.tanh(vector[3:])
    return orders


def _order_slopes(orders: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Derivatives of the orders by what gives them."""
    return LARGEST_ORDER - orders**2 / LARGEST_ORDER
