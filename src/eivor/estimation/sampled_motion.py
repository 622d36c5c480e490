"""Sampled equation of motion in frequency, and the noise spectrum of its pair of equations."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol, runtime_checkable

import numpy as np
import scipy

from eivor.errors import ConvergenceError, InstrumentError, MissingNoiseError, UsageError
from eivor.estimation.linear import Problem
from eivor.estimation.moments import FittedNoise
from eivor.models.regression import lags
from eivor.models.signal_regression import SignalRegression
from eivor.signals.noise import FractionalNoise, MeasurementNoise, WhiteNoise
from eivor.tools import Bool, Complex, Float, Int

Pair = Complex[np.ndarray, "2 bins"]
Pairs = Complex[np.ndarray, "*shape 2 bins"]
Six = Float[np.ndarray, " 6"]


@dataclass(frozen=True)
class PairSpectrum:
    """C of each bin, by its entries; of several matrices a bin where these have more axes."""

    first: Float[np.ndarray, "*shape bins"]
    second: Float[np.ndarray, "*shape bins"]
    cross: Complex[np.ndarray, "*shape bins"]  # First row, second column

    def __add__(self, other: PairSpectrum) -> PairSpectrum:
        return PairSpectrum(self.first + other.first, self.second + other.second, self.cross + other.cross)

    def __mul__(self, factor: float | Float[np.ndarray, "*shape bins"]) -> PairSpectrum:
        return self.mapped(lambda values: values * factor)

    def mapped(self, function: Callable[[np.ndarray], np.ndarray]) -> PairSpectrum:
        return PairSpectrum(function(self.first), function(self.second), function(self.cross))

    @cached_property
    def determinant(self) -> Float[np.ndarray, "*shape bins"]:
        return self.first * self.second - (self.cross.real**2 + self.cross.imag**2)

    @cached_property
    def inverse(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """C^-1: both of its diagonal, first row and second column."""
        determinant = self.determinant
        return self.second / determinant, self.first / determinant, self.cross / -determinant

    def solved(self, pairs: Pairs) -> Pairs:
        """C^-1 x, of one pair or of several."""
        first, second, cross = self.inverse
        result = np.empty(pairs.shape, dtype=np.complex128)
        result[..., 0, :] = first * pairs[..., 0, :] + cross * pairs[..., 1, :]
        result[..., 1, :] = cross.conj() * pairs[..., 0, :] + second * pairs[..., 1, :]
        return result

    def sandwich(self, other: PairSpectrum) -> PairSpectrum:
        """other^-1 C other^-1."""
        a, b, c = other.inverse
        twice, size = 2.0 * (c.conj() * self.cross).real, c.real**2 + c.imag**2
        return PairSpectrum(
            a * a * self.first + a * twice + size * self.second,
            b * b * self.second + b * twice + size * self.first,
            c * (a * self.first + b * self.second + c * self.cross.conj()) + a * b * self.cross,
        )

    @cached_property
    def root(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lower Cholesky factor: first diagonal, below it, second diagonal."""
        top = np.sqrt(self.first)
        below = self.cross.conj() / top
        return top, below, np.sqrt(self.determinant / self.first)

    def whitened(self, pairs: Pairs) -> Pairs:
        """L^-1 x with C = L L^H, of one pair or of several."""
        top, below, bottom = self.root
        result = np.empty(pairs.shape, dtype=np.complex128)
        result[..., 0, :] = pairs[..., 0, :] / top
        result[..., 1, :] = (pairs[..., 1, :] - below * result[..., 0, :]) / bottom
        return result


#: C of one unit of noise of the input, of z', of z'' and of a disturbance that moves the vehicle.
Shapes = tuple[PairSpectrum, ...]


def inner(left: Pair, right: Pair) -> Complex[np.ndarray, " bins"]:
    """x^H y of each bin."""
    return (left.conj() * right).sum(axis=0)


#: Expected order of a noise of unknown order.
USUAL_ORDER = -0.2


@runtime_checkable
class PairedEquations(Protocol):
    """Residuals of two equations, bin by bin, of one motion."""

    @property
    @abstractmethod
    def log_scale(self) -> Float[np.ndarray, " bins"]:
        """Log gain of a difference of order one: the spectrum of its noise is exp(2 log_scale)."""

    @abstractmethod
    def shapes(self) -> Shapes:
        """C of one unit of noise of the input, of z', of z'' and of a disturbance that moves the vehicle."""


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Strengths and orders of the input's noise and of those of the velocity, acceleration, disturbance."""

    input_variance: float
    variances: Float[np.ndarray, " 3"]
    orders: Float[np.ndarray, " 3"]

    def spectrum(self, pairs: PairedEquations) -> PairSpectrum:
        input_shape, *shapes = pairs.shapes()
        total = input_shape * self.input_variance
        for shape, variance, order in zip(shapes, self.variances, self.orders, strict=True):
            total = total + shape * (variance * np.exp(2.0 * order * pairs.log_scale))
        return total


#: Largest order: a random walk, -1, lies inside.
LARGEST_ORDER = 1.2
#: Largest share of it that an order may have.
LARGEST_SHARE = 1.0 - 1e-9
#: Standard deviations of the priors: of log variances, of orders.
PRIOR_STD = np.array([3.0, 3.0, 3.0, 0.5, 0.5, 0.5])
#: Unit of strengths, of a record that is sampled evenly.
MEASURE = "a sample, of the white noise behind it"
#: Noisy quantities, in the order of variances and of orders.
NOISE_NAMES = ("velocity", "acceleration", "disturbance")
#: Most steps of a search, and the largest slope, in standard errors, where it has come to rest.
STEPS, AT_REST = 200, 1e-4
#: Bands are a twentieth of their frequency wide, and a bin at least.
BAND_SHARE = 20
#: Shares of the residuals' power over the upper half of the band that noises start from.
VELOCITY_SHARE, REST_SHARE = 0.8, 0.4
#: Least share of that for a variance that is declared: a channel without noise has no logarithm.
LEAST_DECLARED = 1e-9


@dataclass(frozen=True)
class NoisePrior:
    """Prior of the noises, and which of their parameters are fitted."""

    centre: NoiseModel
    fitted: Bool[np.ndarray, " 6"]


def noise_prior(
    pairs: PairedEquations,
    residual: Pair,
    input_variance: float,
    declared: tuple[MeasurementNoise | None, MeasurementNoise | None] = (None, None),
    *,
    disturbance_order: float | None = 0.0,
) -> NoisePrior:
    """Strengths from the residuals' power over the upper half of the band; declared ones of z' and z''."""
    upper = slice(residual.shape[1] // 2, None)
    scale = np.exp(2.0 * USUAL_ORDER * pairs.log_scale[upper])
    velocity_shape = pairs.shapes()[1].second[upper]
    first, second = (np.abs(residual[:, upper]) ** 2).mean(axis=1).tolist()
    velocity = VELOCITY_SHARE * second / float((velocity_shape * scale).mean())
    variances = np.array([velocity, REST_SHARE * first / float(scale.mean()), REST_SHARE * first])
    disturbed = USUAL_ORDER if disturbance_order is None else disturbance_order
    orders, fitted = np.array([USUAL_ORDER, USUAL_ORDER, disturbed]), np.ones(6, dtype=bool)
    for index, noise in enumerate(declared):
        if isinstance(noise, WhiteNoise | FractionalNoise):
            variances[index] = max(noise.std**2, LEAST_DECLARED * variances[index])
            orders[index] = noise.order if isinstance(noise, FractionalNoise) else 0.0
            fitted[[index, 3 + index]] = False
    fitted[5] = disturbance_order is None
    return NoisePrior(NoiseModel(input_variance, variances, orders), fitted)


def fitted_noise(pairs: PairedEquations, residual: Pair, start: NoiseModel, prior: NoisePrior) -> NoiseModel:
    """Noise model of the least penalised sum of log det C + r^H C^-1 r, from `start`."""
    fit = _Fit(pairs, residual, prior.centre)
    origin, fitted = fit.vector(start), prior.fitted
    unit = np.linalg.inv(_information_root(fit, origin, fitted))

    def vector_at(steps: Float[np.ndarray, " n"]) -> Six:
        vector = origin.copy()
        vector[fitted] += unit.T @ steps
        return vector

    def objective(steps: Float[np.ndarray, " n"]) -> tuple[float, Float[np.ndarray, " n"]]:
        value, gradient = fit.value_and_gradient(vector_at(steps))
        return value if np.isfinite(value) else np.inf, unit @ gradient[fitted]

    first, options = np.zeros(len(unit)), {"gtol": AT_REST, "maxiter": STEPS}
    with np.errstate(all="ignore"):  # a step that goes too far is tried again, shorter
        lowest = scipy.optimize.minimize(objective, first, jac=True, method="BFGS", options=options)
        return fit.model(vector_at(lowest.x))


def _information_root(fit: _Fit, vector: Six, fitted: Bool[np.ndarray, " 6"]) -> Float[np.ndarray, "m m"]:
    with np.errstate(all="ignore"):
        information = fit.information(vector)[np.ix_(fitted, fitted)]
    if np.isfinite(information).all():
        try:
            return np.asarray(np.linalg.cholesky(information))
        except np.linalg.LinAlgError:
            pass
    expected = "residuals whose spectra determine the measurement noises"
    remedy = "Declare the noises, use a method that needs none, such as reference_iv, or record longer."
    raise ConvergenceError(expected, "residuals that are zero in the band, or too few of them", remedy)


def fitted_noises(
    pairs: PairedEquations, residual: Pair, model: NoiseModel, prior: NoisePrior, measure: str
) -> tuple[FittedNoise, ...]:
    """Report of the noises of a fitted model, with errors by its information."""
    fit = _Fit(pairs, residual, prior.centre)
    vector, fitted = fit.vector(model), prior.fitted
    errors = np.zeros(6)
    errors[fitted] = np.linalg.norm(np.linalg.inv(_information_root(fit, vector, fitted)), axis=0)
    strengths, orders = np.sqrt(model.variances), model.orders
    by_strength, by_order = 0.5 * strengths * errors[:3], _order_slopes(orders) * errors[3:]
    starts = zip(NOISE_NAMES, strengths, by_strength, orders, by_order, strict=True)
    return tuple(
        FittedNoise(name, float(strength), float(error), float(order), float(order_error), measure)
        for name, strength, error, order, order_error in starts
    )


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
        self.prior, self.centre = centre, np.append(np.log(centre.variances), centre.orders)
        edges = band_edges(residual.shape[1])
        self.bins = np.diff(edges).astype(np.float64)

        def averaged(values: np.ndarray) -> np.ndarray:
            return np.add.reduceat(values, edges[:-1]) / self.bins

        self.periodogram = PairSpectrum(
            averaged(np.abs(residual[0]) ** 2),
            averaged(np.abs(residual[1]) ** 2),
            averaged(residual[0] * residual[1].conj()),
        )
        self.log_scale = averaged(pairs.log_scale)
        input_shape, *shapes = (shape.mapped(averaged) for shape in pairs.shapes())
        self.base = input_shape * centre.input_variance
        entries = zip(*((shape.first, shape.second, shape.cross) for shape in shapes), strict=True)
        self.shapes = PairSpectrum(*map(np.stack, entries))

    def vector(self, model: NoiseModel) -> Six:
        """Vector of the search: logarithms of variances, and orders mapped from within their bounds."""
        shares = np.clip(model.orders / LARGEST_ORDER, -LARGEST_SHARE, LARGEST_SHARE)
        return np.append(np.log(model.variances), np.arctanh(shares))

    def model(self, vector: Six) -> NoiseModel:
        return NoiseModel(self.prior.input_variance, np.exp(vector[:3]), _orders(vector))

    def value_and_gradient(self, vector: Six) -> tuple[float, Six]:
        """Penalised sum, and its derivatives: of log det C + tr(C^-1 P) by C they are C^-1 - C^-1 P C^-1."""
        from_centre, slopes = self._prior(vector)
        C, derivatives = self._spectra(vector)
        first, second, cross = C.inverse
        P, weighted = self.periodogram, self.periodogram.sandwich(C)
        misfit = first * P.first + second * P.second + 2.0 * (cross.conj() * P.cross).real
        value = float(self.bins @ (np.log(C.determinant) + misfit))
        difference = PairSpectrum(first - weighted.first, second - weighted.second, cross - weighted.cross)
        gradient = self._traces(difference, derivatives) + slopes * from_centre
        return value + 0.5 * float(from_centre @ from_centre), gradient

    def information(self, vector: Six) -> Float[np.ndarray, "6 6"]:
        """Sum over bins of tr(C^-1 C_j C^-1 C_l), and the prior's information."""
        C, derivatives = self._spectra(vector)
        _, slopes = self._prior(vector)
        return self._traces(derivatives.sandwich(C), derivatives) + np.diag(slopes**2)

    def _traces(self, left: PairSpectrum, right: PairSpectrum) -> Float[np.ndarray, "*shape n"]:
        """Sums over bins of the traces of products."""
        result = (left.first * self.bins) @ right.first.T + (left.second * self.bins) @ right.second.T
        return result + 2.0 * ((left.cross.conj() * self.bins) @ right.cross.T).real

    def _prior(self, vector: Six) -> tuple[Six, Six]:
        """Distances from the centres over their standard deviations, and the slopes of these."""
        orders = _orders(vector)
        distances = (np.append(vector[:3], orders) - self.centre) / PRIOR_STD
        return distances, np.append(np.ones(3), _order_slopes(orders)) / PRIOR_STD

    def _spectra(self, vector: Six) -> tuple[PairSpectrum, PairSpectrum]:
        """C, and its derivatives by the vector of the search."""
        powers = np.exp(vector[:3, None] + 2.0 * _orders(vector)[:, None] * self.log_scale)
        parts = self.shapes * powers
        by_order = 2.0 * _order_slopes(_orders(vector))[:, None] * self.log_scale
        C = self.base + parts.mapped(lambda part: part.sum(axis=0))
        return C, parts.mapped(lambda part: np.concatenate([part, part * by_order]))


def _orders(vector: Six) -> Float[np.ndarray, " 3"]:
    return LARGEST_ORDER * np.tanh(vector[3:])


def _order_slopes(orders: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    return LARGEST_ORDER - orders**2 / LARGEST_ORDER


Bins = Complex[np.ndarray, " bins"]


def unitary_bins(values: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " bins"]:
    """Unitary spectrum of a series without its mean, at bins 1 to ceil(n/2) - 1."""
    count = values.size
    spectrum: Complex[np.ndarray, " bins"] = np.fft.rfft(values - values.mean())
    return spectrum[1 : -(-count // 2)] / np.sqrt(count)


@dataclass(frozen=True)
class SampledRecord:
    """Spectra of a record of z', z'' and u."""

    step_s: float  # Time between samples [s]
    count: int  # Number of samples
    acceleration: Bins  # shape (bins,)
    velocity: Bins  # shape (bins,)
    input: Bins  # shape (bins,)

    @cached_property
    def angle(self) -> Float[np.ndarray, " bins"]:
        """Angular frequency of each bin, in radians per sample."""
        return 2.0 * np.pi * np.arange(1, self.input.size + 1) / self.count

    @cached_property
    def earlier(self) -> Bins:
        """z^-1 of each bin."""
        return np.exp(-1j * self.angle)

    @cached_property
    def ramp(self) -> Bins:
        """Spectrum of a line from -1/2 to 1/2 over the record."""
        return unitary_bins(np.linspace(-0.5, 0.5, self.count))

    @cached_property
    def log_scale(self) -> Float[np.ndarray, " bins"]:
        """log(2 sin(w/2))."""
        return np.log(2.0 * np.sin(0.5 * self.angle))


@dataclass(frozen=True)
class SampledMotion:
    """The motion at some parameters."""

    record: SampledRecord
    friction: float  # [1/s]
    gain: float  # [1/s]
    blend: float = 0.0

    @property
    def log_scale(self) -> Float[np.ndarray, " bins"]:
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
        change = by_held - self.held * step * self.decay * self.record.earlier * self.memory
        return self.record.earlier * self.memory * change

    @cached_property
    def _input_blend(self) -> Bins:
        return (1.0 - self.blend) + self.blend * self.record.earlier.conj()

    @cached_property
    def response(self) -> Bins:
        """Response of the velocity to the input: g."""
        return self.gain * self.pushed * self._input_blend

    @cached_property
    def directions(self) -> Complex[np.ndarray, "3 2 bins"]:
        """d_K, d_b and d_rho: derivatives of the residuals by the parameters, over the true input."""
        result = np.empty((3, 2, self.response.size), dtype=np.complex128)
        result[0] = self.response, -(self.gain * self._input_blend * self.pushed_by_friction)
        result[1, 0] = -1.0
        result[1, 1] = self.pushed * -self._input_blend
        result[2, 0] = 0.0
        result[2, 1] = (-self.gain * self.pushed) * (self.record.earlier.conj() - 1.0)
        return result

    @cached_property
    def input_noise(self) -> Pair:
        """The pair s = [b; g]: minus the derivatives of the residuals by an error of the input."""
        return np.stack([np.full_like(self.response, self.gain), self.response])

    def residuals(self) -> Pair:
        """r_1 and r_2 without the transient."""
        record = self.record
        first = record.acceleration + self.friction * record.velocity - self.gain * record.input
        return np.stack([first, record.velocity - self.response * record.input])

    def shapes(self) -> Shapes:
        """C of one unit of noise of the input, of z', of z'' and of a disturbance that moves the vehicle."""
        entries = np.ones(self.response.size)
        K, b, h = self.friction, self.gain, self.pushed
        return (
            PairSpectrum(b * b * entries, np.abs(self.response) ** 2, b * self.response.conj()),
            PairSpectrum(K * K * entries, entries, K * entries.astype(complex)),
            PairSpectrum(entries, 0.0 * entries, 0.0j * entries),
            PairSpectrum(entries, np.abs(h) ** 2, h.conj()),
        )

    def corrected(self, nuisances: Float[np.ndarray, " q"], shapes: Complex[np.ndarray, "q 2 bins"]) -> Pair:
        """Residuals with the nuisances' parts taken off: r + sum of c psi."""
        return self.residuals() + np.tensordot(nuisances, shapes, 1)

    def steady_state(self, transient: float) -> Pair:
        """Residuals with a transient alone taken off."""
        return self.corrected(np.array([transient]), self.nuisance_shapes(ramps=False))

    def nuisance_shapes(self, ramps: bool) -> Complex[np.ndarray, "q 2 bins"]:
        """psi: [0; -D], and with ramps [-F; 0] and [0; -F]."""
        result = np.zeros((3 if ramps else 1, 2, self.memory.size), dtype=np.complex128)
        result[0, 1] = -self.memory
        if ramps:
            result[1, 0] = result[2, 1] = -self.record.ramp
        return result


#: Fewest samples that spectra can be distinguished from.
FEWEST_SAMPLES = 64
#: Lags of the input that are instruments of the pilot when the problem brings none.
PILOT_LAGS = (0, 10)


@dataclass(frozen=True)
class SampledProblem:
    """A record of one motion, sampled evenly."""

    problem: SignalRegression
    record: SampledRecord
    input_variance: float
    instrument: Complex[np.ndarray, " bins"] | None
    declared: tuple[MeasurementNoise | None, MeasurementNoise | None]
    noise_estimated: bool = False


def problem_of_motion(problem: Problem, method: str) -> SignalRegression:
    """Problem for a spectral method, with lagged inputs where it has no instruments."""
    if not isinstance(problem, SignalRegression):
        expected = f"a record of one motion for {method}, sampled evenly"
        remedy = "Make it of signals: ev.VerticalMotion(intercept=False).regression(signals, instruments)."
        raise UsageError(expected, type(problem).__name__, remedy)
    driver = motion_of(problem, method)[2]
    noise = problem.signals.noise.get(driver)
    if noise is None:
        raise MissingNoiseError(
            f"the noise of {driver}, which {method} takes off",
            "none that is declared",
            "Declare it: Signals(..., noise={'input': ev.WhiteNoise(0.01)}); zero says that it is exact. To "
            "a likelihood it is a disturbance that moves the vehicle. ev.methods.spectral_giv() seeks it.",
        )
    if not isinstance(noise, WhiteNoise):
        remedy = "Use generalized_iv."
        raise UsageError(f"white noise of {driver} for {method}", f"a {type(noise).__name__}", remedy)
    return with_instruments(problem, driver)


class SpectraError(Exception):
    """Why a record has no spectral estimate, and what to do."""


def sampled_problem(problem: SignalRegression, method: str) -> SampledProblem:
    """Spectra of a problem, see `problem_of_motion`; a `SpectraError` where it has none to be identified."""
    state, response, driver = motion_of(problem, method)
    signals = problem.signals
    count, gaps = signals.sample_count, 0 if signals.valid is None else int((~signals.valid).sum())
    if gaps:
        why = f"{gaps} of {count} samples are not valid, and it needs a record without gaps"
        raise SpectraError(why, "Give the longest stretch between gaps, or repair the samples.")
    if count < FEWEST_SAMPLES:
        why = f"there are {count} samples, and it needs {FEWEST_SAMPLES} at least"
        raise SpectraError(why, "Give a longer record.")
    noise = signals.noise[driver]
    is_own = is_own_instrument(problem, driver)
    bins = (unitary_bins(signals.channel(name)) for name in (response, state, driver))
    record = SampledRecord(signals.step_s, count, *bins)
    instrument = None if is_own else unitary_bins(_projected(problem, driver, method))
    declared = signals.noise.get(state), signals.noise.get(response)
    return SampledProblem(problem, record, noise.std**2, instrument, declared)


def with_instruments(problem: SignalRegression, driver: str) -> SignalRegression:
    """The problem with lags of its input as instruments, where it brings none."""
    if problem.instrument_columns:
        return problem
    return replace(problem, instrument_columns=lags(driver, *PILOT_LAGS))


def is_own_instrument(problem: SignalRegression, driver: str) -> bool:
    """Whether the instruments are lags of the input itself."""
    return {column.channel for column in problem.instrument_columns} == {driver}


def motion_of(problem: SignalRegression, method: str) -> tuple[str, str, str]:
    """Channels of the state, of its derivative and of the input."""
    equation = problem.equation
    columns = [column for _, column in equation.terms]
    plain = [(column.channel, column.lag, column.gain, column.gain_channel) for column in columns]
    state = equation.derivative_of
    if not state or len(plain) != 2 or plain[0] != (state, 0, -1.0, "") or plain[1][1:] != (0, 1.0, ""):
        raise UsageError(
            f"the motion a = -K v + b u for {method}, where a is the derivative of v, without an intercept",
            f"{equation.response.name} explained by {', '.join(column.name for column in columns)}",
            "Use ev.VerticalMotion(intercept=False); means are taken off.",
        )
    return state, equation.response.channel, plain[1][0]


def _projected(problem: SignalRegression, driver: str, method: str) -> Float[np.ndarray, " samples"]:
    """Input as fitted by the instruments, by least squares; its mean before their first row."""
    if driver in {column.channel for column in problem.instrument_columns}:
        expected = f"instruments of the input alone, or of other channels alone, for {method}"
        received = ", ".join(column.name for column in problem.instrument_columns)
        raise InstrumentError(expected, received, "Under control give lags of the reference.")
    Psi = np.column_stack([problem.column(column) for column in problem.instrument_columns])
    values = problem.signals.channel(driver)
    centred = Psi - Psi.mean(axis=0)
    fitted = centred @ np.linalg.lstsq(centred, values[problem.first :] - values.mean(), rcond=None)[0]
    return np.concatenate([np.zeros(problem.first), fitted])
