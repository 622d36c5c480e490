"""What references can tell of a pool's lag: a bound on intervals, and the command that works it out.

    python -m validation.real_logs.pool_information [--pools N] [--page docs/studies/real-logs.md]

takes the first N pools of each family of pools (default: all of them) and prints their medians. Flown without
gusts and without noise, a flight shows what its references alone make of command and climb rate. What gusts,
accelerometer and velocity leave of y = K_u U - K_f V + b_f has a known spectrum P, and the information about
K_u, lag, delay, and K_f and b_f of every flight is the sum over frequencies of S* S / P, where S has the
transforms of the columns' noise-free parts (Gauss and Markov). No unbiased estimate from responses to
references has a smaller variance. The estimator of pools does not know P, nor the noise-free parts.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eivor.motions.vertical.model import GRAVITY
from eivor.signals.filters import actuator_state
from validation.pages import markdown
from validation.real_logs.closed_loop import STEP_S, FlightSpec, fly_own
from validation.real_logs.trials import Family, published_grid
from validation.studies import Answer, Option, StudyCommand

PART = "pool information"
#: Half-width of a normal variable's 95 % interval, in standard deviations.
NORMAL_95 = 1.96
#: Beginning of a flight that is left out [s].
SETTLE_S = 2.0
#: Step of the derivative by the lag, over the lag.
LAG_STEP = 0.05
#: Parameters that a pool's flights share: K_u, lag, delay.
SHARED, LAG, DELAY = 3, 1, 2


@dataclass(frozen=True, slots=True)
class LagBound:
    """Half-width of the effective lag's 95 % interval that references allow [s]."""

    delay_known: float  # With the delay known, and to be found too
    delay_free: float


def lag_bound(flights: Sequence[FlightSpec]) -> LagBound:
    size = SHARED + 2 * len(flights)
    information = np.zeros((size, size))
    for index, spec in enumerate(flights):
        selected = [*range(SHARED), SHARED + 2 * index, SHARED + 2 * index + 1]
        information[np.ix_(selected, selected)] += flight_information(spec)
    known = _covariance(np.delete(np.delete(information, DELAY, 0), DELAY, 1))
    free = _covariance(information)
    lag = [LAG, DELAY]
    return LagBound(
        NORMAL_95 * float(np.sqrt(known[LAG, LAG])), NORMAL_95 * float(np.sqrt(free[np.ix_(lag, lag)].sum()))
    )


def flight_information(spec: FlightSpec) -> Float[np.ndarray, "5 5"]:
    """Information of one flight about K_u, lag, delay, K_f and b_f, for the true spectrum of its noise."""
    columns = _columns(spec)[round(SETTLE_S / STEP_S) :]
    transforms = STEP_S * np.fft.fft(columns, axis=0)
    spectrum = _spectrum(spec, 2.0 * np.pi * np.fft.fftfreq(columns.shape[0], STEP_S))
    seconds = STEP_S * columns.shape[0]
    return np.asarray((transforms.conj().T @ (transforms / spectrum[:, None])).real / seconds)


def _columns(spec: FlightSpec) -> Float[np.ndarray, "n 5"]:
    """Derivatives of the modelled specific force by K_u, lag, delay, K_f and b_f, free of noise."""
    still = np.zeros(spec.steps)
    calm = replace(spec, vehicle=replace(spec.vehicle, gust_rms=0.0))
    flight = fly_own(calm, (still, still))
    lag, delay = spec.vehicle.actuator_lag, spec.vehicle.delay
    started = np.vstack([flight.command[:1], flight.command])

    def thrust(lag_s: float, delay_s: float) -> Float[np.ndarray, " n"]:
        states = actuator_state(started, step_s=STEP_S, lag_s=lag_s, delay_s=delay_s)[1:, 0]
        return np.asarray(flight.truth.cos_tilt * states**2)

    gain = GRAVITY / spec.vehicle.hover_input**2
    step, sooner = LAG_STEP * lag, max(delay - STEP_S, 0.0)
    by_lag = (thrust(lag + step, delay) - thrust(lag - step, delay)) / (2.0 * step)
    by_delay = (thrust(lag, delay + STEP_S) - thrust(lag, sooner)) / (delay + STEP_S - sooner)
    return np.stack(
        [thrust(lag, delay), gain * by_lag, gain * by_delay, -flight.velocity, np.ones(spec.steps)], axis=1
    )


def _spectrum(spec: FlightSpec, frequency: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Two-sided density of what the model leaves [m^2/s^3], at angular frequencies [rad/s]."""
    vehicle, logger = spec.vehicle, spec.logger
    correlation = vehicle.gust_correlation
    wind = 2.0 * vehicle.gust_rms**2 * correlation / (1.0 + (frequency * correlation) ** 2)
    force = logger.noise.acceleration**2 / logger.acceleration_hz
    velocity = logger.noise.velocity**2 / logger.velocity_hz
    return np.asarray(vehicle.viscous_friction**2 * (wind + velocity) + force)


def _covariance(information: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale))


def pool_table(families: Sequence[Family], pools: int | None) -> str:
    """Markdown: medians over the first pools of each family, or over all of them [ms]."""
    lines = []
    for family in families:
        count = min(family.count, pools or family.count)
        flight = [[family.flight(family.pool * i + j) for j in range(family.pool)] for i in range(count)]
        bounds = [lag_bound(flights) for flights in flight]
        medians = [
            1e3 * float(np.median([getattr(bound, name) for bound in bounds]))
            for name in ("delay_known", "delay_free")
        ]
        lines.append((family.name, str(count), *(f"{median:.1f} ms" for median in medians)))
    return markdown(("family", "pools", "delay known", "delay to be found"), lines)


def answer(chosen: argparse.Namespace) -> Answer:
    """Table of the first pools of each family of pools."""
    families = [family for family in published_grid().families if family.pool > 1]
    return pool_table(families, chosen.pools), ()


OPTIONS: dict[str, Option] = {"--pools": {"type": int, "metavar": "N", "help": "of each; default: all"}}
main = StudyCommand("validation.real_logs.pool_information", __doc__, PART, answer, OPTIONS).main

if __name__ == "__main__":
    sys.exit(main())
