"""How a flight was flown, in the few numbers that simulating another one of the vehicle needs.

* What the model leaves, as densities over frequency. The accelerometer and the derivative of the velocity
  are two measurements of one acceleration: what their residuals share is a force on the vehicle (gusts), the
  rest is each sensor's own.
* The gains of a height controller, where the command follows one: wanted acceleration less the reference's
  is c1 (error of velocity) + c2 (error of height) + c3 (its integral), with c1 = k_v, c2 = k_v k_p + k_i and
  c3 = k_i k_p.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights.grid import on_grid
from eivor.flights.prepared import PreparedFlight
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.spectral import BinRows
from eivor.motions.vertical.balance import balance_sums
from eivor.motions.vertical.flights import VerticalFlights
from eivor.motions.vertical.model import GRAVITY, INPUT_GAIN, VISCOUS_FRICTION
from eivor.shapes import Complex, Float

#: Frequencies at which densities are kept [Hz]; around each the bins within that factor are averaged, and so
#: many at least.
NODES_HZ = np.geomspace(0.06, 4.5, 11)
AVERAGED_OVER, LEAST_BINS = 1.6, 8
#: The velocity's own error is white, and known from this frequency on [Hz]: below it its derivative is quiet.
VELOCITY_FROM_HZ = 1.0
#: Half-widths up to which an estimate is taken as it is [1/s, s, share], and what is usual otherwise.
TOLD_FRICTION, TOLD_LAG_S, TOLD_GAIN = 0.25, 0.03, 0.1
USUAL_FRICTION, USUAL_LAG_S = 0.3, 0.05
#: A controller explains at least this share of the command's variance.
LEAST_EXPLAINED = 0.5


@dataclass(frozen=True, slots=True)
class Taken:
    """Numbers that a flight is simulated with: the estimate's where it tells them, else what is usual.

    Parameters
    ----------
    friction, gain, lag_s, delay_s : float
        K [1/s], K_u [m/s^2], lag and delay [s].
    others : mapping of str to float
        Further parameters and nuisances of the problem, by name.
    """

    friction: float
    gain: float
    lag_s: float
    delay_s: float
    others: Mapping[str, float] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, float]:
        """Every parameter and nuisance by name."""
        return {
            **self.others,
            VISCOUS_FRICTION.name: self.friction,
            INPUT_GAIN.name: self.gain,
            ACTUATOR_LAG.name: self.lag_s,
            DELAY.name: self.delay_s,
        }


def flown(
    problem: VerticalFlights, estimate: Estimate, flights: tuple[PreparedFlight, ...]
) -> dict[str, object]:
    """Numbers of flights, ready for JSON: what is taken of the vehicle, its residual, controller and tilt."""
    tilt = np.concatenate(
        [flight.signals.channel("cos_tilt")[run] for flight in flights for run in flight.runs]
    )
    numbers = taken(problem, estimate)
    return {
        "taken": {"viscous_friction": numbers.friction, "lag_s": numbers.lag_s + numbers.delay_s},
        "residual": residual_densities(problem, numbers),
        "controller": controller_gains(problem, numbers, flights),
        "tilt_rms": float(np.sqrt(np.mean(np.arccos(np.clip(tilt, -1.0, 1.0)) ** 2) / 2.0)),
    }


def taken(problem: VerticalFlights, estimate: Estimate) -> Taken:
    """Numbers to simulate with.

    An estimate that tells nothing fits the disturbance away: what it leaves would make every plan look good.
    The gain that carries the weight at the mean input is right as far as the input map is.
    """
    friction, gain = estimate.best.theta[:2].tolist()
    at = estimate.best.at
    lag, delay = at[ACTUATOR_LAG.name], at[DELAY.name]
    if not _half_width(estimate, VISCOUS_FRICTION.name) <= TOLD_FRICTION or not friction > 0.0:
        friction = USUAL_FRICTION
    if ACTUATOR_LAG.name in estimate.names and not _half_width(estimate, ACTUATOR_LAG.name) <= TOLD_LAG_S:
        lag, delay = USUAL_LAG_S, 0.0
    if not _half_width(estimate, INPUT_GAIN.name) <= TOLD_GAIN * abs(gain):
        sums = balance_sums(problem, {**at, ACTUATOR_LAG.name: lag, DELAY.name: delay})
        gain = GRAVITY * float(sums["samples"].sum() / sums["mapped"].sum())
    linear = dict(zip((p.name for p in problem.parameters), estimate.best.theta.tolist(), strict=True))
    return Taken(friction, gain, lag, delay, {**at, **linear})


def _half_width(estimate: Estimate, name: str) -> float:
    low, high = estimate.interval(name)
    return 0.5 * (high - low)


def residual_densities(problem: VerticalFlights, numbers: Taken) -> dict[str, list[float]]:
    """One-sided densities at `NODES_HZ`: of the force on the vehicle, and of each sensor's own error.

    `force` and `accelerometer` are in (m/s^2)^2/Hz, `velocity` in (m/s)^2/Hz. Without an accelerometer all
    that the velocity's derivative leaves is force above the velocity's own noise at the highest node.
    """
    bins = problem.bins({nuisance.name: numbers.values[nuisance.name] for nuisance in problem.nuisances})
    left = bins.residuals(np.array([numbers.values[parameter.name] for parameter in bins.parameters]))
    first, second = left[:, 0], left[:, -1]
    frequency, weight = _scales(bins.layout)
    products = {
        "first": weight * np.abs(first) ** 2,
        "second": weight * np.abs(second) ** 2,
        "shared": weight * (first * second.conj()).real,
    }
    at_nodes = {name: _at_nodes(frequency, values) for name, values in products.items()}
    pulsation = 2.0 * np.pi * NODES_HZ
    if left.shape[1] == 1:
        noise = at_nodes["second"][-1] / pulsation[-1] ** 2
        force = np.maximum(at_nodes["second"] - noise * pulsation**2, 0.05 * at_nodes["second"])
        own = np.zeros(NODES_HZ.size)
    else:
        least = 0.02 * np.minimum(at_nodes["first"], at_nodes["second"])
        force = np.maximum(at_nodes["shared"], least)
        own = np.maximum(at_nodes["first"] - force, 0.0)
        known = NODES_HZ >= VELOCITY_FROM_HZ
        noise = float(np.median((np.maximum(at_nodes["second"] - force, 0.0) / pulsation**2)[known]))
    return {
        "frequency_hz": NODES_HZ.tolist(),
        "force": force.tolist(),
        "accelerometer": own.tolist(),
        "velocity": [float(noise)] * NODES_HZ.size,
    }


def _scales(layout: BinRows) -> tuple[Float[np.ndarray, " bins"], Float[np.ndarray, " bins"]]:
    """Frequency of every bin, and what makes its power a one-sided density."""
    frequency = np.concatenate([run.frequency_hz for run in layout.runs])
    weight = np.concatenate(
        [np.full(run.count, 2.0 * run.step_s / float(np.mean(run.taper**2))) for run in layout.runs]
    )
    return frequency, weight


def _at_nodes(
    frequency: Float[np.ndarray, " bins"], values: Float[np.ndarray, " bins"] | Complex[np.ndarray, " bins"]
) -> Float[np.ndarray, " nodes"]:
    """Means over the bins near each node, and over so many of the nearest at least."""
    found = []
    for node in NODES_HZ:
        away = np.abs(np.log(frequency / node))
        reach = max(np.log(AVERAGED_OVER) / 2.0, np.sort(away)[min(LEAST_BINS, away.size) - 1])
        found.append(values[away <= reach].mean())
    return np.array(found)


def controller_gains(
    problem: VerticalFlights, numbers: Taken, flights: tuple[PreparedFlight, ...]
) -> dict[str, float] | None:
    """Gains of the height controller [1/s, 1/s, 1/s^2]; None where the command does not follow one."""
    rows, wanted = [], []
    for flight, cut in zip(flights, problem.flights, strict=True):
        errors = _tracking_errors(flight)
        if errors is None or flight.input.measured:
            return None
        command = numbers.gain * cut.mapped_input(problem.motion, 0.0, 0.0)
        feed_forward = flight.signals.channels.get("reference_acceleration_z", np.zeros(command.size))
        for run in flight.runs:
            integral = np.cumsum(errors[run, 1]) * flight.signals.step_s
            columns = np.column_stack([errors[run], integral])
            rows.append(columns - columns.mean(axis=0))
            asked = command[run] - GRAVITY - feed_forward[run]
            wanted.append(asked - asked.mean())
    columns, asked = np.concatenate(rows), np.concatenate(wanted)
    if not np.isfinite(columns).all() or not float(asked @ asked) > 0.0:
        return None
    fitted = np.linalg.lstsq(columns, asked)[0]
    left = asked - columns @ fitted
    if float(left @ left) > (1.0 - LEAST_EXPLAINED) * float(asked @ asked):
        return None
    return _gains(*fitted.tolist())


def _tracking_errors(flight: PreparedFlight) -> Float[np.ndarray, "n 2"] | None:
    """Errors of velocity and height on the grid; None unless the height and its reference are logged."""
    channels, signals = flight.recording.channels, flight.signals.channels
    if "position_z" not in channels or "reference_position_z" not in signals:
        return None
    height = on_grid(channels["position_z"], flight.grid)[0]
    wanted = signals.get("reference_velocity_z", np.zeros(height.size))
    return np.column_stack([wanted - signals["velocity_z"], signals["reference_position_z"] - height])


def _gains(velocity: float, height: float, integral: float) -> dict[str, float] | None:
    """k_p, k_v and k_i of the three coefficients, where they are those of a controller that holds."""
    if not 0.3 <= velocity <= 15.0 or height <= 0.0:
        return None
    integral = max(integral, 0.0)
    root = height**2 - 4.0 * velocity * integral
    position = (height + np.sqrt(max(root, 0.0))) / (2.0 * velocity)
    return {
        "position_gain": float(np.clip(position, 0.1, 5.0)),
        "velocity_gain": velocity,
        "integral_gain": float(np.clip(height - velocity * position, 0.0, 10.0)),
    }
