"""Quantities derived from the estimate: intercepts and the hover input.

Intercept and gain trade off against each other; the input at which the vehicle hovers is what a flight
tells well: U_h = mean U - (mean z'' + K mean z') / K_u, over the runs, with z'' from the velocity, which
has no bias. The hover input is the input map's inverse of U_h. Optional terms vanish at hover, and what they
make of mean z'' is taken off it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.estimation.candidate import Candidate
from eivor.inference.covariances.equal_weighted_cosines import long_run_mean_variance
from eivor.models.separable import Nuisance, Values
from eivor.motions.vertical.flights import VerticalFlight, VerticalFlights
from eivor.motions.vertical.model import GRAVITY, INPUT_GAIN, VISCOUS_FRICTION
from eivor.shapes import Float


@dataclass(frozen=True)
class Balance:
    """Means over the runs of every term of the equation of motion, at one candidate.

    Parameters
    ----------
    derivative, velocity, mapped : float
        Means of z'' (from the velocity) [m/s^2], z' [m/s] and U.
    mapped_slope : float
        Derivative of the mean of U by the lag that was searched for, or by the delay of measured actuators.
    terms : ndarray, shape (terms,)
        Means of the columns of optional terms [m/s^2 per unit of their parameters].
    residual_variance : float
        Autocorrelation-robust variance of the mean residual [m^2/s^4].
    by_run : ndarray, shape (runs, 3 + terms)
        Means of z'', z', U and the columns of terms in each run.
    """

    derivative: float
    velocity: float
    mapped: float
    mapped_slope: float
    terms: Float[np.ndarray, " terms"]
    residual_variance: float
    by_run: Float[np.ndarray, "runs m"]


def balance(problem: VerticalFlights, candidate: Candidate) -> Balance:
    """Terms of the equation of motion, averaged over the runs."""
    columns = _columns(problem, candidate.at)
    stacked = np.concatenate(columns)
    K, K_u = candidate.theta[:2]
    residual = stacked[:, 0] + K * stacked[:, 1] - K_u * stacked[:, 2] - stacked[:, 3:] @ candidate.theta[2:]
    moving = [nuisance for nuisance in problem.nuisances if nuisance.refined]
    mapped_slope = _mapped_slope(problem, candidate, moving[0]) if moving else 0.0
    means = stacked.mean(axis=0)
    return Balance(
        float(means[0]),
        float(means[1]),
        float(means[2]),
        mapped_slope,
        means[3:],
        long_run_mean_variance(residual - residual.mean()),
        np.stack([block.mean(axis=0) for block in columns]),
    )


def _mapped_slope(problem: VerticalFlights, candidate: Candidate, nuisance: Nuisance) -> float:
    """Derivative of the mean of U by a nuisance."""

    def mean(at: Values) -> float:
        return float(np.concatenate(_columns(problem, at))[:, 2].mean())

    return nuisance.derivative(mean, candidate.at)


def _columns(problem: VerticalFlights, at: Values) -> list[Float[np.ndarray, "_ m"]]:
    """z'', z', U and the columns of terms, of every run."""
    return [block for flight in problem.flights for block in _of_flight(problem, flight, at)]


def _of_flight(
    problem: VerticalFlights, flight: VerticalFlight, at: Values
) -> list[Float[np.ndarray, "_ m"]]:
    moving = problem.moving(flight)(at)
    return flight.cut(np.column_stack([flight.velocity_derivative, flight.velocity, moving]))


def balance_sums(problem: VerticalFlights, at: Values) -> dict[str, Float[np.ndarray, " flights"]]:
    """Number of samples of each flight, and sums of z'', z', U and the columns of terms over them."""
    flights = [np.concatenate(_of_flight(problem, flight, at)) for flight in problem.flights]
    sums = np.array([[len(terms), *terms.sum(axis=0)] for terms in flights])
    names = ("samples", "derivative", "velocity", "mapped", *(term.parameter.name for term in problem.terms))
    return dict(zip(names, sums.T, strict=True))


def apparent_gravity(problem: VerticalFlights) -> float:
    """Mean of the specific force less the velocity's derivative; NaN without an accelerometer [m/s^2].

    It is g and the accelerometer's bias, unless the accelerometer is in another unit.
    """
    resting = [
        run
        for flight in problem.flights
        if flight.acceleration is not None
        for run in flight.cut((flight.acceleration - flight.velocity_derivative)[:, None])
    ]
    return GRAVITY + float(np.concatenate(resting).mean()) if resting else float("nan")


def hover_of_sums(parameters: Mapping[str, float], sums: Mapping[str, float]) -> float:
    """U_h from linear parameters by name and the totals of `balance_sums`."""
    friction, gain = parameters[VISCOUS_FRICTION.name], parameters[INPUT_GAIN.name]
    of_terms = sum(parameters[name] * sums[name] for name in parameters if name in sums)
    drift = sums["derivative"] + friction * sums["velocity"] - of_terms
    return (sums["mapped"] - drift / gain) / sums["samples"]


def hover_mapped(candidate: Candidate, terms: Balance) -> tuple[float, Float[np.ndarray, " n"]]:
    """U_h and its gradient by the joint vector."""
    K, K_u = candidate.theta[:2]
    linear = candidate.theta.size
    drift = terms.derivative + K * terms.velocity - float(candidate.theta[2:] @ terms.terms)
    gradient = np.zeros(candidate.values.size)
    gradient[0] = -terms.velocity / K_u
    gradient[1] = drift / K_u**2
    gradient[2:linear] = terms.terms / K_u
    gradient[linear : linear + 1] = terms.mapped_slope
    return float(terms.mapped - drift / K_u), gradient


def intercept(candidate: Candidate, terms: Balance) -> tuple[float, Float[np.ndarray, " n"]]:
    """B = mean z'' + g + K mean z' - K_u mean U less the terms, and its gradient by the joint vector."""
    K, K_u = candidate.theta[:2]
    gradient = np.zeros(candidate.values.size)
    linear = candidate.theta.size
    gradient[0], gradient[1], gradient[2:linear] = terms.velocity, -terms.mapped, -terms.terms
    gradient[linear : linear + 1] = -K_u * terms.mapped_slope
    of_terms = float(candidate.theta[2:] @ terms.terms)
    return float(terms.derivative + GRAVITY + K * terms.velocity - K_u * terms.mapped - of_terms), gradient


def intercepts_by_run(candidate: Candidate, terms: Balance) -> Float[np.ndarray, " runs"]:
    """B of each run."""
    K, K_u = candidate.theta[:2]
    D, V, U = terms.by_run[:, :3].T
    return np.asarray(D + GRAVITY + K * V - K_u * U - terms.by_run[:, 3:] @ candidate.theta[2:])
