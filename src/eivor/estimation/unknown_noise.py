"""Generalized IV with noises of unknown variance or order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import msgspec
import numpy as np
import scipy
from numpy.polynomial.chebyshev import chebder, chebfit, chebpts1, chebval

from eivor.errors import InstrumentError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import Method, Problem, check_freedom
from eivor.estimation.moments import Compensated
from eivor.estimation.weighting import divided, weight_factor
from eivor.inference.covariance import CovariancePart, JointCovariance, column_scale, newey_west_bandwidth
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import conditional_first_stage, orthonormal_basis
from eivor.inference.distributions import chi_square_tail
from eivor.inference.verdict import Reason, Status
from eivor.linalg.total_least_squares import LeastSquares
from eivor.models.regression import Column, Parameter, Regression
from eivor.models.signal_regression import SignalRegression, shared_noise
from eivor.signals.channels import unit_of
from eivor.signals.noise import LARGEST_ORDER, FractionalNoise, MeasurementNoise, WhiteNoise
from eivor.tools import Float

#: Lags of a regressor that has white noise, and of one whose noise has an order, the present one beside them.
WHITE_LAGS = 2
ORDER_LAGS = 6


class EquationChoice(Enum):
    """Which columns are test functions."""

    #: Instruments, and every noisy regressor at some lags: generalized instrumental variables in full.
    GENERALIZED = "generalized"
    #: The regressors themselves and instruments: bias-eliminating least squares.
    BIAS_ELIMINATING = "bias eliminating"
    #: Regressors, response and instruments: the Frisch scheme with the equations of past inputs.
    FRISCH = "frisch"

    def columns(self, problem: SignalRegression, orders: tuple[str, ...] = ()) -> tuple[Column, ...]:
        """Test functions: columns of the problem and others of its channels, each once whatever its gain."""
        instruments, selected = problem.instrument_columns, list(problem.regressor_columns)
        if self is EquationChoice.GENERALIZED:
            selected = list(instruments)
            for column in problem.regressor_columns:
                if column.channel:
                    last_lag = ORDER_LAGS if column.channel in orders else WHITE_LAGS
                    selected += [replace(column, lag=column.lag + lag) for lag in range(last_lag + 1)]
        elif self is EquationChoice.FRISCH:
            selected.append(problem.equation.response)
        distinct: dict[tuple[str, int, str], Column] = {}
        for column in (*selected, *instruments):
            distinct.setdefault((column.channel, column.lag, column.gain_channel), column)
        return tuple(distinct.values())


#: Largest lag: the record over this.
RECORD_OVER_LAG = 4


def long_memory_covariance(
    influence: Float[np.ndarray, "rows k"], error: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, "k k"]:
    """Covariance of the sums of g e, of normal series g (influence) and e (error)."""
    count = error.size
    length = 1 << (2 * count - 1).bit_length()
    lags = np.arange(length)
    lags = np.minimum(lags, length - lags)
    weights = np.clip(1.0 - lags / (count // RECORD_OVER_LAG + 1.0), 0.0, None) / count

    def sums(spectrum: np.ndarray) -> Float[np.ndarray, "lags *k"]:
        return np.fft.irfft(spectrum, length, axis=0)

    error_spectrum, influence_spectrum = np.fft.rfft(error, length), np.fft.rfft(influence, length, axis=0)
    by_error = weights * sums(np.abs(error_spectrum) ** 2)
    across = sums(influence_spectrum * error_spectrum.conj()[:, None])
    backwards = np.roll(across[::-1], 1, axis=0)
    results = across.T @ (weights[:, None] * backwards)
    for number in range(influence.shape[1]):
        results[number] += by_error @ sums(influence_spectrum[:, [number]] * influence_spectrum.conj())
    return 0.5 * (results + results.T)


#: Degree of the polynomials in the order that interpolate D.
DEGREE = 14
#: Where a search of an order begins.
FIRST_ORDER = -0.1


class UnknownNoise(msgspec.Struct, frozen=True):
    """Noise of one channel."""

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
    """Moments of a problem that unknown noises are a part of."""

    problem: SignalRegression
    unknown: tuple[UnknownNoise, ...]
    cache: dict[str, np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.problem.parameters + tuple(p for noise in self.unknown for p in noise.parameters)

    @cached_property
    def known(self) -> Float[np.ndarray, "p n_plus_1"]:
        """C, c of declared noises."""
        return self._shared(self.problem.signals.noise)

    def unit(
        self, noise: UnknownNoise, order: float, *, slope: bool = False
    ) -> Float[np.ndarray, "p n_plus_1"]:
        """D of a channel's noise, or its slope by the order."""
        if noise.channel not in self.cache:
            self.cache[noise.channel] = self._coefficients(noise)
        coefficients = self.cache[noise.channel]
        scaled = order / LARGEST_ORDER
        if slope:
            return np.asarray(chebval(scaled, chebder(coefficients)) / LARGEST_ORDER)
        return np.asarray(chebval(scaled, coefficients))

    def _coefficients(self, noise: UnknownNoise) -> Float[np.ndarray, "degree_plus_1 p n_plus_1"]:
        if not noise.fractional:
            return self._shared({noise.channel: WhiteNoise(1.0)})[None]
        orders = LARGEST_ORDER * chebpts1(DEGREE + 1)
        values = np.stack(
            [self._shared({noise.channel: FractionalNoise(1.0, float(order))}) for order in orders]
        )
        fitted = chebfit(orders / LARGEST_ORDER, values.reshape(DEGREE + 1, -1), DEGREE)
        return np.asarray(fitted.reshape(values.shape))

    def _shared(self, noise: Mapping[str, MeasurementNoise]) -> Float[np.ndarray, "p n_plus_1"]:
        problem = self.problem
        exact = dict.fromkeys(problem.signals.channels, WhiteNoise(0.0))
        signals = replace(problem.signals, noise={**exact, **noise})
        right = (*problem.regressor_columns, problem.equation.response)
        return shared_noise(problem.instrument_columns, right, signals, problem.first, problem.used)

    def added(
        self, beta: Float[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p k"]]:
        """Minus what all noises add to mean(psi e), and its slopes."""
        n = len(self.problem.parameters)
        direction = np.append(beta[:n], -1.0)
        total, slopes, position = self.known.copy(), np.zeros((len(self.known), beta.size)), n
        for noise in self.unknown:
            variance, order = beta[position], float(beta[position + 1]) if noise.fractional else 0.0
            unit = self.unit(noise, order)
            total += variance * unit
            slopes[:, position] = unit @ direction
            if noise.fractional:
                slopes[:, position + 1] = variance * self.unit(noise, order, slope=True) @ direction
            position += len(noise.parameters)
        slopes[:, :n] = total[:, :n]
        return total @ direction, slopes


#: Weights of the equations are renewed so often.
PASSES = 3
#: Condition number, columns scaled, beyond which equations do not distinguish the unknowns.
LARGEST_CONDITION = 1e8
#: Least share of its channel's variance that a fractional noise begins at.
NOTHING = 1e-8
#: Chance below which equations contradict each other.
CONTRADICTION = 1e-3


@dataclass(frozen=True)
class NoiseEstimatingIV(Method):
    """Generalized instrumental variables that estimate the noises that nothing is declared of."""

    name: str  # The word that results use
    choice: EquationChoice = EquationChoice.GENERALIZED
    orders: tuple[str, ...] = ()
    needs_instruments = True

    def estimate(self, problem: Problem) -> Estimate:
        if not isinstance(problem, SignalRegression):
            expected = "a regression of signals, whose columns say what noises they share"
            remedy = "Make one with VerticalMotion().regression(signals, instruments)."
            raise UsageError(expected, type(problem).__name__, remedy)
        psi = self.choice.columns(problem, self.orders)
        regression = SignalRegression(problem.signals, problem.equation, psi)
        right = (*regression.regressor_columns, regression.equation.response)
        shared = {column.channel for column in right} & {column.channel for column in psi}
        declared = set(problem.signals.noise)
        channels = dict.fromkeys(column.channel for column in right if column.channel in shared - {""})
        invalid = [name for name in self.orders if name not in channels or name in declared]
        if invalid:
            raise UsageError(
                f"orders of noises that are unknown: {', '.join(set(channels) - declared) or 'none is'}",
                ", ".join(f"'{name}'" for name in invalid),
                "Leave it out, or do not declare its noise.",
            )
        unknown = tuple(UnknownNoise(name, name in self.orders) for name in channels if name not in declared)
        search = _MomentSearch(SharedMoments(regression, unknown))
        return search.estimate(self.name, search.minimum())


@dataclass
class _MomentSearch:
    shared: SharedMoments  # With the unknown noises

    def __post_init__(self) -> None:
        self.rows = self.shared.problem.rows()
        psi, count = self.rows.instruments, self.rows.response.size
        unknowns = len(self.shared.parameters)
        check_freedom(count, unknowns)
        if psi.shape[1] < unknowns:
            expected = f"at least {unknowns} equations for {unknowns} unknowns, the noises among them"
            remedy = "Give more lags as instruments, or declare the noise of a channel."
            raise InstrumentError(expected, f"{psi.shape[1]}", remedy)
        self.cross = psi.T @ np.column_stack([self.rows.regressors, self.rows.response]) / count
        self.factor = weight_factor(psi.T @ psi / count)

    def _residual(self, beta: Float[np.ndarray, " k"]) -> Float[np.ndarray, " p"]:
        direction = np.append(beta[: self.cross.shape[1] - 1], -1.0)
        return self._divided(self.shared.added(beta)[0] - self.cross @ direction)

    def _slopes(self, beta: Float[np.ndarray, " k"]) -> Float[np.ndarray, "p k"]:
        slopes = self.shared.added(beta)[1]
        slopes[:, : self.cross.shape[1] - 1] -= self.cross[:, :-1]
        return self._divided(slopes)

    def _divided(self, values: Float[np.ndarray, "p *k"]) -> Float[np.ndarray, "p *k"]:
        return scipy.linalg.solve_triangular(self.factor, values, lower=True)

    def _start(self) -> Float[np.ndarray, " k"]:
        """Parameters and, times them, variances by linear equations; orders at a first guess."""
        n = self.cross.shape[1] - 1
        units = [
            self.shared.unit(item, FIRST_ORDER if item.fractional else 0.0) for item in self.shared.unknown
        ]
        linear = [(number, j) for number, unit in enumerate(units) for j in np.flatnonzero(unit.any(axis=0))]
        extra = [units[number][:, j] for number, j in linear]
        right = self.cross[:, -1] - self.shared.known[:, -1]
        matrix = np.column_stack([self.cross[:, :-1] - self.shared.known[:, :-1], *(-item for item in extra)])
        matrix = self._divided(matrix)
        size = column_scale(matrix)
        result = size * np.linalg.lstsq(matrix * size, self._divided(right), rcond=None)[0]
        direction = np.append(result[:n], -1.0)
        beta = list(result[:n])
        signals = self.shared.problem.signals
        for number, noise in enumerate(self.shared.unknown):
            selected = [(result[n + i], direction[j]) for i, (k, j) in enumerate(linear) if k == number]
            power = sum(factor**2 for _, factor in selected)
            variance = sum(value * factor for value, factor in selected) / power
            if noise.fractional:  # bounded away from zero
                beta += [max(variance, NOTHING * float(np.var(signals.channel(noise.channel)))), FIRST_ORDER]
            else:
                beta.append(variance)
        return np.array(beta)

    def minimum(self) -> Float[np.ndarray, " k"]:
        """Least of the weighted moments, weights renewed at each."""
        beta, free = self._start(), [(-np.inf, np.inf)]
        bounds = free * (self.cross.shape[1] - 1)
        for noise in self.shared.unknown:
            bounds += [(0.0, np.inf), (-LARGEST_ORDER, LARGEST_ORDER)] if noise.fractional else free
        for _ in range(PASSES):
            # unknowns in units of their slopes; no gradient tolerance, since it has a unit
            size = column_scale(self._slopes(beta))
            squares = scipy.optimize.least_squares(
                lambda x, size=size: self._residual(size * x),
                beta / size,
                lambda x, size=size: self._slopes(size * x) * size,
                bounds=tuple(np.array(bounds).T / size),
                x_scale="jac",
                xtol=1e-12,
                ftol=1e-12,
                gtol=None,
            )
            beta = size * squares.x
            self.factor = weight_factor(self._covariance(beta))
        return beta

    def _covariance(self, beta: Float[np.ndarray, " k"]) -> Float[np.ndarray, "p p"]:
        """Long-run covariance of the moments of normal series, from autocovariances (Soderstrom 2011)."""
        n, psi, count = self.cross.shape[1] - 1, self.rows.instruments, self.rows.response.size
        error = self.rows.response - self.rows.regressors @ beta[:n]
        lags = newey_west_bandwidth(count)
        moment = psi.T @ error
        covariance = psi.T @ psi * float(error @ error) / count**2 + np.outer(moment, moment) / count**2
        for lag in range(1, lags + 1):
            share = (1.0 - lag / (lags + 1.0)) / count**2
            lagged = psi[lag:].T @ psi[:-lag] * float(error[lag:] @ error[:-lag])
            both = lagged + np.outer(psi[:-lag].T @ error[lag:], psi[lag:].T @ error[:-lag])
            covariance += share * (both + both.T)
        return covariance

    def estimate(self, name: str, beta: Float[np.ndarray, " k"]) -> Estimate:
        solved = self._solved(beta)
        covariance = JointCovariance((*solved.joint_covariance.parts, *self._covariance_parts(beta)))
        estimate = replace(
            solved, method=name, joint_parameters=self.shared.parameters, streamed_covariance=covariance
        )
        return replace(estimate, met=tuple(self._reasons(estimate, beta)))

    def _covariance_parts(self, beta: Float[np.ndarray, " k"]) -> Iterator[CovariancePart]:
        """Covariance by Soderstrom's weights, (J' S^-1 J)^-1 over the rows, and that of long memory."""
        Q, root = np.linalg.qr(self._slopes(beta))
        inverse = scipy.linalg.solve_triangular(root, np.eye(beta.size))
        yield CovariancePart("of_normal_series", inverse @ inverse.T / self.rows.response.size)
        if not any(noise.fractional for noise in self.shared.unknown):
            return
        mapping = scipy.linalg.solve_triangular(root, Q.T)
        mapping = scipy.linalg.solve_triangular(self.factor, mapping.T, lower=True, trans=1)
        error = self.rows.response - self.rows.regressors @ beta[: self.rows.regressors.shape[1]]
        matrix = long_memory_covariance(self.rows.instruments @ mapping, error)
        yield CovariancePart("of_long_memory", matrix / self.rows.response.size**2)

    def _solved(self, beta: Float[np.ndarray, " k"]) -> Estimate:
        """Linear equations at the minimum, with the slopes by the noises in the compensation."""
        added, slopes = self.shared.added(beta)
        extra = beta.size - self.rows.regressors.shape[1]
        rows = Regression(
            self.rows.response,
            np.pad(self.rows.regressors, ((0, 0), (0, extra))),
            self.rows.instruments,
            self.shared.parameters,
            instrument_noise=np.column_stack([slopes, slopes @ beta - added]),
        )
        assembler, solver = Compensated(), LeastSquares()
        moments = assembler.moments(rows)
        system = assembler.system(moments)
        solution = solver.solve(divided(system, self.factor))
        if solution.condition > LARGEST_CONDITION:
            received = f"equations with the condition number {solution.condition:.2g}"
            remedy = "Give an input that is not white, more lags as instruments, or declare a noise."
            raise InstrumentError("equations that distinguish parameters and noises ", received, remedy)
        return Estimate(assembler, solver, moments, rows, system, self.factor, replace(solution, theta=beta))

    def _first_stage(self) -> dict[str, float]:
        """How well each regressor is identified by test functions that share no unknown noise with any."""
        problem = self.shared.problem
        unknown = {item.channel: item.fractional for item in self.shared.unknown}
        lags = {(column.channel, column.lag) for column in problem.regressor_columns}

        def shares_nothing(column: Column) -> bool:
            white = not unknown.get(column.channel, False)
            return column.channel not in unknown or (white and (column.channel, column.lag) not in lags)

        free = [shares_nothing(column) for column in problem.instrument_columns]
        strengths = conditional_first_stage(
            orthonormal_basis(self.rows.instruments[:, free]), self.rows.regressors
        )
        columns = zip(problem.names, strengths, problem.regressor_columns, strict=True)
        return {name: float(f) for name, f, column in columns if column.channel in unknown}

    def _reasons(self, estimate: Estimate, beta: Float[np.ndarray, " k"]) -> list[Reason]:
        reasons = []
        for noise in self.shared.unknown:
            variance = noise.parameters[0]
            low, high = estimate.interval(variance.name)
            if low <= 0.0:
                interval = f"[{low:.3g}, {high:.3g}] {variance.unit}".rstrip()
                sentence = (
                    f"The noise of {noise.channel} cannot be distinguished from none: the interval of "
                    f"its variance is {interval}."
                )
                remedy = "Declare it, where it is known, or record longer."
                reasons.append(Reason(Status.WEAK, sentence, remedy))
        for name, strength in self._first_stage().items():
            if strength < STRONG_FIRST_STAGE:
                sentence = (
                    f"The input does not distinguish the {name.replace('_', ' ')} from the noises: what "
                    f"shares no noise with its column has a first-stage F of {strength:.1f}, and "
                    f"{STRONG_FIRST_STAGE:.0f} is needed."
                )
                remedy = "Excite with a coloured input, give more lags, or declare the noise of the input."
                reasons.append(Reason(Status.REFUSED, sentence, remedy))
        residual = self._residual(beta)
        degrees = residual.size - beta.size
        J = self.rows.response.size * float(residual @ residual)
        if degrees > 0 and chi_square_tail(J, degrees) < CONTRADICTION:
            sentence = (
                f"The equations contradict each other (J = {J:.3g} on {degrees} degrees of freedom): a "
                "disturbance moves the vehicle, or a noise has another memory."
            )
            remedy = "Leave out the velocity's equations, or give orders."
            reasons.append(Reason(Status.WEAK, sentence, remedy))
        return reasons
