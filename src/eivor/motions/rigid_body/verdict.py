"""Allowances and verdict of the rigid body."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations
from operator import attrgetter
from typing import Any

import numpy as np

from eivor.errors import DataError, EstimationError
from eivor.estimation.estimate import Estimate
from eivor.estimation.methods import by_name, identify
from eivor.flights import verdict
from eivor.flights.lag_prior import EFFECTIVE_LAG
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Counts, QuantityEstimate, QuantitySpec
from eivor.inference.confidence_set import principal_axes
from eivor.inference.diagnostics.record import BEYOND_DOUBT
from eivor.inference.random_effects import homogeneity_p_value
from eivor.inference.verdict import Cause, Status
from eivor.logs.common import low_pass_delay_s
from eivor.models import lagged_runs
from eivor.models.lagged_runs import ACTUATOR_LAG, LaggedRuns
from eivor.models.regression import Parameter
from eivor.models.separable import Values, WarmStart
from eivor.motions.equation import DrivenColumns, Term
from eivor.motions.rates.motion import AXES
from eivor.motions.rigid_body import regression as terms
from eivor.motions.rigid_body import vehicle as vehicles
from eivor.motions.rigid_body.compatibility import wind_of
from eivor.motions.rigid_body.dynamics import ATTITUDE, VELOCITY
from eivor.motions.rigid_body.physical_parameters import Combinations
from eivor.motions.rigid_body.regression import DRAG, GAIN, GYROSCOPIC_MOMENT, PRODUCT
from eivor.motions.rigid_body.vehicle import OF_INERTIAS, YAW_OVER_ROLL, KnownVehicle, inertia_ratios
from eivor.signals.filters import time_derivative
from eivor.signals.thrust_map import input_map
from eivor.tools import Complex, Float

#: An onboard filter runs at its logged rate or so many times its cutoff, whichever is more.
STEPS_OF_FILTER = 4.0

#: Makes the problem of flights.
Made = Callable[[tuple[PreparedFlight, ...]], LaggedRuns]

LAGS = (ACTUATOR_LAG.name, lagged_runs.DELAY.name, EFFECTIVE_LAG, *lagged_runs.LAGS_UP_AND_DOWN)


def _early(inputs: verdict.VerdictInputs, name: str) -> tuple[float, float]:
    """The lag is longer where the gyroscope's filter is less late than taken, gains smaller by that share."""
    early_s, lag_s = inputs.checks.filter_early_s, inputs.value(EFFECTIVE_LAG)
    share = early_s / lag_s if lag_s > early_s else 0.0
    return (0.0, share * lag_s) if name in LAGS else (share * abs(inputs.value(name)), 0.0)


def gyroscope_late_s(inputs: verdict.VerdictInputs) -> float:
    """By what the gyroscope is behind attitudes whose stamps were moved to its clock [s]."""
    attitudes = (flight.recording.channels.get(ATTITUDE[0]) for flight in inputs.flights)
    return max([0.0, *(-item.delay_s for item in attitudes if item)])


def filter_early_s(cutoff_hz: float | None, logged_hz: float) -> float:
    """By what a digital filter that runs as slowly as it may is less late than a continuous one [s]."""
    if cutoff_hz is None:
        return 0.0
    x = math.pi * cutoff_hz / max(logged_hz, STEPS_OF_FILTER * cutoff_hz)
    return low_pass_delay_s(cutoff_hz) * (1.0 - x / math.tan(x))


# -- Common rotor inertia --

#: The ratio of inertias is identified when half its interval, by each coupling, is at most this share.
TRUSTED_SHARE = 0.1
#: Level of the intervals of what the three columns and one inertia differ by.
CONSISTENCY_LEVEL = 0.995

_SPINS = (*(item.name for item in GYROSCOPIC_MOMENT), terms.REACTION.name)


def refined_rotor_inertia(
    problem: LaggedRuns, free: Estimate, estimated: Callable[[LaggedRuns], Estimate]
) -> tuple[LaggedRuns, Estimate]:
    """The problem with one inertia of the rotors where the flights identify that there is one."""
    ratios = identified_ratios(free)
    if ratios is None:
        return problem, free
    hover, _ = hover_over_usual(problem, free)
    linked = with_common_rotor_inertia(problem, ratios, free, hover)
    return linked, estimated(linked)


def hover_over_usual(
    problem: LaggedRuns, estimate: Estimate
) -> tuple[float, Float[np.ndarray, " joint"] | float]:
    """State of a rotor at hover over that which drag and damping are for, and its gradient."""
    states = terms.body_equation(problem.columns[0]).rotors
    thrust = estimate.parameters.get(terms.THRUST.name, 0.0)
    hover = terms.hover_state(states.flight, states.vehicle, thrust)
    if hover is None:
        return 1.0, 0.0
    curve = input_map(states.flight.input_map)
    by_thrust = -float(curve(np.array([hover]))[0]) / (curve.slope(hover) * thrust * states.usual)
    return hover / states.usual, by_thrust * estimate.direction(terms.THRUST.name)


def identified_ratios(estimate: Estimate) -> tuple[float, float] | None:
    """Ratios of the inertias; None where they are not identified, or the three columns are not."""
    finite = Combinations.of_estimate(estimate).finite()
    if not finite.has(*OF_INERTIAS, *_SPINS):
        return None
    values = dict(zip(finite.names, finite.joint.values.tolist(), strict=True))
    if not min(values[item.name] for item in GAIN[: terms.YAW_EQUATION]) > 0.0:
        return None
    for ratio in YAW_OVER_ROLL:
        value = finite.value(ratio)
        low, high = value.interval
        if not (low > 0.0 and high - low <= 2.0 * TRUSTED_SHARE * value.value):
            return None
    mean = f"0.5 * ({' + '.join(YAW_OVER_ROLL)}) * rotor_reaction"
    for differs in (f"roll_by_spin - {mean}", f"pitch_by_spin - {mean} / ({vehicles.PITCH_OVER_ROLL})"):
        low, high = finite.value(differs, level=CONSISTENCY_LEVEL).interval
        if not low <= 0.0 <= high:
            return None
    return inertia_ratios(values)


def with_common_rotor_inertia(
    problem: LaggedRuns, ratios: tuple[float, float], free: Estimate | None = None, hover: float = 1.0
) -> LaggedRuns:
    """The problem with gyroscopic columns linked to J / Izz, at a hover state."""
    stays = tuple(item for item in problem.parameters if item not in GYROSCOPIC_MOMENT)
    names = dict(zip((item.name for item in GYROSCOPIC_MOMENT), terms.RATIOS, strict=True))
    states = {item.flight: terms.body_equation(item).rotors for item in problem.columns}
    at_hover = {
        number: replace(item, usual=hover * item.usual, inertia_ratios=ratios, _last=None)
        for number, item in states.items()
    }
    columns, reaction = [], terms.REACTION
    for column in problem.columns:
        axis, rotors = terms.body_equation(column), at_hover[column.flight]
        linked_terms = [
            Term(reaction.name, f"{names[item.name]} * ({item.of})", item.symbol, reaction.unit, behind=True)
            if item.name in names
            else item
            for item in axis.terms
        ]
        axis = replace(axis, terms=tuple(linked_terms), rotors=rotors)
        indices = tuple(stays[problem.still :].index(term.parameter) for term in linked_terms if term.behind)
        columns.append(replace(column, moving=DrivenColumns(axis, rotors.signals), moved=indices))
    noisier = problem.noisier
    if noisier is not None:
        noisier = with_common_rotor_inertia(noisier, ratios, hover=hover)
    warm_start = None
    if free is not None:
        factors = dict.fromkeys(terms.AT_HOVER, hover)
        theta = [factors.get(item, 1.0) * free.parameters[item.name] for item in stays]
        warm_start = WarmStart(np.array(theta), free.nuisances)
    return replace(problem, columns=tuple(columns), parameters=stays, noisier=noisier, warm_start=warm_start)


def with_products(
    problem: LaggedRuns, values: Values, products: Sequence[Parameter], **changes: Any
) -> LaggedRuns:
    """The problem with columns of off-diagonal elements of the inertia matrix, and other changes."""
    if not products:
        return replace(problem, **changes) if changes else problem
    shares, columns = vehicles.inertia_shares(values), []
    for item in problem.columns:
        extra = np.zeros((item.fixed.shape[0], len(products)))
        if item.axis < terms.FORCE_X_EQUATION:
            texts = [terms.BY_PRODUCT[item.axis][PRODUCT.index(entry)] for entry in products]
            axis = terms.body_equation(item)
            extra = shares[item.axis] * axis.columns(axis.rotors.signals, texts)
        columns.append(replace(item, fixed=np.hstack([item.fixed, extra])))
    noisier = None if problem.noisier is None else with_products(problem.noisier, values, products)
    parameters = (*problem.parameters[: problem.still], *products, *problem.parameters[problem.still :])
    return replace(problem, columns=tuple(columns), parameters=parameters, noisier=noisier, **changes)


def gyroscopic_moments(
    problem: LaggedRuns, joint: Mapping[str, QuantityEstimate]
) -> dict[str, QuantityEstimate]:
    """J / Ixx and J / Iyy, by J / Izz, of a problem in which they are one with it; else nothing."""
    ratios = terms.body_equation(problem.columns[0]).rotors.inertia_ratios
    reaction = joint.get(terms.REACTION.name)
    if ratios is None or reaction is None:
        return {}
    return {item.name: reaction.times(ratios[axis]) for axis, item in enumerate(GYROSCOPIC_MOMENT)}


def with_gyroscopic_moments(models: Sequence[Values]) -> list[Values]:
    """Values of models with J / Ixx and J / Iyy as well, by the ratios of the first."""
    fit, names = models[0], [item.name for item in GYROSCOPIC_MOMENT]
    if not {terms.REACTION.name, *OF_INERTIAS} <= set(fit) or names[0] in fit:
        return list(models)
    ratios = dict(zip(names, inertia_ratios(fit), strict=True))
    pairs = zip(models, [values.get(terms.REACTION.name, 0.0) for values in models], strict=True)
    return [{**values, **{name: ratio * J for name, ratio in ratios.items()}} for values, J in pairs]


# -- Consistency of lags --


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Contradiction of a flight to the vehicle file, among its axes, or to calm air."""

    sentence: str
    remedy: str
    numbers: Mapping[str, float]  # The same as numbers of a result


#: Axes that rotors drive, and what they are called.
DRIVEN = dict(enumerate(terms.TURNING)) | {terms.FORCE_Z_EQUATION: "thrust"}
#: A step is no longer small, and its size says little, beyond this share of the lag.
LARGE_STEP = 0.5
_CHANGE = "_lag_change_s"


def disagreeing_lags(lag_s: float, changes_s: Mapping[str, float], p_value: float) -> Contradiction:
    """Axes that do not agree about the lag."""
    changes = [
        f"{name} asks for {1e3 * (lag_s + change):.0f} ms"
        if abs(change) <= LARGE_STEP * lag_s
        else f"{name} for a much {'longer' if change > 0.0 else 'shorter'} one"
        for name, change in changes_s.items()
    ]
    return Contradiction(
        f"The axes disagree about the lag (p-value {p_value:.1g}). For all of them it is "
        f"{1e3 * lag_s:.0f} ms; by itself {', '.join(changes)}.",
        "What moves the vehicle beside its rotors comes back through the controller: log setpoints, by "
        "which the two are distinguished, and fly in calm air. A delay that was given wrong shows alike.",
        {"lag_agreement_p": p_value, "lag_of_all_s": lag_s}
        | {f"{name}{_CHANGE}": change for name, change in changes_s.items()},
    )


def lag_consistency_test(estimate: Estimate) -> Contradiction | None:
    """Axes that disagree about the lag beyond doubt; None where they agree, or instruments say more."""
    if estimate.assembler.needs_instruments:
        return None
    names = [profile.nuisance.name for profile in estimate.profiles]
    if ACTUATOR_LAG.name not in names:
        return None
    rows, lag_columns = estimate.rows, estimate.nuisance_columns[:, names.index(ACTUATOR_LAG.name)]
    residual, axes = rows.response - rows.regressors @ estimate.theta, rows.layout.axis_of_row
    changes, variances = {}, []
    for axis, name in DRIVEN.items():
        on_axis = axes == axis
        column, regressors = lag_columns[on_axis], rows.regressors[on_axis]
        sizes = np.linalg.norm(regressors, axis=0)
        basis, _ = np.linalg.qr(regressors[:, sizes > 0.0] / sizes[sizes > 0.0])
        residual_column: Float[np.ndarray, " rows"] = column - basis @ (basis.T @ column)
        squares = float(residual_column @ residual_column)
        if squares > 0.0:
            changes[name] = float(residual_column @ residual[on_axis]) / squares
            variances.append(float(np.mean(residual[on_axis] ** 2)) / squares)
    if len(changes) < 2:
        return None
    p_value = homogeneity_p_value(np.array(list(changes.values())), np.array(variances))
    lag_s = sum(estimate.nuisances.get(item, 0.0) for item in (ACTUATOR_LAG.name, lagged_runs.DELAY.name))
    return disagreeing_lags(lag_s, changes, p_value) if p_value < BEYOND_DOUBT else None


# -- Rotor order --

#: Band that is looked at [Hz], and lags [s].
BAND_HZ = (0.5, 8.0)
LAGS_S = np.geomspace(0.01, 0.16, 9)
#: All orders of up to so many rotors; of more, those with two of them exchanged.
MOST_ORDERED = 4
#: Another order must leave so much less, in logarithms summed over axes, and explain so much of one axis.
LEAST_IMPROVEMENT = 0.3
LEAST_EXPLAINED = 0.25
#: Of orders that differ by less the one with the fewest changes is reported.
TIE_MARGIN = 0.05

CORRECT_ROTORS = "Correct positions and spins in the vehicle file, in the order of the rotor commands."


def _order_words(acts_as: tuple[int, ...]) -> str:
    exchanged = [rotor for rotor, item in enumerate(acts_as, start=1) if abs(item) != rotor]
    reversed_rotors = [abs(item) for item in acts_as if item < 0]
    if not exchanged:
        return f"{_rotors(reversed_rotors)} the other way than the vehicle file says"
    if len(exchanged) == 2 and not reversed_rotors:
        return f"Rotors {exchanged[0]} and {exchanged[1]} look exchanged"
    commands = ", ".join(map(str, range(1, len(acts_as) + 1)))
    positions = ", ".join(map(str, map(abs, acts_as)))
    order = f"The commands {commands} look to act as the rotors {positions} of the vehicle file"
    return f"{order}, of which {_rotors(reversed_rotors).lower()} the other way" if reversed_rotors else order


def _rotors(numbers: Sequence[int]) -> str:
    *others, last = map(str, sorted(numbers))
    return f"Rotors {', '.join(others)} and {last} look to spin" if others else f"Rotor {last} looks to spin"


def observed_order(flights: Sequence[PreparedFlight], vehicle: KnownVehicle) -> Contradiction | None:
    """Order that flights show where it is clearly another than that of the vehicle file; else None."""
    products = np.sum([_products(flight) for flight in flights], axis=0)
    orders, arms = zip(*_orders(vehicle), strict=True)
    rows, power = np.stack(arms), products[:, None, :, -1, -1]
    squares = np.einsum("oai,laij,oaj->loa", rows, products[:, :, :-1, :-1], rows)
    cross = np.einsum("oai,lai->loa", rows, products[:, :, :-1, -1])
    gain = cross / np.where(squares > 0.0, squares, np.inf)
    unexplained = np.maximum(1.0 - gain * cross / np.where(power > 0.0, power, np.inf), 1e-6)
    score = np.log(unexplained).sum(axis=2)
    lag = int(np.argmin(score.min(axis=1)))
    score, unexplained, gain = score[lag], unexplained[lag], gain[lag]
    best = float(score.min())
    if score[0] - best < LEAST_IMPROVEMENT:
        return None

    def changes(number: int) -> tuple[int, int, int]:
        """Counts of negative gains, and of spins and places that differ from the vehicle file."""
        acts_as = orders[number]
        positions = sum(abs(item) != index for index, item in enumerate(acts_as, start=1))
        return int((gain[number] < 0.0).sum()), sum(item < 0 for item in acts_as), positions

    order = min(np.flatnonzero(score < best + TIE_MARGIN).tolist(), key=changes)
    axis = int(np.argmax(unexplained[0] - unexplained[order]))
    explained, by_file = 1.0 - float(unexplained[order, axis]), 1.0 - float(unexplained[0, axis])
    if not explained > LEAST_EXPLAINED:
        return None
    rotors = {f"rotor_{rotor}_acts_as": float(item) for rotor, item in enumerate(orders[order], start=1)}
    by_order = {"order_axis": float(axis), "order_explained": explained, "order_explained_by_file": by_file}
    return Contradiction(
        f"{_order_words(orders[order])}: so the rotors explain {explained:.0%} of {AXES[axis].name}, and "
        f"{by_file:.0%} by the vehicle file.",
        CORRECT_ROTORS,
        rotors | by_order,
    )


def _orders(vehicle: KnownVehicle) -> Iterator[tuple[tuple[int, ...], Float[np.ndarray, "3 rotors"]]]:
    """Candidate orders of the rotors with their arms; that of the vehicle file first."""
    rotors = tuple(range(vehicle.count))
    orders: Iterator[tuple[int, ...]] = permutations(rotors)
    if vehicle.count > MOST_ORDERED:
        exchanged = ({item: second, second: item} for item, second in combinations(rotors, 2))
        orders = iter([rotors, *(tuple(item.get(rotor, rotor) for rotor in rotors) for item in exchanged)])
    for order in orders:
        index = list(order)
        spins_moved = vehicle.arms[3, index]
        for spins in (spins_moved, vehicle.arms[3], *(spins_moved * (1.0 - 2.0 * np.eye(vehicle.count)))):
            signs = np.where(spins * spins_moved > 0.0, 1, -1).tolist()
            acts_as = tuple(sign * (item + 1) for sign, item in zip(signs, order, strict=True))
            yield acts_as, np.stack([*vehicle.arms[1:3, index], spins])


def _products(flight: PreparedFlight) -> Float[np.ndarray, "lags 3 m m"]:
    """Products of rotors and turning over the bins, for each lag and axis, after partialling out."""
    signals = flight.signals
    rates = np.column_stack([signals.channel(axis.rate) for axis in AXES])
    change = np.column_stack([time_derivative(rate, signals.step_s) for rate in rates.T])
    coupling = np.roll(rates, -1, axis=1) * np.roll(rates, -2, axis=1)
    mapped = input_map(flight.input_map)(signals.family(flight.input.name))
    series = np.column_stack([change, rates, coupling, mapped])
    bands = replace(flight, band_hz=BAND_HZ).spectral_runs()
    bins = np.concatenate([band.spectrum(series[run]) for band, run in zip(bands, flight.runs, strict=True)])
    frequency = np.concatenate([band.frequency_hz for band in bands])
    count = bins.shape[1] - 9
    results = np.zeros((LAGS_S.size, 3, count + 1, count + 1))
    for number, lag_s in enumerate(LAGS_S):
        lagged = bins[:, 9:] / (1.0 + 2j * np.pi * frequency * lag_s)[:, None]
        for axis in range(3):
            stays = np.column_stack([bins[:, 3 + axis], bins[:, 6 + axis], lagged.sum(axis=1)])
            moves = _without(stays, np.column_stack([lagged, bins[:, axis]]))
            results[number, axis] = np.real(moves.conj().T @ moves)
    return results


def _without(
    stays: Complex[np.ndarray, "bins s"], moves: Complex[np.ndarray, "bins m"]
) -> Complex[np.ndarray, "bins m"]:
    """Columns without what real multiples of others explain of them."""
    split = np.concatenate([stays.real, stays.imag])
    shares, *_ = np.linalg.lstsq(split, np.concatenate([moves.real, moves.imag]), rcond=1e-10)
    return moves - stays @ shares


# -- Wind --

#: Level of the interval that has to exclude that no wind blew, and the least speed that is identified [m/s].
SURE, LEAST_SPEED = 0.999, 0.5
_WIND = (Parameter("wind_drag_x", "m/s^2"), Parameter("wind_drag_y", "m/s^2"))


def flights_of(problem: LaggedRuns) -> list[PreparedFlight]:
    """Flights of the columns of a problem, with the air at rest."""
    flights = {column.flight: terms.body_equation(column).rotors.flight for column in problem.columns}
    return [flights[number] for number in sorted(flights)]


def with_air_at_rest(problem: LaggedRuns, nuisance_values: Values, made_of: Made) -> LaggedRuns:
    """The problem less the steady winds that flights show; itself where they show none."""
    calm, known = flights_of(problem), False
    for number, flight in enumerate(calm):
        estimate, drag = _of_flight(problem, nuisance_values, number, flight)
        if estimate is not None:
            wind = [estimate.parameters[item.name] / drag for item in _WIND]
            intervals = [estimate.interval(item.name, SURE) for item in _WIND]
            if math.hypot(*wind) >= LEAST_SPEED and any(low > 0.0 or high < 0.0 for low, high in intervals):
                calm[number], known = _faster(flight, [-speed for speed in wind]), True
    return _like(made_of(tuple(calm)), problem) if known else problem


def _faster(flight: PreparedFlight, speed: Sequence[float]) -> PreparedFlight:
    """The flight with this added to its velocity."""
    logged = flight.signals.channels
    moved = {name: logged[name] + add for name, add in zip(VELOCITY, speed, strict=False)}
    return replace(flight, signals=replace(flight.signals, channels={**logged, **moved}))


def _like(made: LaggedRuns, problem: LaggedRuns) -> LaggedRuns:
    """A problem of other velocities with the instruments and bands of one."""
    pairs = zip(made.columns, problem.columns, strict=True)
    columns = (replace(new, instruments=old.instruments, band_hz=old.band_hz) for new, old in pairs)
    return replace(problem, columns=tuple(columns), noisier=made.noisier, warm_start=None)


def steady_wind(problem: LaggedRuns, flights: Sequence[PreparedFlight]) -> Contradiction | None:
    """The strongest wind that was taken out of flights; None where none was."""
    taken = [
        [float(np.mean(item.signals.channel(name) - moved.signals.channel(name))) for name in VELOCITY[:2]]
        for item, moved in zip(flights, flights_of(problem), strict=True)
        if item.signals is not moved.signals
    ]
    if not taken:
        return None
    x, y = max(taken, key=lambda wind: math.hypot(*wind))
    return Contradiction(
        f"A steady wind of about {math.hypot(x, y):.2g} m/s seems to have blown. It is taken out of the "
        "velocities, but not its gusts, which the drags along x and y suffer from.",
        "Fly in calm air for these drags, or log the velocity through the air.",
        {"steady_wind_x": x, "steady_wind_y": y},
    )


def _of_flight(
    problem: LaggedRuns, nuisance_values: Values, number: int, flight: PreparedFlight
) -> tuple[Estimate | None, float]:
    """Drag by the mean wind over a flight, None where it is not known, and drag of its velocity."""
    if not set(terms.QUADRATIC_DRAG[:2]) <= set(problem.parameters):
        return None, 1.0
    signals = flight.signals
    item, nothing = np.ones(signals.sample_count), np.zeros(signals.sample_count)
    along_x = terms.on_body_axes(signals, item, nothing, nothing)
    along_y = terms.on_body_axes(signals, nothing, item, nothing)
    index = [problem.parameters.index(entry) for entry in terms.QUADRATIC_DRAG[:2]]
    columns = tuple(
        replace(
            column,
            fixed=np.column_stack([along_x[:, along], along_y[:, along], column.fixed[:, index]]),
            instruments=np.empty((column.fixed.shape[0], 0)),
            moved=(along,),
        )
        for column in problem.columns
        if column.flight == number and (along := column.axis - terms.FORCE_X_EQUATION) in (0, 1)
    )
    known = tuple(nuisance.known_at(nuisance_values[nuisance.name]) for nuisance in problem.nuisances)
    try:
        runs = LaggedRuns(columns, (*_WIND, *terms.QUADRATIC_DRAG[:2], *DRAG[:2]), known)
        estimate = identify(runs, by_name("whitened_least_squares"))
    except (DataError, EstimationError):  # too short, or a heading that stays
        return None, 1.0
    drag = 0.5 * sum(estimate.parameters[entry.name] for entry in DRAG[:2])
    return (estimate if drag > 0.0 else None), drag


def half_widths_by_wind(
    problem: LaggedRuns, estimate: Estimate, flights: Sequence[PreparedFlight], made_of: Made
) -> dict[str, float]:
    """Errors of parameters by those of the winds that were removed, at the lag of the estimate."""
    at = tuple(nuisance.known_at(estimate.nuisances[nuisance.name]) for nuisance in problem.nuisances)
    spin = terms.body_equation(problem.columns[0]).rotors.inertia_ratios
    chosen = [item for item in PRODUCT if item in problem.parameters]
    flying = flights_of(problem)

    def by(number: int, speed: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " k"]:
        moved = [*flying[:number], _faster(flying[number], speed.tolist()), *flying[number + 1 :]]
        made = with_products(made_of(tuple(moved)), estimate.parameters, chosen)
        made = made if spin is None else with_common_rotor_inertia(made, spin)
        runs = replace(_like(made, problem), nuisances=at)
        return identify(runs, by_name(estimate.method)).theta

    changes = []
    for number, flight in enumerate(flights):
        if flying[number].signals is flight.signals:
            known, drag = wind_of(flight.recording, [flight.span_s]), 1.0  # by an airspeed
        else:
            known, drag = _of_flight(problem, estimate.nuisances, number, flying[number])
        for part in () if known is None else known.joint_covariance.parts:
            axes = principal_axes(part.matrix[:2, :2], part.half_widths(0.95)).T / drag
            changes += [0.5 * (by(number, axis) - by(number, -axis)) for axis in axes]
    halves = np.sqrt(np.square(changes).sum(axis=0)).tolist() if changes else ()
    return dict(zip(estimate.names, halves, strict=False))


# -- Weak instruments and lags that disagree --

#: Of two-stage least squares the bias is the share 1 / F of that of least squares (Staiger and Stock 1997):
#: half of it by this F. Below it, which instruments reach that say nothing, the largest bias counts.
HALF_F = 2.0


def possible_shifts(estimate: Estimate, lags: Contradiction | None) -> dict[str, tuple[float, float]]:
    """Possible shifts of each parameter down and up, by lags of single axes or by instruments."""
    if lags is not None:
        sizes = np.array([size for name, size in lags.numbers.items() if name.endswith(_CHANGE)])
        near, lag = np.abs(sizes) <= LARGE_STEP * lags.numbers["lag_of_all_s"], ACTUATOR_LAG.name
        errors = estimate.joint_covariance.parts[0].matrix[estimate.names.index(lag)]
        shifts = np.outer(sizes[near], errors / errors[estimate.names.index(lag)])
    elif estimate.unrefined is not None:
        shifts = estimate.unrefined[None]
    elif estimate.assembler.needs_instruments:
        known = np.sqrt(estimate.equation.variance) * estimate.prior_rows()
        # least squares of the rows as far as instruments have power there
        power = np.append(estimate.instrument_power, np.ones(len(known)))
        rows = np.vstack([estimate.jacobian, known]) * power[:, None]
        residual, lengths = np.pad(estimate.residuals, (0, len(known))) * power, np.linalg.norm(rows, axis=0)
        lengths[lengths == 0.0] = 1.0
        inverse = np.linalg.pinv(rows / lengths) / lengths[:, None]
        # the bias of least squares is largest where all of the residual goes with what instruments leave
        largest = np.linalg.norm(inverse, axis=1) * np.linalg.norm(residual)
        F = estimate.first_stage
        ends = np.where(F < HALF_F, largest, -(inverse @ residual) / (np.maximum(F, HALF_F) - 1.0))
        shifts = np.stack([ends, np.where(F < HALF_F, -largest, ends)])
    else:
        return {}
    results = dict(zip(estimate.names, shifts.T, strict=True))
    of_lag = results.get(ACTUATOR_LAG.name, np.zeros(len(shifts)))
    results |= dict.fromkeys(lagged_runs.LAGS_UP_AND_DOWN, of_lag)
    results[EFFECTIVE_LAG] = of_lag + results.get(lagged_runs.DELAY.name, 0.0)
    return {name: (-min([0.0, *ends]), max([0.0, *ends])) for name, ends in results.items()}


def _shift_sentence(inputs: verdict.VerdictInputs) -> str:
    if inputs.checks.lags is not None:
        return "The axes disagree about the lag: intervals reach to what each of them asks for."
    if inputs.checks.refined:
        return (
            "Output error and instruments disagree beyond their errors: intervals reach to the instruments."
        )
    name, F = min(inputs.first_stage.items(), key=lambda item: item[1])
    words = f"first-stage F is {F:.3g} for the {name.replace('_', ' ')}"
    return f"Estimates lie the more towards least squares, the weaker the instruments are: {words}."


@dataclass(frozen=True, slots=True)
class RigidBodyChecks(verdict.MotionChecks):
    """Contradiction of a flight to the vehicle file, among its axes or to calm air; None without."""

    order: Contradiction | None = None
    wind: Contradiction | None = None
    lags: Contradiction | None = None
    filter_early_s: float = 0.0  # By what the gyroscope's filter may be less late than it is taken to be [s]
    by_wind: Mapping[str, float] = field(default_factory=dict)  # Half-widths by the errors of winds
    shifts: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # See `possible_shifts`
    refined: bool = False  # Whether these are to the values before output error

    @property
    def numbers(self) -> dict[str, float]:
        parts = (self.order, self.wind, self.lags)
        return {name: value for part in parts if part is not None for name, value in part.numbers.items()}


# -- Rule --

WORDS = terms.TABLES.words
LEAST_HZ, LEAST_S = 45.0, 10.0
LONGER = "Fly larger and quicker steps, or longer."
GAIN_LIMIT = verdict.Limit(0.1, 0.25, zero=Status.REFUSED, narrower=LONGER, away_from_zero=WORDS.fly)
SLOW_LIMIT = verdict.Limit(0.5, zero=Status.WEAK, narrower=LONGER, away_from_zero=WORDS.fly)
COUPLING_LIMIT = verdict.Limit(identified_within=0.1, narrower=LONGER)
QUICKER = "Fly quicker steps, and log rotors and rates faster."
LAG_LIMIT = verdict.Limit(0.25, 0.5, 0.02, 0.02, narrower=QUICKER)

_TURNING = tuple(item.name for item in GAIN)
_GAINS = (terms.THRUST.name, *_TURNING)
_DAMPINGS = tuple(item.name for item in terms.DAMPING)
LIMITS = {
    **dict.fromkeys(_GAINS, GAIN_LIMIT),
    **dict.fromkeys([*_DAMPINGS, *(item.name for item in (*DRAG, terms.FRICTION, terms.LIFT))], SLOW_LIMIT),
    **dict.fromkeys([item.name for item in terms.COUPLING], COUPLING_LIMIT),
}
_DRAGS = tuple(item.name for item in (*DRAG, *terms.QUADRATIC_DRAG))
_NO_DRAG = "a disturbance that goes with the motion, such as wind, not the air's drag"
_PUSHED = "a torque that goes with the turning drives it"
#: What a steady wind makes wrong: the drags across.
ACROSS = tuple(item.name for item in (*DRAG[:2], *terms.QUADRATIC_DRAG[:2]))

_TERMS = tuple(term.name for _, term in terms.TERMS)

#: All that instruments determine.
_DETERMINED = (*LAGS, lagged_runs.ASYMMETRY.name, *_TERMS, *(item.name for item in PRODUCT))


def _reaction_s(inputs: verdict.VerdictInputs, name: str) -> float:
    """Rotors' reaction to a change of their speeds over the yaw torque of the speeds, zero of others [s]."""
    if name not in _SPINS:
        return 0.0
    usual, curve = terms.usual_state(inputs.flights), input_map(inputs.flights[0].input_map)
    return abs(inputs.value(terms.REACTION.name) / (inputs.value(GAIN[2].name) * curve.slope(usual)))


PARTS = (
    verdict.disagreement_part(_DETERMINED),
    *verdict.clock_parts(LAGS, (*_TURNING, *_SPINS), _DAMPINGS, Counts.INDEPENDENT, reaction_s=_reaction_s),
    verdict.SystematicPart(
        (*LAGS, *_TURNING),
        Counts.ADDED,
        _early,
        lambda inputs: (
            "How often the gyroscope's filter runs is not known: the lag may be "
            f"{1e3 * inputs.checks.filter_early_s:.2g} ms longer, and gains smaller by as large a share."
        ),
    ),
    verdict.SystematicPart(
        (lagged_runs.DELAY.name, EFFECTIVE_LAG),
        Counts.ADDED,
        lambda inputs, _: (gyroscope_late_s(inputs), 0.0),
        lambda inputs: (
            "The gyroscope is behind the attitude, as behind a low-pass that the vehicle file does not name: "
            f"the delay may be {1e3 * gyroscope_late_s(inputs):.2g} ms shorter."
        ),
    ),
    verdict.SystematicPart(
        _DETERMINED,
        Counts.INDEPENDENT,
        lambda inputs, name: inputs.checks.by_wind.get(name, 0.0),
        "The wind that was taken out has an error.",
    ),
    verdict.SystematicPart(
        _DETERMINED, Counts.ADDED, lambda inputs, name: inputs.checks.shifts.get(name, 0.0), _shift_sentence
    ),
)


def all_rules(wording: Mapping[str, QuantitySpec]) -> tuple[verdict.Rule, ...]:
    """Rows of every quantity of the rigid body."""
    rules = [
        verdict.Rule(
            (),
            lambda inputs: inputs.command_rate_hz < LEAST_HZ,
            Status.WEAK,
            lambda inputs: (
                f"Rotors are logged at {inputs.command_rate_hz:.0f} Hz; {LEAST_HZ:.0f} Hz are needed."
            ),
            "Log them at 100 Hz or more.",
        ),
        verdict.seconds_rule(LEAST_S),
        _check_rule("order", status=Status.REFUSED),
        _check_rule("lags"),
        _check_rule("wind", ACROSS),
        *verdict.lag_rules(LAG_LIMIT, wording[EFFECTIVE_LAG]),
        *(rule for name in lagged_runs.LAGS_UP_AND_DOWN for rule in LAG_LIMIT.rules(name, wording[name])),
        *verdict.flight_rules(WORDS, LAGS, ()),
    ]
    for name in wording:
        if name in (*LAGS, *lagged_runs.STAGES, lagged_runs.ASYMMETRY.name):
            continue
        rules += verdict.flight_rules(WORDS, (name,), ())
        if name in _DRAGS:
            rules.append(verdict.below_zero_rule(name, wording[name], Status.WEAK, _NO_DRAG, WORDS.fly))
        if name in _DAMPINGS:
            rules.append(verdict.below_zero_rule(name, wording[name], Status.REFUSED, _PUSHED, WORDS.fly))
        if name in _GAINS:
            plain, wrong = replace(wording[name], unit=""), _what_is_wrong(name)
            rules.append(verdict.below_zero_rule(name, plain, Status.REFUSED, wrong, CORRECT_ROTORS))
        if name in LIMITS:
            rules += LIMITS[name].rules(name, wording[name])
    return tuple(rules)


def _check_rule(check: str, quantities: tuple[str, ...] = (), status: Status = Status.WEAK) -> verdict.Rule:
    check_of = attrgetter(check)
    return verdict.Rule(
        quantities,
        lambda inputs: check_of(inputs.checks) is not None,
        status,
        lambda inputs: str(check_of(inputs.checks).sentence),
        lambda inputs: str(check_of(inputs.checks).remedy),
        Cause.CONTRADICTION if status is Status.REFUSED else Cause.OTHER,
    )


def _what_is_wrong(name: str) -> str:
    if name == terms.THRUST.name:
        return "the rotor commands, or the accelerometer along z, have the wrong sign"
    axis = name.removesuffix("_gain")
    why = f"the rotors' order about {axis} is another than that of the vehicle file"
    if name == GAIN[2].name:
        why = "the rotors spin the other way than the vehicle file says"
    return f"{why}, or the rate of {axis} has the wrong sign"
