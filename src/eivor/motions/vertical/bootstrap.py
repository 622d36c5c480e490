"""Bootstrap of flights: a pool estimated again from flights drawn with replacement.

Whole flights are drawn, so that whatever is alike within a flight (gusts, a bias, the shape of its
reference) stays together, and nothing is assumed of it. In each replicate lag and delay are searched
again.

What costs time does not depend on the draw. Each flight's whitened columns are multiplied once, for every
lag of the grid and every delay; a replicate adds the products of its flights. Between the grid's lags the
products are interpolated by cubic splines over the logarithm of the lag. The whitening is the pool's own,
run by run, renewed once more at its estimate: it weights rows, so that its error changes the estimate to
second order only.

With more instruments than parameters the pool's own equations are not solved exactly, Q'e is not zero. It is
subtracted in every replicate (Hall and Horowitz 1996): what is drawn again is the flights' deviation from
the pool, and delays are told apart as often as they are by new flights. Left in, it counts twice against
every delay, and replicates jump between delays that the pool itself can tell apart.

Notation: Q pool's orthonormal instruments, V, U and y whitened columns of a flight; sums over flights f
with counts w_f. A replicate's instruments have the Gram matrix L L' = sum w_f Q_f'Q_f, which is near the
identity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eivor import checks
from eivor.errors import CollinearError, EivorError, UsageError
from eivor.estimation.assembler import Instrumental
from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.method import Method
from eivor.estimation.methods import by_name
from eivor.estimation.weighting.whitening import SpectralWhitening, whitened_by_residuals
from eivor.flights.result import FlightEstimate
from eivor.inference.resampling.replicates import Bootstrap, check_draws
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.regression import Regression
from eivor.models.separable import Values
from eivor.motions.vertical.flights import VerticalFlights

#: Replicates that are made when their number is not named.
RUNS = 999
#: Points at which a bracket of lags is searched, and how often it is narrowed to the best one's neighbours.
POINTS, ZOOMS = 33, 4
#: Directions of a replicate's instruments with smaller shares of power are dropped.
SMALLEST_POWER = 1e-8
#: Where a lag's products are: projections, then V'U, y'U, U'U and the sum of U over the samples.
VU, YU, UU, SUM = -4, -3, -2, -1


def bootstrap_flights(
    fit: FlightEstimate, *, runs: int = RUNS, seed: int | np.random.Generator = 0
) -> Bootstrap:
    """Bootstrap the estimate of a pool of flights by drawing whole flights.

    Parameters
    ----------
    fit : FlightEstimate
        Of several flights, from `identify_flight` with its default method.
    runs : int
        Replicates to make.
    seed : int or numpy.random.Generator
        The same seed gives the same replicates.

    Returns
    -------
    Bootstrap
        Replicates of viscous_friction, input_gain, actuator_lag and effective_lag (unless the actuators'
        state is measured) and hover_input. Take the expanded intervals, the default: with ten flights the
        percentiles themselves are too narrow by a sixth.

    Raises
    ------
    UsageError
        Without an estimate by whitened instruments of two flights or more.

    Notes
    -----
    Some seconds for a pool of ten flights of a minute; a replicate takes a few milliseconds, whatever the
    flights' length.
    """
    checks.kind(
        "fit", fit, FlightEstimate, "a pool's estimate", "Make one by ev.identify_flight(recordings)."
    )
    check_draws(runs, seed)
    problem, estimate = _pool(fit)
    best = estimate.best
    delays = [_delay_moments(problem, candidate, best) for candidate in estimate.candidates]
    count = len(problem.flights)
    random = np.random.default_rng(seed)
    whole = _estimate(problem, delays, np.ones(count))
    found = []
    for _ in range(runs):
        drawn = np.bincount(random.integers(0, count, count), minlength=count).astype(np.float64)
        try:
            found.append(_estimate(problem, delays, drawn))
        except (EivorError, np.linalg.LinAlgError):
            continue
    searched = problem.lag.searched
    names = ("viscous_friction", "input_gain", "hover_input", "actuator_lag", "effective_lag")
    units = ("1/s", "m/s^2", "", "s", "s")
    shown = len(names) if searched else 3
    return Bootstrap(
        names[:shown],
        units[:shown],
        whole[:shown],
        np.array(found).reshape(len(found), len(names))[:, :shown],
        runs - len(found),
        count,
        float("nan"),
        None if isinstance(seed, np.random.Generator) else seed,
    )


def _pool(result: FlightEstimate) -> tuple[VerticalFlights, Estimate]:
    """Return the pool's problem and its estimate.

    Raises
    ------
    UsageError
        When it cannot be resampled.
    """
    if result.fit is None:
        raise UsageError(
            "a pool with an estimate", "one without", "See its verdict for what the flights lack."
        )
    problem, estimate = result.fit.problem, result.fit.estimate
    if not isinstance(problem, VerticalFlights):
        raise UsageError(
            "a pool of vertical motion", f"one of {result.motion.words.title.lower()}", "Use its intervals."
        )
    method = by_name(estimate.method)
    if not _whitens_instruments(method):
        raise UsageError(
            "an estimate by whitened instruments (reference_iv)",
            f"one by {method.name}",
            "Identify the pool with the default method.",
        )
    if len(problem.flights) < 2:
        raise UsageError(
            "a pool of two flights or more with usable runs",
            f"{len(problem.flights)}",
            "Give several flights to identify_flight; ten or more make good intervals.",
        )
    return problem, estimate


def _whitens_instruments(method: Method) -> bool:
    return (
        isinstance(method, LinearMethod)
        and isinstance(method.assembler, Instrumental)
        and isinstance(method.row_weighting, SpectralWhitening)
    )


@dataclass(frozen=True)
class _DelayMoments:
    """Products of each flight's whitened columns at one delay. F flights, T lags, q instruments.

    Parameters
    ----------
    delay_s : float
        Delay [s].
    own : ndarray, shape (F, q, q)
        Q'Q.
    fixed : ndarray, shape (F, q, 2)
        Q'[V y].
    squares : ndarray, shape (F, 2, 2)
        [V y]'[V y].
    moving : ndarray, shape (F, T, q + 4)
        Q'U, V'U, y'U, U'U, and the sum of U over the samples.
    rows : ndarray, shape (F,)
        Rows.
    sums : ndarray, shape (F, 3)
        Samples, and sums of z'' (from the velocity) and z' over them.
    misfit : ndarray, shape (F, q)
        Q'e of the pool's own estimate, at its best delay.
    """

    delay_s: float
    own: Float[np.ndarray, "F q q"]
    fixed: Float[np.ndarray, "F q 2"]
    squares: Float[np.ndarray, "F 2 2"]
    moving: Float[np.ndarray, "F T m"]
    rows: Float[np.ndarray, " F"]
    sums: Float[np.ndarray, "F 3"]
    misfit: Float[np.ndarray, "F q"]


def _delay_moments(problem: VerticalFlights, candidate: Candidate, best: Candidate) -> _DelayMoments:
    delay = candidate.at[DELAY.name]
    weights = whitened_by_residuals(problem, candidate.theta, candidate.at)
    points = [{**candidate.at, ACTUATOR_LAG.name: lag} for lag in problem.lag.grid.tolist()]
    first = weights.rows(points[0])
    Q = first.instruments
    flights = first.layout.flight_of_row
    edges = np.flatnonzero(np.diff(flights, prepend=-1))

    def added(left: Float[np.ndarray, "rows p"], right: Float[np.ndarray, "rows r"]) -> np.ndarray:
        return np.add.reduceat(left[:, :, None] * right[:, None, :], edges, axis=0)

    both = np.column_stack([first.regressors[:, 0], first.response])
    moving = [_moving(problem, weights.rows(at), Q, at, added) for at in points]
    found = weights.rows(best.at)
    misfit = added(Q, (found.response - found.regressors @ best.theta)[:, None])[:, :, 0]
    sums = []
    for flight in problem.flights:
        columns = flight.cut(
            np.column_stack([np.ones(flight.velocity.size), flight.velocity_derivative, flight.velocity])
        )
        sums.append(np.concatenate(columns).sum(axis=0))
    return _DelayMoments(
        delay,
        added(Q, Q),
        added(Q, both),
        added(both, both),
        np.stack(moving, axis=1),
        np.diff(np.append(edges, flights.size)).astype(np.float64),
        np.array(sums),
        misfit,
    )


def _moving(
    problem: VerticalFlights,
    rows: Regression,
    Q: Float[np.ndarray, "rows q"],
    at: Values,
    added: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Float[np.ndarray, "F m"]:
    U = rows.regressors[:, 1:]
    left = np.column_stack([Q, rows.regressors[:, 0], rows.response, U])
    lag_s, delay_s = at[ACTUATOR_LAG.name], at[DELAY.name]
    mapped = [
        np.concatenate(flight.cut(flight.mapped_input(problem.motion, lag_s, delay_s)[:, None])).sum()
        for flight in problem.flights
    ]
    return np.column_stack([added(left, U)[:, :, 0], mapped])


@dataclass(frozen=True)
class _Solved:
    """The best lag at one delay.

    Parameters
    ----------
    criterion : float
        J.
    theta : ndarray, shape (2,)
        K and K_u.
    lag_s : float
        Lag [s].
    mapped : float
        Sum of U over the samples.
    """

    criterion: float
    theta: Float[np.ndarray, "2"]
    lag_s: float
    mapped: float


def _estimate(
    problem: VerticalFlights, delays: list[_DelayMoments], counts: Float[np.ndarray, " F"]
) -> Float[np.ndarray, "5"]:
    """K, K_u, hover input, lag and effective lag of flights that are counted so many times."""
    solved = [_solved(problem, moments, counts) for moments in delays]
    place = int(np.argmin([one.criterion for one in solved]))
    best, moments = solved[place], delays[place]
    samples, derivative, velocity = counts @ moments.sums
    friction, gain = best.theta
    hover = (best.mapped - (derivative + friction * velocity) / gain) / samples
    values = [friction, gain, problem.motion.input_map.inverse(float(hover)), best.lag_s]
    return np.array([*values, best.lag_s + moments.delay_s])


def _solved(problem: VerticalFlights, moments: _DelayMoments, counts: Float[np.ndarray, " F"]) -> _Solved:
    """Search the lag and solve for K and K_u."""
    half = _half(np.tensordot(counts, moments.own, 1))
    fixed = np.tensordot(counts, moments.fixed, 1)
    fixed[:, 1] -= moments.misfit.sum(axis=0)
    fixed = half @ fixed
    moving = np.tensordot(counts, moments.moving, 1)
    at = _interpolation(problem.lag.grid, moving)
    rank = half.shape[0]

    def objective(products: Float[np.ndarray, "k m"]) -> Float[np.ndarray, " k"]:
        """What instruments leave of y after the best K and K_u."""
        U = products[:, :VU] @ half.T
        V, y = fixed.T
        # take V out of U and of y, then U out of y
        across = U - np.outer(U @ V / (V @ V), V)
        left = y - V * (V @ y / (V @ V))
        power = np.einsum("kq,kq->k", across, across)
        gains = np.divide(across @ left, power, out=np.zeros(len(power)), where=power > 0.0)
        residual = left - gains[:, None] * across
        return np.asarray(np.einsum("kq,kq->k", residual, residual))

    lag = _least(objective, at, problem.lag.grid)
    products = at(np.array([lag]))[0]
    A = np.column_stack([fixed[:, 0], half @ products[:VU]])
    lengths = np.linalg.norm(A, axis=0)
    if rank < 2 or not lengths.all():
        raise CollinearError("instruments that move K and K_u", "none", "Fly more.")
    theta = np.linalg.lstsq(A / lengths, fixed[:, 1], rcond=None)[0] / lengths
    residual = fixed[:, 1] - A @ theta
    (VV, Vy), (_, yy) = np.tensordot(counts, moments.squares, 1)
    K, G = theta
    power = yy - 2.0 * (K * Vy + G * products[YU]) + K * K * VV + 2.0 * K * G * products[VU]
    power += G * G * products[UU]
    unknowns = 3 if problem.lag.searched else 2
    variance = power / (counts @ moments.rows - unknowns)
    return _Solved(float(residual @ residual / variance), theta, lag, float(products[SUM]))


def _half(gram: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "k q"]:
    """H with H'H the inverse of a Gram matrix on its own space: what makes instruments orthonormal."""
    powers, directions = scipy.linalg.eigh(gram)
    kept = powers > SMALLEST_POWER * powers[-1]
    return np.asarray((directions[:, kept] / np.sqrt(powers[kept])).T)


def _interpolation(
    grid: Float[np.ndarray, " T"], products: Float[np.ndarray, "T m"]
) -> Callable[[Float[np.ndarray, " k"]], Float[np.ndarray, "k m"]]:
    """Products at any lags between those of the grid."""
    if grid.size == 1:
        return lambda lags: np.repeat(products, lags.size, axis=0)
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(np.log(grid), products)
    return lambda lags: np.asarray(spline(np.log(lags)))


def _least(
    objective: Callable[[Float[np.ndarray, "k m"]], Float[np.ndarray, " k"]],
    at: Callable[[Float[np.ndarray, " k"]], Float[np.ndarray, "k m"]],
    grid: Float[np.ndarray, " T"],
) -> float:
    """Lag of the least objective: that of the grid, refined between its neighbours."""
    lags = grid
    best = int(np.argmin(objective(at(lags))))
    for _ in range(ZOOMS if grid.size > 1 else 0):
        low, high = float(lags[max(best - 1, 0)]), float(lags[min(best + 1, lags.size - 1)])
        lags = np.geomspace(low, high, POINTS)
        best = int(np.argmin(objective(at(lags))))
    return float(lags[best])
