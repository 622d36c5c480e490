r"""Fit of noises to residuals.

At given parameters of the motion the strengths and orders minimise

    sum over bins of log det C + r^H C^-1 r

with a weak prior on each: standard deviation 3 of the logarithm of a variance about its start, .5 of an order
about its start, -.2. Noises that are declared stay as they are. The strength of the input's noise is always
given: with a disturbance that moves the vehicle, the two enter C alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

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
#: Relative decrease, and gradient in units of the curvature, at which a search has come to rest.
AT_REST = {"ftol": 1e-12, "gtol": 1e-4}
#: Bands are a twentieth of their frequency wide, and a bin at least.
BAND_SHARE = 20
#: Shares of the residuals' power over the upper half of the band that noises start from.
VELOCITY_SHARE, REST_SHARE = 0.8, 0.4
#: Least share of that for a variance that is declared: a channel without noise has no logarithm.
LEAST_DECLARED = 1e-9


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

    The search is made in coordinates in which the information at its start is the identity.
    """
    from scipy.optimize import minimize

    fit = _Fit(pairs, residual, prior.centre)
    origin, fitted = fit.vector(start), prior.fitted
    information = fit.information(origin)[np.ix_(fitted, fitted)]
    unit = np.linalg.inv(np.linalg.cholesky(information))

    def at(steps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " 6"]:
        vector = origin.copy()
        vector[fitted] += unit.T @ steps
        return vector

    def from_origin(steps: Float[np.ndarray, " n"]) -> tuple[float, Float[np.ndarray, " n"]]:
        value, gradient = fit.value_and_gradient(at(steps))
        return value, unit @ gradient[fitted]

    none = np.zeros(unit.shape[0])
    with np.errstate(all="ignore"):  # a step that goes too far is tried again, shorter
        found = minimize(from_origin, none, jac=True, method="L-BFGS-B", options={"maxiter": 200, **AT_REST})
    return fit.model(at(found.x)) if np.isfinite(found.fun) else start


def told_noises(
    pairs: PairedEquations, residual: Pair, model: NoiseModel, prior: NoisePrior, measure: str
) -> tuple[FittedNoise, ...]:
    """What is told of the noises of a model that fits, with errors by its information and what was known."""
    fit = _Fit(pairs, residual, prior.centre)
    vector, fitted = fit.vector(model), prior.fitted
    errors = np.zeros(6)
    covariance = np.linalg.inv(fit.information(vector)[np.ix_(fitted, fitted)])
    errors[fitted] = np.sqrt(np.diag(covariance))
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

        self.seen = PairSpectrum(
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
        """Penalised sum, and its derivatives: of log det C + tr(C^-1 P) by C they are C^-1 - C^-1 P C^-1."""
        from_centre, slopes = self._prior(vector)
        C, moved = self._spectra(vector)
        value = float(self.bins @ (np.log(C.determinant) + self.seen.traces_over(C)))
        by_bin = moved.traces_over(C) - moved.trace_with(self.seen.between(C))
        return value + 0.5 * float(from_centre @ from_centre), by_bin @ self.bins + slopes * from_centre

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

    def _spectra(self, vector: Float[np.ndarray, " 6"]) -> tuple[PairSpectrum, PairSpectrum]:
        """C, and its derivatives by what is searched over."""
        orders = _orders(vector)
        powers = np.exp(vector[:3, None] + 2.0 * orders[:, None] * self.log_scale)
        parts = self.shapes * powers
        C = PairSpectrum(
            self.base.first + parts.first.sum(axis=0),
            self.base.second + parts.second.sum(axis=0),
            self.base.cross + parts.cross.sum(axis=0),
        )
        by_order = 2.0 * _order_slopes(orders)[:, None] * self.log_scale
        moved = (np.concatenate([part, part * by_order]) for part in (parts.first, parts.second, parts.cross))
        return C, PairSpectrum(*moved)


def _orders(vector: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 3"]:
    """Orders of the noises."""
    orders: Float[np.ndarray, " 3"] = LARGEST_ORDER * np.tanh(vector[3:])
    return orders


def _order_slopes(orders: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Derivatives of the orders by what gives them."""
    return LARGEST_ORDER - orders**2 / LARGEST_ORDER
