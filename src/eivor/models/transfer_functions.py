"""Transfer functions of order 1 to 4 with a delay, fitted to frequency responses; loops and their margins."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import scipy

from eivor import checks
from eivor.errors import EstimationError, UsageError
from eivor.models.frequency_response import (
    TINY,
    FrequencyResponse,
    Points,
    Spectrum,
    local_polynomials,
    python_control,
)
from eivor.signals.signals import stretches
from eivor.tools import Complex, Float

Vector = Float[np.ndarray, " n"]

#: Local polynomials of the points that models are fitted to: they do not overlap. Narrow ones are lines.
SHARE, LEAST_BINS, LINEAR = 0.08, 10, 0.1
#: Band of these points [Hz], and the fewest of them.
BAND_HZ, FEWEST = (0.4, 20.0), 6
#: Neighbours to both sides over which variances of noise are smoothed.
SMOOTHED = 3
#: Lowest and highest value of parameters, in s and 1/s. The gain has a sign and no bounds.
PARAMETERS = {
    "gain": (-math.inf, math.inf),
    "damping": (-3.0, 60.0),
    "delay": (0.0, 0.25),
    "first": (0.0, 0.6),  # Denominator 1 + first s + second s^2
    "second": (0.0, 0.04),
    "third": (0.0, 0.3),  # And times 1 + third s
}
#: Which of them a model of an order has.
OF_ORDER = {order: tuple(PARAMETERS)[: order + 2] for order in (1, 2, 3, 4)}
#: Lags from which searches start [s].
STARTS_S = (0.01, 0.03, 0.06, 0.12)
BEGINNING = {"delay": 0.005, "third": 0.01}
#: Orders whose AICc is within this of the least are joined.
UNION = 4.0
#: Steps of a search, and the relative change of the criterion that ends it.
STEPS, ENOUGH = 40, 1e-8
#: Parameters with profiles: none has a normal error, least of all beside a second lag that is hardly there.
PROFILED = ("gain", "damping", "delay", "first")
#: Half-width of the logarithm of an undetermined quantity.
UNKNOWN = 10.0
#: Proposals for each draw at the edge of the region, and the range of their distances over a normal one's.
PROPOSED, NEAR_EDGE = 40, (0.6, 1.6)
#: Directions in the complex plane in which a measured loop may be off.
DIRECTIONS = 36
#: Phase margin of the second proposed controller [deg].
PHASE_MARGIN_DEG = 60.0
#: Draws of the parameters for margins, and where crossings are looked for: so many frequencies [Hz].
DRAWS, LOOKED_AT, LOOKED_HZ = 500, 500, (0.05, 60.0)

#: A response at complex frequencies s = 2 pi j f.
Response: TypeAlias = Callable[[Spectrum], Spectrum]


def _bounds(names: tuple[str, ...]) -> tuple[Vector, Vector]:
    """Lowest and highest values of parameters."""
    low, high = np.array([PARAMETERS[name] for name in names], dtype=np.float64).T
    return low, high


def _factors(value: Mapping[str, Any], s: Spectrum) -> tuple[Any, Any, Any]:
    """Factors of the denominator at numbers, or columns of numbers, of the parameters."""
    first, second, third = (value.get(name, 0.0) for name in ("first", "second", "third"))
    return s + value["damping"], 1.0 + first * s + second * s * s, 1.0 + third * s


def _responses(value: Mapping[str, Any], s: Spectrum, known: Spectrum) -> Complex[np.ndarray, "*models f"]:
    """Responses at numbers, or columns of numbers, of the parameters."""
    slow, lagged, later = _factors(value, s)
    return np.asarray(value["gain"] * (np.exp(-value["delay"] * s) * known / (slow * lagged * later)))


@dataclass(frozen=True)
class _Criterion:
    """Limited-information likelihood of points: sum |a - G b|^2 / var(e_y - G e_u)."""

    points: Points
    s: Spectrum
    known: Spectrum  # Response of hold and sensor filter

    def response(self, names: tuple[str, ...], theta: Vector) -> tuple[np.ndarray, np.ndarray]:
        """Response and its derivatives, columns as the names."""
        value, s = dict(zip(names, theta.tolist(), strict=True)), self.s
        slow, lagged, later = _factors(value, s)
        unit = _responses({**value, "gain": 1.0}, s, self.known)
        G = value["gain"] * unit
        by_name = {
            "gain": unit,
            "damping": -G / slow,
            "delay": -s * G,
            "first": -s * G / lagged,
            "second": -s * s * G / lagged,
            "third": -s * G / later,
        }
        return G, np.column_stack([by_name[name] for name in names])

    def residuals(
        self, names: tuple[str, ...], theta: Vector
    ) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, "rows n"]]:
        """Weighted residuals, real and imaginary, and their derivatives."""
        G, slope = self.response(names, theta)
        p, power = self.points, self.power(G)
        weight = 1.0 / np.sqrt(power)
        residual = (p.output - G * p.input) * weight
        change = 2.0 * (slope.conj() * (G * p.input_variance - p.covariance)[:, None]).real
        J = -(p.input * weight)[:, None] * slope - (0.5 * residual / power)[:, None] * change
        return np.concatenate([residual.real, residual.imag]), np.concatenate([J.real, J.imag])

    def values(
        self, names: tuple[str, ...], drawn: Float[np.ndarray, "draws n"]
    ) -> Float[np.ndarray, " draws"]:
        """The criterion at many values of the parameters."""
        G, p = _responses(dict(zip(names, drawn.T[:, :, None], strict=True)), self.s, self.known), self.points
        return np.asarray(np.sum(np.abs(p.output - G * p.input) ** 2 / self.power(G), axis=1))

    def power(self, G: Complex[np.ndarray, "*models f"]) -> Float[np.ndarray, "*models f"]:
        """Variance of the error of the residuals."""
        p = self.points
        crossed = 2.0 * (G.conj() * p.covariance).real
        return np.asarray(p.output_variance - crossed + np.abs(G) ** 2 * p.input_variance)

    def fitted(self, names: tuple[str, ...], theta: Vector, fixed: str = "") -> tuple[Vector, float]:
        """Minimum within the bounds from a start (Levenberg and Marquardt), and its value."""
        low, high = _bounds(names)
        free = np.array([name != fixed for name in names])
        residual, J = self.residuals(names, theta)
        value, damping = float(residual @ residual), 1e-3
        for _ in range(STEPS):
            slope = J.T @ residual
            moving = free & ~((theta <= low) & (slope > 0.0)) & ~((theta >= high) & (slope < 0.0))
            if not moving.any():
                break
            H = (J.T @ J)[np.ix_(moving, moving)]
            scale = np.maximum(H.diagonal(), 1e-300)
            step = np.zeros(theta.size)
            step[moving] = -np.linalg.solve(H + damping * np.diag(scale), slope[moving])
            trial = np.clip(theta + step, low, high)
            trial_residual, trial_J = self.residuals(names, trial)
            trial_value = float(trial_residual @ trial_residual)
            if trial_value < value:
                change = value - trial_value
                theta, residual, J, value = trial, trial_residual, trial_J, trial_value
                damping = max(damping / 5.0, 1e-10)
                if change < ENOUGH * max(value, 1.0):
                    break
            elif damping > 1e8:
                break
            else:
                damping *= 6.0
        return theta, value


@dataclass(frozen=True)
class _Minimum:
    """Minimum of the criterion of one order, with the intervals that follow."""

    criterion: _Criterion
    names: tuple[str, ...]
    best: Vector
    value: float

    @cached_property
    def spread(self) -> float:
        """Variance of residuals over estimated ones, whose real and imaginary parts have one half each.

        A misfit of the model widens it (Birge 1932).
        """
        dof = float(np.mean(self.criterion.points.dof))
        return 0.5 * (dof + 1.0) * max(1.0 / (dof - 1.0), 2.0 * self.value / (dof * self._dof))

    @property
    def _dof(self) -> int:
        return 2 * self.criterion.points.frequency_hz.size - len(self.names)

    def quantile(self, level: float) -> float:
        """Half-width of an interval in standard errors, with the spread of the residuals."""
        return float(scipy.special.stdtrit(max(self._dof, 1), 0.5 + 0.5 * level))

    def limit(self, level: float) -> float:
        """The criterion at the ends of an interval."""
        return self.value + self.spread * self.quantile(level) ** 2

    @cached_property
    def _slope(self) -> Float[np.ndarray, "rows n"]:
        return self.criterion.residuals(self.names, self.best)[1]

    @cached_property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the parameters by the slope of the residuals."""
        J = self._slope
        scale = np.sqrt(np.maximum(np.sum(J * J, axis=0), 1e-300))
        inverse = np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-12)
        return np.asarray(self.spread * inverse / np.outer(scale, scale))

    def intervals(self, level: float) -> dict[str, tuple[float, float]]:
        """Intervals of the parameters, and of derived quantities."""
        names, best, covariance = self.names, self.best, self.covariance
        t = self.quantile(level)
        errors = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
        ends = {
            name: (float(value - t * error), float(value + t * error))
            for name, value, error in zip(names, best.tolist(), errors.tolist(), strict=True)
        }
        for name in filter(names.__contains__, PROFILED):
            ends[name] = self._profile(self.limit(level), names.index(name))
        lags = np.array([name in ("first", "third") for name in names], dtype=float)
        middle, error = float(lags @ best), math.sqrt(max(float(lags @ covariance @ lags), 0.0))
        ends["lag"] = (
            ends["first"]
            if "first" in names and "third" not in names
            else (max(middle - t * error, 0.0), middle + t * error)
        )
        ends["delay"] = (max(ends["delay"][0], 0.0), max(ends["delay"][1], 0.0))
        if len(names) > 4 and best[4] > 0.0:
            second, first = float(best[4]), float(best[3])
            root, down = math.sqrt(second), -0.5 / second
            for name, centre, slope in (  # of logarithms, since both are above zero
                ("natural_frequency_hz", 0.5 / math.pi / root, np.array([0.0, down])),
                ("damping_ratio", 0.5 * first / root, np.array([1.0 / max(first, 1e-9), down])),
            ):
                error = math.sqrt(max(float(slope @ covariance[3:5, 3:5] @ slope), 0.0))
                factor = math.exp(t * error) if t * error < UNKNOWN else math.inf
                ends[name] = (centre / factor, centre * factor)
        return ends

    def _profile(self, limit: float, k: int) -> tuple[float, float]:
        """Where the criterion with a parameter fixed, and the others fitted, reaches a limit."""
        names, best, covariance = self.names, self.best, self.covariance
        lows, highs = _bounds(names)
        low, high = float(lows[k]), float(highs[k])
        error = math.sqrt(max(float(covariance[k, k]), 1e-20))
        ends = []
        for side, bound in ((-1.0, low), (1.0, high)):
            inside, outside, theta, value = float(best[k]), math.nan, best, 0.0
            step = max(1.6 * error, 1e-5)
            for _ in range(12):
                trial = 0.5 * (inside + outside) if math.isfinite(outside) else inside + side * step
                trial = min(max(trial, low), high)
                for start in (theta + covariance[:, k] / covariance[k, k] * (trial - theta[k]), theta):
                    candidate = np.clip(start, lows, highs)
                    candidate[k] = trial
                    refitted, value = self.criterion.fitted(names, candidate, names[k])
                    if value <= limit:
                        break
                if value > limit:
                    outside = trial
                else:
                    inside, theta = trial, refitted
                    if trial == bound:
                        break
                if math.isfinite(outside) and abs(outside - inside) < 0.05 * abs(outside - best[k]):
                    break
            ends.append(outside if math.isfinite(outside) else inside)
        return ends[0], ends[1]

    def edge(self, level: float) -> Float[np.ndarray, "draws n"]:
        """Values within the bounds whose criterion is hardly below the limit of an interval, and the best."""
        best, (low, high) = self.best, _bounds(self.names)
        span = np.where(np.isfinite(high), high - low, 4.0 * np.abs(best) + TINY)
        scaled = self._slope / math.sqrt(self.spread) * span
        half = np.linalg.cholesky(np.linalg.inv(scaled.T @ scaled + 16.0 * np.eye(best.size)))
        rng, t = np.random.default_rng(0), self.quantile(level)
        moves = rng.standard_normal((PROPOSED * DRAWS, best.size))
        moves *= t * rng.uniform(*NEAR_EDGE, (len(moves), 1)) / np.linalg.norm(moves, axis=1, keepdims=True)
        drawn = np.clip(best + moves @ half.T * span, low, high)
        values = self.criterion.values(self.names, drawn)
        inside = np.argsort(np.where(values <= self.limit(level), values, -np.inf))[-DRAWS:]
        return np.vstack([best, drawn[inside][values[inside] <= self.limit(level)]])


@dataclass(frozen=True)
class TransferFunction:
    """A model of one order: gain e^(-delay s) / ((s + damping)(1 + first s + second s^2)(1 + third s))."""

    order: int  # Number of poles, without those of the filter that is known
    parameters: Mapping[str, float]  # Gain, damping [1/s], delay [s], first and third [s], second [s^2]
    covariance: Float[np.ndarray, "n n"] = field(repr=False)  # Of the parameters, in their order
    chi_square: float  # What is left over
    dof: float  # The degrees of freedom of it
    p_value: float
    aicc: float  # Chi-square with the price of the parameters, for small samples
    #: Of the parameters, of "lag" (first and third together [s]) and of the poles' quantities
    intervals: Mapping[str, tuple[float, float]]
    known: Response = field(repr=False)
    _minimum: _Minimum = field(repr=False)

    @property
    def lag_s(self) -> float:
        """Sum of the time constants of the actuators [s]."""
        return self.parameters.get("first", 0.0) + self.parameters.get("third", 0.0)

    @property
    def poles(self) -> Complex[np.ndarray, " n"]:
        """Poles [rad/s]."""
        value = self.parameters
        denominator = np.polymul([1.0, value["damping"]], self._lags)
        if value.get("third", 0.0) > 0.0:
            denominator = np.polymul(denominator, [value["third"], 1.0])
        return np.roots(denominator).astype(np.complex128)

    @property
    def _lags(self) -> list[float]:
        parts = [self.parameters.get(name, 0.0) for name in ("second", "first")]
        return [*(parts if parts[0] > 0.0 else parts[1:] if parts[1] > 0.0 else []), 1.0]

    @property
    def natural_frequency_hz(self) -> float:
        """Natural frequency of a pair of poles of the actuators [Hz]; NaN where they are real, or fewer."""
        real = not self.damping_ratio < 1.0
        return math.nan if real else 1.0 / (2.0 * math.pi * math.sqrt(self.parameters["second"]))

    @property
    def damping_ratio(self) -> float:
        """Damping ratio of that pair [-]; NaN as well."""
        second = self.parameters.get("second", 0.0)
        ratio = self.parameters["first"] / (2.0 * math.sqrt(second)) if second else math.nan
        return ratio if ratio < 1.0 else math.nan

    def response(self, frequency_hz: Float[np.ndarray, " f"]) -> Spectrum:
        """Response with hold and sensor filter at frequencies [Hz]."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
        return _responses(self.parameters, s, self.known(s))

    def to_control(self, delay_order: int = 3) -> Any:
        """State space of python-control, without hold and filter; its delay is Padé's of that order."""
        control, value = python_control(), self.parameters
        model = control.tf([value["gain"]], np.poly(self.poles).tolist())
        model *= np.prod([part for part in (self._lags[0], value.get("third", 0.0)) if part > 0.0]) ** -1.0
        if value["delay"] > 0.0:
            model *= control.tf(*control.pade(value["delay"], delay_order))
        return control.ss(model)


@dataclass(frozen=True)
class TransferFunctions:
    """Models of several orders, and what all that the data allow have in common."""

    by_order: Mapping[int, TransferFunction]  # In order
    level: float  # Probability of the intervals

    @property
    def chosen(self) -> TransferFunction:
        """Model of the least AICc."""
        return min(self.by_order.values(), key=lambda model: model.aicc)

    @property
    def allowed(self) -> tuple[TransferFunction, ...]:
        """Models within 4 of the least AICc."""
        return tuple(model for model in self.by_order.values() if model.aicc - self.chosen.aicc <= UNION)

    @cached_property
    def intervals(self) -> Mapping[str, tuple[float, float]]:
        """Union over the orders that the data allow, of lag, delay, damping and gain."""
        ends = {name: [model.intervals[name] for model in self.allowed] for name in SHARED}
        return {name: (min(low for low, _ in e), max(high for _, high in e)) for name, e in ends.items()}


#: Quantities of models of every order.
SHARED = ("gain", "damping", "delay", "lag")


def transfer_functions(
    response: FrequencyResponse,
    *,
    orders: tuple[int, ...] = (1, 2, 3, 4),
    band_hz: tuple[float, float] = BAND_HZ,
    sensor_filter: Response = np.ones_like,
    level: float = 0.9,
) -> TransferFunctions:
    """Models of several orders with a delay, by limited information.

    Parameters
    ----------
    response : FrequencyResponse
        From `frequency_response`; of a direct one the models hold in open loop only.
    orders : tuple of int
        Out of 1 to 4: turning; and a lag; and a second one, which may oscillate; and a third one.
    band_hz : (float, float)
        Frequencies to fit [Hz].
    sensor_filter : callable
        Response of a known filter of the output at s = 2 pi j f. Default: none, so that its delay is in
        that of the model.
    level : float
        Probability of the intervals.

    Returns
    -------
    TransferFunctions
        Of each order; `chosen` has the least AICc.

    Raises
    ------
    UsageError
        For orders that are none.
    EstimationError
        When the reference reaches too few frequencies.

    Notes
    -----
    Minimises sum |a - G b|^2 / (S_aa - 2 Re(conj(G) S_ab) + |G|^2 S_bb) over points that do not overlap,
    with variances of noise smoothed over frequency. Intervals are of the profile.
    """
    remedy = "Make one by ev.frequency_response(u, y, reference=..., rate_hz=...)."
    checks.kind("response", response, FrequencyResponse, "a frequency response", remedy)
    checks.items("orders", orders, int, "orders")
    checks.items("band_hz", band_hz, (int, float), "two frequencies")
    ends = [0.0, *band_hz, math.inf]
    sound = len(ends) == 4 and 0.0 <= ends[1] < ends[2] < ends[3]
    checks.require(sound, "a band of two increasing frequencies", f"{band_hz}")
    checked_response("sensor_filter", sensor_filter)
    checks.level(level)
    if not orders or any(order not in OF_ORDER for order in orders):
        raise UsageError("orders out of 1, 2, 3 and 4", f"{orders}", "Leave out the others.")

    def known(s: Spectrum) -> Spectrum:
        half = 0.5 * s / response.rate_hz  # the input is held for a sample
        return np.asarray(np.exp(-half) * np.sinc(half.imag / np.pi) * sensor_filter(s))

    points, raw = _independent(response, band_hz)
    s = 2j * np.pi * points.frequency_hz
    criterion = _Criterion(points, s, known(s))
    unsmoothed = _Criterion(raw, s, known(s))
    models: dict[int, TransferFunction] = {}
    for order in sorted(orders):
        models[order] = _fitted_order(order, criterion, unsmoothed, models.get(order - 1), level, known)
    return TransferFunctions(models, level)


def _independent(response: FrequencyResponse, band_hz: tuple[float, float]) -> tuple[Points, Points]:
    """Points that do not overlap, with smoothed variances of noise, and as they are."""
    if response.is_periodic:
        raw = response.points
        used = (raw.frequency_hz >= band_hz[0]) & (raw.frequency_hz <= band_hz[1])
    else:
        longest = max(run.length_s for run in response.runs)
        resolution, grid = 1.0 / longest, []
        f = max(band_hz[0], (LEAST_BINS + 1) * resolution)
        top = min(band_hz[1], 0.4 * response.rate_hz)
        while f + (half := max(LEAST_BINS * resolution, SHARE * f)) <= top * (1.0 + SHARE):
            grid.append(round(f * longest) * resolution)
            f = max((f + half + resolution) / (1.0 - SHARE), f + half + (LEAST_BINS + 1) * resolution)
        raw = local_polynomials(
            response.runs,
            np.array(grid),
            driver=int(response.is_direct),
            share=SHARE,
            least_bins=LEAST_BINS,
            linear=LINEAR,
        )
        if response.is_direct:
            raw = raw.with_known_input()
        used = np.isfinite(raw.output_variance)
    if used.sum() < FEWEST or raw.significance[used].min() > 1e-3:
        raise EstimationError(
            f"a reference that reaches {FEWEST} frequencies between {band_hz[0]:g} and {band_hz[1]:g} Hz",
            f"{int(used.sum())} frequencies, hardly moved by it",
            "Fly a sweep over the band, or use a longer record.",
        )
    raw = raw.selected(used)
    return raw.smoothed(SMOOTHED), raw


def _fitted_order(
    order: int,
    criterion: _Criterion,
    unsmoothed: _Criterion,
    simpler: TransferFunction | None,
    level: float,
    known: Response,
) -> TransferFunction:
    names = OF_ORDER[order]
    best, value = _search(criterion, names, simpler)
    minimum, dof = _Minimum(criterion, names, best, value), float(np.mean(criterion.points.dof))
    n, p = 2 * criterion.points.frequency_hz.size, len(names)
    chi_square = 2.0 * value * (dof - 1.0) / dof
    raw, _ = unsmoothed.fitted(names, best)
    residual, _ = unsmoothed.residuals(names, raw)
    raw_dof = float(np.mean(unsmoothed.points.dof))
    test = 2.0 * float(residual @ residual) * (raw_dof - 1.0) / raw_dof
    return TransferFunction(
        order,
        dict(zip(names, best.tolist(), strict=True)),
        minimum.covariance,
        chi_square,
        float(n - p),
        float(scipy.special.chdtrc(n - p, test)),
        chi_square + 2.0 * p * n / max(n - p - 1, 1),
        minimum.intervals(level),
        known,
        minimum,
    )


def _search(
    criterion: _Criterion, names: tuple[str, ...], simpler: TransferFunction | None
) -> tuple[Vector, float]:
    """Best of several starts, that of the next lower order among them."""
    p = criterion.points
    fits = []
    starts = []
    if simpler is not None:
        old = dict(simpler.parameters)
        lag = old.get("first", 0.02)
        starts.append(
            old | {"first": 1.1 * lag, "second": old.get("second", 0.2 * lag * lag), "third": 0.005}
        )
        starts.append(old | {"first": lag, "second": old.get("second", 0.0) or 1e-6, "third": 1e-4})
    lags = STARTS_S if simpler is None or len(names) == 4 else STARTS_S[1:3]
    starts += [{"damping": 1.0, "first": lag, "second": 0.2 * lag * lag} | BEGINNING for lag in lags]
    for start in starts:
        theta = np.array([start.get(name, 1.0) for name in names])
        if "gain" not in start:
            G, _ = criterion.response(names, theta)
            model, weight = G * p.input, 1.0 / p.output_variance
            theta[0] = float(
                np.sum(weight * (model.conj() * p.output).real) / np.sum(weight * np.abs(model) ** 2)
            )
        fits.append(criterion.fitted(names, theta))
    return min(fits, key=lambda fit: fit[1])


@dataclass(frozen=True)
class Margins:
    """Margins of a loop; NaN where it does not cross."""

    crossover_hz: float  # Where the broken-loop response falls below one
    phase_margin_deg: float  # Its phase there, over -180 degrees
    phase_crossover_hz: float  # Where its phase falls below -180 degrees
    gain_margin_db: float  # Attenuation there
    bandwidth_hz: float  # Where the closed-loop response's phase falls below -90 degrees
    phase_delay_s: float  # Of the closed loop, between the frequency of -180 degrees and twice it (ADS-33)
    disturbance_bandwidth_hz: float  # Where the sensitivity 1 / (1 + L) rises above -3 dB


@dataclass(frozen=True)
class Controller:
    """A proportional and integral controller of a rate, and what its loop reaches."""

    name: str  # How it was found
    proportional: float  # Setpoint of torque for each rad/s of error
    integral_s: float  # Time of the integral
    margins: Margins  # With the chosen model
    #: Lowest and highest of each margin over what the data allow of the models
    intervals: Mapping[str, tuple[float, float]]

    def response(self, s: Spectrum) -> Spectrum:
        """Response at s = 2 pi j f."""
        return np.asarray(self.proportional * (1.0 + 1.0 / (self.integral_s * s)))

    def autopilot_parameters(self, axis: str) -> dict[str, dict[str, float]]:
        """Parameters of PX4 and ArduPilot for torque setpoints from -1 to 1; a proposal to be tried."""
        gains = {"P": self.proportional, "I": self.proportional / self.integral_s, "D": 0.0}
        return {
            "px4": {f"MC_{axis.upper()}RATE_{name}": value for name, value in ({"K": 1.0} | gains).items()},
            "ardupilot": {f"ATC_RAT_{ARDUPILOT_AXES[axis]}_{name}": value for name, value in gains.items()},
        }


#: Names of the axes in ArduPilot's parameters.
ARDUPILOT_AXES = {"roll": "RLL", "pitch": "PIT", "yaw": "YAW"}


def loop_margins(loop: Response) -> Margins:
    """Margins of a broken-loop response.

    Parameters
    ----------
    loop : callable
        Response L at s = 2 pi j f: an array of complex numbers for one of them.

    Returns
    -------
    Margins
        Of the first crossing of each kind between 0.05 and 60 Hz.

    Raises
    ------
    UsageError
        When the loop is no function that gives complex numbers.
    """
    checked_response("loop", loop)
    f = np.geomspace(*LOOKED_HZ, LOOKED_AT)
    values = np.asarray(loop(2j * np.pi * f), dtype=np.complex128)
    return Margins(**{name: float(each[0]) for name, each in _margins(f, values[None], loop).items()})


def checked_response(name: str, function: object) -> None:
    """Refuse what is no function from s to complex numbers."""
    remedy = "Give lambda s: 1.0 / (0.05 * s + 1.0), for example."
    if not callable(function):
        raise UsageError(f"a function of s for {name}", checks.described(function), remedy)
    s = 2j * np.pi * np.array([1.0, 2.0])
    try:
        values = np.asarray(function(s), dtype=np.complex128)
    except (TypeError, ValueError, ArithmeticError) as error:
        raise UsageError(f"a function of s for {name}", f"one that fails: {error}", remedy) from error
    if values.shape != s.shape:
        raise UsageError(f"a number for each s from {name}", f"the shape {values.shape}", remedy)


@np.errstate(invalid="ignore")
def _margins(
    f: Float[np.ndarray, " f"], L: Complex[np.ndarray, "loops f"], exact: Response | None = None
) -> dict[str, Float[np.ndarray, " loops"]]:
    """Margins of loops by lines between their values; of a single one, refined on its function."""
    rows = np.arange(len(L))

    def response_at(frequency: Float[np.ndarray, " loops"]) -> Complex[np.ndarray, " loops"]:
        if exact is not None:
            return np.asarray(exact(2j * np.pi * frequency))
        k = np.clip(np.searchsorted(f, frequency), 1, f.size - 1)
        share = np.log(frequency / f[k - 1]) / np.log(f[k] / f[k - 1])
        return np.asarray(L[rows, k - 1] * (L[rows, k] / L[rows, k - 1]) ** share)

    def crossing(
        values: Float[np.ndarray, "loops f"], transform: Callable[[Any], Any]
    ) -> Float[np.ndarray, " loops"]:
        """First frequencies at which values fall below zero; `transform` gives them by the loop."""
        fallen = (values[:, :-1] > 0.0) & (values[:, 1:] <= 0.0)
        k, known = fallen.argmax(axis=1), np.asarray(fallen.any(axis=1) & (values[:, 0] > 0.0))
        above, below = values[rows, k], values[rows, k + 1]
        share = np.where(known, above / np.where(known, above - below, 1.0), np.nan)
        if exact is not None and known[0]:
            ends = float(f[k[0]]), float(f[k[0] + 1])
            sides = [transform(exact(2j * np.pi * np.array([end])))[0] for end in ends]
            if sides[0] * sides[1] > 0.0:
                return np.array([np.nan])
            function = lambda x: float(transform(exact(np.array([2j * np.pi * x])))[0])  # noqa: E731
            return np.array([scipy.optimize.brentq(function, *ends, xtol=1e-12, rtol=1e-13)])
        return np.asarray(f[k] * (f[k + 1] / f[k]) ** share)

    def phase_falls(transform: Callable[[Any], Any], angle: float) -> Float[np.ndarray, " loops"]:
        return crossing(_phase(transform(L)) - angle, lambda x: np.angle(transform(x) * np.exp(-1j * angle)))

    def closed(x: Any) -> Any:
        return x / (1.0 + x)

    crossover = crossing(np.abs(L) - 1.0, lambda x: np.abs(x) - 1.0)
    phase_crossover, half_turn = phase_falls(lambda x: x, -np.pi), phase_falls(closed, -np.pi)
    twice = np.where(half_turn < LOOKED_HZ[1] / 2.0, 2.0 * half_turn, np.nan)
    root = math.sqrt(2.0)
    return {
        "crossover_hz": crossover,
        "phase_margin_deg": np.rad2deg(np.angle(-response_at(crossover))),
        "phase_crossover_hz": phase_crossover,
        "gain_margin_db": -20.0 * np.log10(np.abs(response_at(phase_crossover))),
        "bandwidth_hz": phase_falls(closed, -0.5 * np.pi),
        "phase_delay_s": -np.angle(-closed(response_at(twice))) / (4.0 * np.pi * half_turn),
        "disturbance_bandwidth_hz": crossing(np.abs(1.0 + L) - root, lambda x: np.abs(1.0 + x) - root),
    }


def _phase(values: Complex[np.ndarray, "loops f"]) -> Float[np.ndarray, "loops f"]:
    """Phases without jumps, which begin below 90 degrees [rad]."""
    phase: Float[np.ndarray, "loops f"] = np.unwrap(np.angle(values))
    return phase - 2.0 * np.pi * np.ceil((phase[:, :1] - 0.5 * np.pi) / (2.0 * np.pi))


def margin_intervals(
    of: TransferFunctions | FrequencyResponse, controller: Response | None = None
) -> dict[str, tuple[float, float]]:
    """Intervals of the margins of a loop, of models with a controller or as it was measured.

    Parameters
    ----------
    of : TransferFunctions or FrequencyResponse
        Models of a plant, or the response of a broken loop: from the error of what is controlled to it.
    controller : callable, optional
        Response of the controller at s = 2 pi j f, with models.

    Returns
    -------
    dict of str to (float, float)
        By the names of `Margins`. NaN where fewer than three in four of the models that the data allow
        cross, or not every loop as measured.

    Raises
    ------
    UsageError
        When models have no controller, or a response has.

    Notes
    -----
    Of models over parameters at the edge of what the data allow, in each order within 4 AICc. Of a measured
    loop over the joint region at each frequency that is shown, all frequencies in one direction.
    """
    if isinstance(of, FrequencyResponse):
        if controller is not None:
            raise UsageError("a broken loop alone", "a controller, too", "Give models with it instead.")
        return {name: ends[1:] for name, ends in measured_margins(of).items()}
    checks.kind("of", of, TransferFunctions, "models or a frequency response", "See ev.transfer_functions.")
    checked_response("controller", controller)
    f, ends = np.geomspace(*LOOKED_HZ, LOOKED_AT), []
    s = 2j * np.pi * f
    for model in of.allowed:
        columns = dict(zip(model.parameters, model._minimum.edge(of.level).T[:, :, None], strict=True))
        loops = _responses(columns, s, model.known(s)) * controller(s)  # type: ignore[misc]
        ends.append({name: _ends(values) for name, values in _margins(f, loops).items()})
    lows, highs = ({name: [margins[name][end] for margins in ends] for name in ends[0]} for end in (0, 1))
    return {name: (float(np.fmin.reduce(lows[name])), float(np.fmax.reduce(highs[name]))) for name in lows}


def measured_margins(loop: FrequencyResponse) -> dict[str, tuple[float, float, float]]:
    """Margins of a loop as measured where it is shown, with their ends over the region at each frequency."""
    part = max(stretches(loop.is_shown), key=lambda part: part.stop - part.start, default=slice(0, 0))
    if part.stop == part.start:
        return {item.name: (math.nan,) * 3 for item in fields(Margins)}
    centre, radius = (values[part] for values in loop.points.joint(loop.level))
    around = np.exp(2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)[:, None]
    loops = np.vstack([loop.response[part], centre + around * radius])
    return {
        name: (float(values[0]), *_ends(values, 1.0))
        for name, values in _margins(loop.frequency_hz[part], loops).items()
    }


def _ends(values: Float[np.ndarray, " loops"], least_share: float = 0.75) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    enough = known.size >= least_share * values.size
    return (float(known.min()), float(known.max())) if enough else (math.nan, math.nan)


def proposed_controllers(models: TransferFunctions) -> tuple[Controller, ...]:
    """Controllers of the rate: by SIMC, and for a phase margin. Proposals to be test-flown, never applied.

    Parameters
    ----------
    models : TransferFunctions
        From `transfer_functions`.

    Returns
    -------
    tuple of Controller
        Both, or none where the delays and lags add up to nothing.

    Notes
    -----
    Skogestad (2003): with theta the sum of delays, lags, filter and half a sample, the gain is
    1 / (2 K theta) and the integral's time 8 theta.
    """
    remedy = "Make some by ev.transfer_functions(response)."
    checks.kind("models", models, TransferFunctions, "models of a response", remedy)
    model = models.chosen
    slow = 2j * np.pi * np.array([0.1])
    lag = model.parameters["delay"] + model.lag_s - float(np.angle(model.known(slow))[0] / slow.imag[0])
    if lag <= 0.0:
        return ()
    gain, integral = 0.5 / (model.parameters["gain"] * lag), 8.0 * lag
    gains = [("SIMC", gain)]
    f = np.geomspace(*LOOKED_HZ, LOOKED_AT)
    loop = model.response(f) * (1.0 + 1.0 / (2j * np.pi * f * integral)) * np.sign(gain)
    excess_phase = _phase(loop[None])[0] + np.pi - math.radians(PHASE_MARGIN_DEG)
    if (excess_phase > 0.0).any():  # the highest frequency that leaves so much
        last = int(np.flatnonzero(excess_phase > 0.0)[-1])
        gains.append((f"phase margin {PHASE_MARGIN_DEG:g} deg", math.copysign(1.0 / abs(loop[last]), gain)))
    controllers = []
    for name, size in gains:
        tried = Controller(name, size, integral, Margins(*[math.nan] * 7), {})

        def broken_loop(s: Spectrum, tried: Controller = tried) -> Spectrum:
            return np.asarray(model.response(s.imag / (2.0 * np.pi)) * tried.response(s))

        intervals = margin_intervals(models, tried.response)
        controllers.append(replace(tried, margins=loop_margins(broken_loop), intervals=intervals))
    return tuple(controllers)
