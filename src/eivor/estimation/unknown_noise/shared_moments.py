"""What noises of unknown strength and order add to the moments, and their slopes.

With unit strength the noise of a channel adds the matrix D to mean(psi [phi' y]); with variance v it adds
v D. D of fractional noise depends on its order.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebfit, chebpts1, chebval

from eivor.models.equation import Parameter
from eivor.models.shared_noise import shared_noise
from eivor.models.signal_regression import SignalRegression
from eivor.shapes import Float
from eivor.signals.canonical import unit_of
from eivor.signals.noise import LARGEST_ORDER, FractionalNoise, MeasurementNoise, WhiteNoise

#: Degree in the order of the polynomials that stand for D between the orders at which it is computed.
DEGREE = 14
#: Where a search of an order begins.
FIRST_ORDER = -0.1


@dataclass(frozen=True, slots=True)
class UnknownNoise:
    """Noise of one channel.

    Parameters
    ----------
    channel : str
        Whose.
    fractional : bool
        Whether its order is unknown as well; else it is white.
    """

    channel: str
    fractional: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Variance, and order: `noise_variance_velocity_z` and `noise_order_velocity_z`."""
        unit = unit_of(self.channel)
        strength = Parameter(f"noise_variance_{self.channel}", f"({unit})^2" if unit else "")
        return (strength, Parameter(f"noise_order_{self.channel}")) if self.fractional else (strength,)


@dataclass(frozen=True)
class SharedMoments:
    """Moments of a problem that unknown noises are a part of.

    Parameters
    ----------
    problem : SignalRegression
        Its instruments are the test functions.
    unknown : tuple of UnknownNoise
        One for each channel whose noise is not declared.
    """

    problem: SignalRegression
    unknown: tuple[UnknownNoise, ...]
    made: dict[str, np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The problem's, then those of the noises."""
        return (*self.problem.parameters, *(one for noise in self.unknown for one in noise.parameters))

    def known(self) -> Float[np.ndarray, "p n_plus_1"]:
        """What declared noises add."""
        exact = {noise.channel: WhiteNoise(0.0) for noise in self.unknown}
        return self._shared({**exact, **self.problem.signals.noise})

    def unit(
        self, noise: UnknownNoise, order: float, *, slope: bool = False
    ) -> Float[np.ndarray, "p n_plus_1"]:
        """D of a channel's noise, or its slope by the order.

        D is a smooth function of the order: it is computed at Chebyshev's, and is their polynomial elsewhere.
        """
        if noise.channel not in self.made:
            self.made[noise.channel] = self._coefficients(noise)
        coefficients = self.made[noise.channel]
        scaled = order / LARGEST_ORDER
        if slope:
            return np.asarray(chebval(scaled, chebder(coefficients)) / LARGEST_ORDER)
        return np.asarray(chebval(scaled, coefficients))

    def _coefficients(self, noise: UnknownNoise) -> Float[np.ndarray, "degree_plus_1 p n_plus_1"]:
        if not noise.fractional:
            return self._shared({noise.channel: WhiteNoise(1.0)})[None]
        orders = LARGEST_ORDER * chebpts1(DEGREE + 1)
        made = np.stack([self._shared({noise.channel: FractionalNoise(1.0, float(one))}) for one in orders])
        fitted = chebfit(orders / LARGEST_ORDER, made.reshape(DEGREE + 1, -1), DEGREE)
        return np.asarray(fitted.reshape(made.shape))

    def _shared(self, noise: dict[str, MeasurementNoise]) -> Float[np.ndarray, "p n_plus_1"]:
        problem = self.problem
        signals = replace(problem.signals, noise=noise)
        right = (*problem.regressor_columns, problem.equation.response)
        shared = np.zeros((problem.instrument_count, len(right)))
        for i, one in enumerate(problem.instrument_columns):
            for j, other in enumerate(right):
                if one.channel and one.channel == other.channel and one.channel in noise:
                    shared[i, j] = shared_noise([one], [other], signals, problem.first, problem.used)[0, 0]
        return shared

    def added(
        self, beta: Float[np.ndarray, " k"], known: Float[np.ndarray, "p n_plus_1"]
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p k"]]:
        """What all noises add to mean(psi e), with its sign turned, and the slopes of that.

        Parameters
        ----------
        beta : ndarray, shape (k,)
            Parameters, and for each noise its variance and, when it is unknown, its order.
        known : ndarray, shape (p, n + 1)
            See `known`.

        Returns
        -------
        added : ndarray, shape (p,)
            C theta - c.
        slopes : ndarray, shape (p, k)
            By beta.
        """
        n = len(self.problem.parameters)
        direction = np.append(beta[:n], -1.0)
        total, slopes, place = known.copy(), np.zeros((known.shape[0], beta.size)), n
        for noise in self.unknown:
            variance, order = beta[place], beta[place + 1] if noise.fractional else 0.0
            unit = self.unit(noise, float(order))
            total = total + variance * unit
            slopes[:, place] = unit @ direction
            if noise.fractional:
                slopes[:, place + 1] = variance * self.unit(noise, float(order), slope=True) @ direction
            place += len(noise.parameters)
        slopes[:, :n] = total[:, :n]
        return total @ direction, slopes
