"""Limit of commands and thrust curve by flights, and the autopilot's parameter for the curve."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter, itemgetter

import numpy as np
import scipy

from eivor.estimation.estimate import Estimate
from eivor.flights.lag_prior import linear_quantity
from eivor.flights.prepared import LEVEL, RATE, CommandLimit, PreparedFlight
from eivor.flights.quantity import Quantity, QuantityEstimate
from eivor.inference.verdict import Status
from eivor.motions.vertical import model
from eivor.motions.vertical.regression import FORCE, Balance, Linear, VerticalFlights
from eivor.motions.vertical.select import FittedCurve
from eivor.signals.channels import CurveSide, common_side
from eivor.signals.filters import actuator_state
from eivor.signals.recording import Finding
from eivor.signals.thrust_map import InputMap, Power, input_map
from eivor.tools import Float

# -- Limit of commands --

#: Rates and levels that are tried, and limits around the best.
RATES, LEVELS, REFINED = 12, 8, 7
#: Lags and delays [s] that together are any linear actuator: jumps behind delays pass for limits.
LAGS_S = (0.0, 0.008, 0.016, 0.03, 0.06, 0.12, 0.25)
DELAYS_S, DELAYED = (0.01, 0.02, 0.03, 0.045), (0, 2)
#: A limit is there when it makes twice the log likelihood so much larger, without the blocks that gain most:
#: recordings without a limit gain up to 28.
LEAST_GAIN, OUTLYING = 30.0, 0.1
#: The largest jump takes so many logged steps at a limit: what is quicker may be what the log lacks.
JUMP_STEPS = 3
#: Samples of a flight that are read, and memory of its residual's autoregression and blocks of it [s].
MOST_SAMPLES, MEMORY_S, BLOCK_S = 50_000, 0.3, 1.0


def _gains(flight: PreparedFlight, limits: Sequence[CommandLimit]) -> Float[np.ndarray, "blocks k"]:
    """By how much each limit makes the squared innovations of the force balance smaller than none does.

    In variances, block by block of a flight of one run. The innovations are those of one autoregression.
    """
    (run,), step_s, signals = flight.runs, flight.signals.step_s, flight.signals
    velocity, tilt = signals.channel("velocity_z"), signals.channel("cos_tilt")
    curve, block = input_map(flight.input_map), max(round(BLOCK_S / step_s), 1)
    response = signals.channels[FORCE] if FORCE in signals.channels else np.gradient(velocity, step_s)
    delays = [np.maximum(np.arange(tilt.size) - round(delay_s / step_s), 0) for delay_s in DELAYS_S]

    def features(commands: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "c rows"]:
        """Acceleration; then velocity, thrust behind lags and delays, and its powers for other maps."""
        if curve == Power():
            commands = commands.mean(axis=1, keepdims=True)  # what is linear answers to the mean
        commands = np.asfortranarray(commands)
        states = [actuator_state(commands, step_s=step_s, lag_s=lag_s, delay_s=0.0) for lag_s in LAGS_S]
        thrusts = [curve(state).mean(axis=1) * tilt for state in states]
        middle = thrusts[len(LAGS_S) // 2]
        thrusts += [thrusts[j][earlier] for earlier in delays for j in DELAYED]
        deviation = middle / (middle[run].mean() or 1.0) - 1.0
        results = np.stack((response, velocity, *thrusts, deviation**2, deviation**3))[:, run]
        return results - results.mean(axis=1, keepdims=True)

    logged = features(signals.family(flight.input.name))
    whitening = _whitening(_residual(logged), max(int(MEMORY_S / step_s), 1))
    length = scipy.fft.next_fast_len(logged.shape[1] + whitening.size, real=True)
    transfer = np.fft.rfft(whitening, length)

    def squares(of: Float[np.ndarray, "c n"]) -> Float[np.ndarray, " blocks"]:
        white = np.fft.irfft(np.fft.rfft(of, length) * transfer, length)[:, whitening.size - 1 : of.shape[1]]
        used = white.shape[1] // block * block
        return np.asarray((_residual(white)[:used].reshape(-1, block) ** 2).sum(axis=1))

    unlimited = squares(logged)
    gains = [unlimited - squares(features(commands)) for commands in np.moveaxis(flight.acting(limits), 2, 0)]
    return np.stack(gains, axis=1) / (unlimited.mean() / block)


def _whitening(residual: Float[np.ndarray, " n"], order: int) -> Float[np.ndarray, " p"]:
    """Whitening filter of a residual, by Yule and Walker."""
    correlation = np.fft.irfft(np.abs(np.fft.rfft(residual, 2 * residual.size)) ** 2)[: order + 1]
    correlation[0] *= 1.0 + 1e-9
    return np.append(1.0, -scipy.linalg.solve_toeplitz(correlation[:-1], correlation[1:]))


def _residual(rows: Float[np.ndarray, "c n"]) -> Float[np.ndarray, " n"]:
    """Residual of the first row by regression on the others."""
    R = np.asarray(np.linalg.qr(np.roll(rows, -1, axis=0).T, mode="r"))
    return np.asarray(rows[0] - np.linalg.lstsq(R[:, :-1], R[:, -1])[0] @ rows[1:])


def command_limit(problem: VerticalFlights) -> CommandLimit | None:
    """The limit of rate or level within which commands act, in all flights; None where nothing says so.

    Noise that feedback passes on to quick commands shows a rate: references alone move them too slowly.
    """
    if any(flight.input.measured or not flight.issued for flight in problem.flights):
        return None
    flights = []
    for flight in problem.flights:  # the first samples of its longest run only
        longest = max(flight.runs, key=lambda run: run.stop - run.start)
        run = slice(longest.start, min(longest.stop, longest.start + MOST_SAMPLES))
        flights.append(replace(flight, runs=(run,)).shortened)

    def gains_of(limits: list[CommandLimit]) -> Float[np.ndarray, "blocks k"]:
        return np.concatenate([_gains(flight, limits) for flight in flights])

    rates, levels = _rates(flights), _levels(flights)
    if not (rates or levels):
        return None
    gains = gains_of([*rates, *levels])
    kinds = (gains[:, : len(rates)], rates), (gains[:, len(rates) :], levels)
    gain, limit, ratio = max((_best(*kind) for kind in kinds if kind[1]), key=itemgetter(0))
    if gain < LEAST_GAIN:
        return None
    values = limit.value * np.geomspace(1.0 / ratio, ratio, REFINED)
    refined = [CommandLimit(limit.kind, float(value)) for value in values]
    return _best(gains_of(refined), refined)[1]


def _best(
    gains: Float[np.ndarray, "blocks k"], limits: list[CommandLimit]
) -> tuple[float, CommandLimit, float]:
    """Gain of the best limit of a kind, its interpolated value, and the ratio of neighbours."""
    total, (kind, lowest) = gains.sum(axis=0), limits[0]
    best, ratio = int(total.argmax()), limits[1].value / lowest
    typical = np.sort(gains[:, best])[: math.floor((1.0 - OUTLYING) * len(gains))]
    # the vertex of a parabola through the best and its neighbours
    low, middle, high = total[np.clip([best - 1, best, best + 1], 0, len(limits) - 1)]
    curvature = low - 2.0 * middle + high
    shift = 0.5 * (low - high) / curvature if 0 < best < len(limits) - 1 and curvature < 0.0 else 0.0
    return float(typical.sum()), CommandLimit(kind, float(lowest * ratio ** (best + shift))), ratio


def _rates(flights: Sequence[PreparedFlight]) -> list[CommandLimit]:
    """Rates of commands from half of the rms on the grid to what jumps show; none where commands rest."""
    rates, means = [], []
    for flight in flights:
        for command in flight.issued:
            steps = np.diff(command.time_s)
            step_s = np.median(steps[steps > 0.0]) if steps.any() else np.inf
            rates.append(np.abs(np.diff(command.values)) / step_s)
            gridded = flight.signals.channel(command.name)
            means.append(np.mean(np.gradient(gridded, flight.signals.step_s)[flight.used] ** 2))
    speeds = np.concatenate(rates)
    speeds = speeds[np.isfinite(speeds) & (speeds > 0.0)]
    low, high = 0.5 * float(np.sqrt(np.mean(means))), float(speeds.max()) / JUMP_STEPS if speeds.size else 0.0
    return [CommandLimit(RATE, x) for x in np.geomspace(low, high, RATES)] if 0.0 < low < high else []


def _levels(flights: Sequence[PreparedFlight]) -> list[CommandLimit]:
    """Levels of commands above most of them, below the largest; none where commands rest."""
    levels = [flight.signals.channel(item.name)[flight.used] for flight in flights for item in flight.issued]
    low, high = (float(end) for end in np.quantile(np.concatenate(levels), (0.6, 1.0)))
    return [CommandLimit(LEVEL, x) for x in np.geomspace(low, high, LEVELS)[:-1]] if 0.0 < low < high else []


def with_command_limit(problem: VerticalFlights) -> VerticalFlights:
    """The problem with limited commands, where a limit is found."""
    if problem.unlimited or problem.command_limit:
        return problem
    limit = command_limit(problem)
    if limit is None:
        return problem.with_nuisances(problem.nuisances, unlimited=True)
    limited = problem.of(tuple(flight.within(limit) for flight in problem.flights))
    return replace(limited, command_limit=limit)


# -- Thrust curve --

#: The map is found when another round would change its parameter by less than this; so many rounds are made.
CONVERGED, ROUNDS = 3e-4, 10
#: Lag and delay are searched again so often with the map that was found.
SEARCHES = 3
#: Half of what maps are changed by for derivatives.
STEP = 0.02

Estimated = Callable[[VerticalFlights], Estimate]


def with_map(problem: VerticalFlights, curve: InputMap) -> VerticalFlights:
    """Return the same flights with another input map."""
    return problem.of(tuple(replace(flight, input_map=curve.name) for flight in problem.flights))


def refined_curve(
    problem: VerticalFlights, estimated: Estimated, bias_std: float
) -> tuple[VerticalFlights, Estimate]:
    """Find the map, and estimate with it."""
    family = model.family_of(problem.input_map, fitted=False)
    value, refined, estimate = _by_intercept(problem, estimated, family)
    if math.isnan(value):
        return problem, estimate
    sides = [family.possible(value + step) for step in (-STEP, STEP)]
    below, above = ((side, estimated(with_map(problem, family.map(side)))) for side in sides)
    curve = FittedCurve(family, value, bias_std, below, above)
    return replace(refined, curve=curve), estimate


def _by_intercept(
    problem: VerticalFlights, estimated: Estimated, family: model.CurveFamily
) -> tuple[float, VerticalFlights, Estimate]:
    """Parameter with which the intercept vanishes, or the nearest that is possible, NaN for none."""
    value, current, estimate = math.nan, problem, estimated(problem)
    for _ in range(SEARCHES):
        previous, value = value, _at_nuisances(current, estimated, estimate, family)
        if math.isnan(value) or abs(value - previous) < CONVERGED:
            break
        current = with_map(problem, family.map(value))
        estimate = estimated(current)
    return value, current, estimate


def _at_nuisances(
    problem: VerticalFlights, estimated: Estimated, best: Estimate, family: model.CurveFamily
) -> float:
    """The parameter at fixed lag and delay, on which the map hardly depends."""
    value, current = math.nan, problem
    known = tuple(nuisance.known_at(best.nuisances[nuisance.name]) for nuisance in problem.nuisances)
    for _ in range(ROUNDS):
        previous = value
        balance = Balance(current, best)
        hover, exponent = current.input_map.inverse(balance.hover[0]), balance.exponents[1]
        if not (math.isfinite(exponent) and hover > 0.0):
            return math.nan
        value = family.possible(model.share_of(exponent, hover) if family.of_share else exponent)
        if abs(value - previous) < CONVERGED:
            break
        current = with_map(replace(problem, nuisances=known), family.map(value))
        best = estimated(current)
    return value


def curve_quantities(of: Balance, curve: FittedCurve) -> dict[str, QuantityEstimate]:
    """Quantities with the error of the map, and the map's parameter."""
    estimate = of.estimate
    pairs = [(with_map(of.problem, curve.family.map(p)), item) for p, item in (curve.below, curve.above)]
    sides = [Balance(*pair) for pair in pairs]

    def slope(quantity: Callable[[Balance], Linear]) -> float:
        low, high = (quantity(side)[0] for side in sides)
        return (high - low) / (curve.above[0] - curve.below[0])

    b, of_b, variance_b = of.intercept
    by_b = -1.0 / slope(attrgetter("intercept"))
    of_curve, variance_of_curve = by_b * of_b, variance_b + curve.bias_std**2

    def propagated(quantity: Callable[[Balance], Linear]) -> Linear:
        """A quantity with the error of the map in its gradient and its variance."""
        value, gradient, variance = quantity(of)
        by_curve = slope(quantity)
        return value, gradient + by_curve * of_curve, variance + (by_curve * by_b) ** 2 * variance_of_curve

    formulas: dict[str, tuple[Callable[[Balance], Linear], str]] = {
        "viscous_friction": (partial(_joint, 0), "1/s"),
        "input_gain": (partial(_joint, 1), "m/s^2"),
        "intercept": (attrgetter("intercept"), "m/s^2"),
        "hover_input": (attrgetter("hover_input"), ""),
    }
    rows = formulas.items()
    results = {name: linear_quantity(estimate, unit, *propagated(formula)) for name, (formula, unit) in rows}
    value = curve.value + by_b * b, of_curve, by_b**2 * variance_of_curve
    return {**results, "thrust_curve": linear_quantity(estimate, "", *value)}


def _joint(position: int, balance: Balance) -> Linear:
    values = balance.estimate.values
    return float(values[position]), np.eye(values.size)[position], 0.0


# -- Reported thrust curve --

NOT_IN_FORCE = (
    "The command is before the autopilot's thrust curve, and no value of it that is in force is known "
    "(THR_MDL_FAC, MOT_THST_EXPO): no parameter is proposed."
)


def curve_findings(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity]
) -> tuple[Finding, ...]:
    """The parameter that a curve would set; none where the curve or the hover input is not identified."""
    curve, hover = quantities.get("thrust_curve"), quantities["hover_input"]
    if curve is None or not 0.0 < hover.value < 1.0 or flights[0].input.measured:
        return ()
    side = common_side(flight.curve_side for flight in flights)
    in_force = model.curve_in_force([flight.recording.parameters for flight in flights])
    if Status.REFUSED in (curve.verdict, hover.verdict):
        return _overdone(side, in_force, curve)
    if side is CurveSide.UNKNOWN:
        sentence = (
            f"The log does not say whether {flights[0].input.name} is before or behind the autopilot's "
            f"thrust curve: no parameter is proposed. {model.DECLARE}"
        )
        return (Finding("thrust_curve", sentence),)
    family = model.family_of(input_map(flights[0].input_map))
    before = side is CurveSide.BEFORE
    sentences = []
    for parameter in [
        item for item in model.CURVE_PARAMETERS if item.name in in_force or not (in_force or before)
    ]:
        value, name = in_force.get(parameter.name), parameter.name
        if before and value is not None and not parameter.takes(value):
            continue
        intervals = (curve.value, curve.interval), (hover.value, hover.interval)
        share, _ = model.proposed(parameter, family, *intervals, value if before else None)
        (middle, (low, high)), beyond = share, parameter.beyond(share)
        words = (
            f"No {name} is proposed: {beyond}"
            if beyond
            else (
                f"{name} ({parameter.autopilot}) would be set to {middle:.2f} [{low:.2f}, {high:.2f}] by "
                f"the thrust curve that was fitted, which is {curve.verdict.value}."
            )
        )
        sentences.append(words if value is None else f"{words} The log has {name} {value:.2g}.")
    return (Finding("thrust_curve", " ".join(sentences) or NOT_IN_FORCE),)


def _overdone(side: CurveSide, in_force: Mapping[str, float], curve: Quantity) -> tuple[Finding, ...]:
    """Say that a curve in force bends too much, which no share of the square brings back."""
    large = [f"{name} {value:.2g}" for name, value in in_force.items() if value > 0.0]
    if side is not CurveSide.BEFORE or not large or not curve.interval[1] < 0.0:
        return ()
    sentence = (
        f"Thrust grows more slowly than its setpoint: {' and '.join(large)}, which is in force, is too large "
        "for this vehicle, unless the supply sags. Identify with motor signals behind the curve, or fly with "
        "a smaller value."
    )
    return (Finding("thrust_curve", sentence),)
