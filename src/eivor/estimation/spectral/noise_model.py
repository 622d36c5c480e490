r"""Spectra of what is measured and of what disturbs, and their fit to residuals.

    C = S_u (..) + S_v (..) + S_a (..) + S_e (..)

see `SampledMotion.shapes`: S_u and S_e are flat, S_v = s_v^2 |2 sin(w/2)|^(2 alpha) and S_a alike with beta,
the spectra of fractional noises. At given parameters of the motion the strengths and orders minimise

    sum over bins of log det C + r^H C^-1 r

with a weak prior on each: standard deviation 3 of the logarithm of a variance about its start, .5 of an order
about -.2. The strength of the input's noise is given: with a disturbance that moves the vehicle, the two
enter C alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.estimation.spectral.pair_spectrum import Pair, PairSpectrum
from eivor.estimation.spectral.sampled_motion import SampledMotion
from eivor.shapes import Float, Int

#: Start of an order, and the largest one.
USUAL_ORDER, LARGEST_ORDER = -0.2, 0.95
#: Standard deviations of what is known beforehand: of log variances, of orders.
LOG_VARIANCE_STD, ORDER_STD = 3.0, 0.5
#: Bands are a twentieth of their frequency wide, and a bin at least.
BAND_SHARE = 20
#: Shares of the residuals' power over the upper half of the band that noises start from.
VELOCITY_SHARE, REST_SHARE = 0.8, 0.4


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Strengths and orders.

    Parameters
    ----------
    input_variance : float
        sigma_u^2.
    velocity_variance, acceleration_variance : float
        s_v^2 and s_a^2, of the white noise before the operator.
    disturbance_variance : float
        S_e.
    velocity_order, acceleration_order : float
        alpha and beta.
    """

    input_variance: float
    velocity_variance: float
    acceleration_variance: float
    disturbance_variance: float
    velocity_order: float = USUAL_ORDER
    acceleration_order: float = USUAL_ORDER

    def spectrum(self, motion: SampledMotion) -> PairSpectrum:
        """C at parameters of the motion."""
        record = motion.record
        of_input, of_velocity, of_acceleration, of_disturbance = motion.shapes()
        return (
            of_input * self.input_variance
            + of_velocity * (self.velocity_variance * record.power(self.velocity_order))
            + of_acceleration * (self.acceleration_variance * record.power(self.acceleration_order))
            + of_disturbance * self.disturbance_variance
        )


def first_noise(motion: SampledMotion, residual: Pair, input_variance: float) -> NoiseModel:
    """Strengths from the residuals' power over the upper half of the band."""
    power = np.abs(residual[:, residual.shape[1] // 2 :]) ** 2
    scale = motion.record.power(USUAL_ORDER)[residual.shape[1] // 2 :].mean()
    first, second = power.mean(axis=1)
    return NoiseModel(
        input_variance,
        VELOCITY_SHARE * float(second) / scale,
        REST_SHARE * float(first) / scale,
        REST_SHARE * float(first),
    )


def fitted_noise(motion: SampledMotion, residual: Pair, start: NoiseModel, prior: NoiseModel) -> NoiseModel:
    """Noise model of the least penalised sum of log det C + r^H C^-1 r, from `start`.

    `prior` holds the centres of what is known of the log variances.
    """
    from scipy.optimize import minimize

    fit = _Fit(motion, residual, start, np.log(_variances(prior)))
    bounds = [(None, None)] * 3 + [(-LARGEST_ORDER, LARGEST_ORDER)] * 2
    options = {"maxiter": 200, "ftol": 1e-10, "gtol": 1e-5}
    found = minimize(
        fit.value_and_gradient, fit.vector(start), jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    return fit.model(found.x)


def _variances(model: NoiseModel) -> Float[np.ndarray, " 3"]:
    return np.array([model.velocity_variance, model.acceleration_variance, model.disturbance_variance])


def band_edges(count: int) -> Int[np.ndarray, " edges"]:
    """First bin of each band: single bins at first, then bands that grow with their frequency."""
    edges = [0]
    while edges[-1] < count:
        edges.append(min(edges[-1] + 1 + edges[-1] // BAND_SHARE, count))
    return np.array(edges)


class _Fit:
    """The objective, with its gradient, of periodograms averaged over narrow bands."""

    def __init__(
        self, motion: SampledMotion, residual: Pair, start: NoiseModel, centre: Float[np.ndarray, " 3"]
    ) -> None:
        self.start, self.centre = start, centre
        edges = band_edges(residual.shape[1])
        self.bins = np.diff(edges).astype(np.float64)

        def averaged(values: np.ndarray) -> np.ndarray:
            return np.add.reduceat(values, edges[:-1]) / self.bins

        self.seen = PairSpectrum(
            averaged(np.abs(residual[0]) ** 2),
            averaged(np.abs(residual[1]) ** 2),
            averaged(residual[0] * residual[1].conj()),
        )
        self.log_sine = averaged(np.log(2.0 * np.sin(0.5 * motion.record.angle)))
        of_input, *self.shapes = (
            PairSpectrum(averaged(shape.first), averaged(shape.second), averaged(shape.cross))
            for shape in motion.shapes()
        )
        self.base = of_input * start.input_variance

    def vector(self, model: NoiseModel) -> Float[np.ndarray, " 5"]:
        """What is searched over: logarithms of variances, orders."""
        return np.array([*np.log(_variances(model)), model.velocity_order, model.acceleration_order])

    def model(self, vector: Float[np.ndarray, " 5"]) -> NoiseModel:
        """Noise model of such a vector."""
        velocity, acceleration, disturbance = np.exp(vector[:3]).tolist()
        return replace(
            self.start,
            velocity_variance=velocity,
            acceleration_variance=acceleration,
            disturbance_variance=disturbance,
            velocity_order=float(vector[3]),
            acceleration_order=float(vector[4]),
        )

    def value_and_gradient(self, vector: Float[np.ndarray, " 5"]) -> tuple[float, Float[np.ndarray, " 5"]]:
        """Penalised sum, and its derivatives: of log det C + tr(C^-1 P) by C they are C^-1 - C^-1 P C^-1."""
        logs, orders = vector[:3], vector[3:]
        powers = [np.exp(logs[i] + 2.0 * orders[i] * self.log_sine) for i in range(2)]
        powers.append(np.full(self.log_sine.size, np.exp(logs[2])))
        C = self.base
        for shape, power in zip(self.shapes, powers, strict=True):
            C = C + shape * power
        misfit = self.seen.traces_over(C)
        from_usual = (orders - USUAL_ORDER) / ORDER_STD
        from_centre = (logs - self.centre) / LOG_VARIANCE_STD
        value = float(self.bins @ (np.log(C.determinant) + misfit))
        value += 0.5 * float(from_centre @ from_centre + from_usual @ from_usual)
        between = self.seen.between(C)
        slopes = [
            self.bins * power * (shape.traces_over(C) - shape.trace_with(between))
            for shape, power in zip(self.shapes, powers, strict=True)
        ]
        by_log = np.array([float(slope.sum()) for slope in slopes]) + from_centre / LOG_VARIANCE_STD
        by_order = np.array([float((2.0 * self.log_sine * slope).sum()) for slope in slopes[:2]])
        return value, np.append(by_log, by_order + from_usual / ORDER_STD)
