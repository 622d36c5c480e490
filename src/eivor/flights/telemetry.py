"""The actuators' lag by their own telemetry: what a log that holds commands and measured states says of it.

tau w' + w = c(t - d), and telemetry that follows w: this needs neither an instrument nor a motion of the
vehicle. Telemetry is in a unit of its own, and may be of another power of the state than the command is
(rotor speeds beside a command of thrust): it is taken as a parabola of w, whose three numbers the log tells.
Means over the actuators are compared, which are what a motion sees, however the actuators are numbered.

Telemetry is late by itself, by how much no log says. The lag that it tells is that of the actuators and this
delay together, which therefore goes into the standard error.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from eivor.errors import EstimationError
from eivor.estimation.fit import identify
from eivor.estimation.methods import least_squares
from eivor.flights.estimated import EFFECTIVE_LAG, lag_quantities
from eivor.flights.prepared import PreparedFlight
from eivor.flights.told_lag import ToldLag
from eivor.models.equation import Parameter
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, LAG_GRID_S, AxisColumns, LaggedRuns, lag_and_delay
from eivor.models.separable import Values
from eivor.shapes import Float
from eivor.signals.actuator import actuator_state
from eivor.signals.recording import Channel

#: Its name as a source of a lag.
TELEMETRY = "telemetry"
#: Slower telemetry tells no lag [Hz]: that of 20 Hz does.
TELEMETRY_RATE_HZ = 19.5
#: Standard deviation of telemetry's own delay [s]; that of a time within its period is added.
OWN_DELAY_S = 0.015
#: Telemetry follows the commands when less than this share of its variance is left.
LARGEST_SHARE_LEFT = 0.5

SLOPE, CURVATURE = Parameter("telemetry_slope", ""), Parameter("telemetry_curvature", "")


@dataclass(frozen=True)
class LaggedParabola:
    """Mean state of the actuators, and its square, at the stamps of telemetry.

    Parameters
    ----------
    flight : PreparedFlight
        Whose commands.
    time_s : ndarray, shape (n,)
        The stamps [s].
    """

    flight: PreparedFlight
    time_s: Float[np.ndarray, " n"]

    def __call__(self, at: Values) -> Float[np.ndarray, "n 2"]:
        """Columns at a lag and a delay, about the mean command."""
        signals = self.flight.signals
        commands = signals.family(self.flight.input.name)
        lag_s, delay_s = at[ACTUATOR_LAG.name], at[DELAY.name]
        state = actuator_state(commands, step_s=signals.step_s, lag_s=lag_s, delay_s=delay_s).mean(axis=1)
        away = np.interp(self.time_s, self.flight.grid.time_s, state) - commands.mean()
        return np.column_stack([away, away**2])


def telemetry_lag(flights: tuple[PreparedFlight, ...], families: tuple[str, ...]) -> ToldLag | None:
    """Lag of the actuators by the telemetry of flights that have it.

    Parameters
    ----------
    flights : tuple of PreparedFlight
        All with runs.
    families : tuple of str
        Channels of measured states, the first that a log has.

    Returns
    -------
    ToldLag or None
        None where no flight has telemetry of 20 Hz or more beside its commands, and where it does not
        follow them.
    """
    found = {
        number: channels
        for number, flight in enumerate(flights)
        if not flight.input.measured and (channels := _telemetry(flight, families))
    }
    columns = tuple(_columns(number, flights[number], channels) for number, channels in found.items())
    if not any(one.runs for one in columns):
        return None
    problem = LaggedRuns(columns, (SLOPE, CURVATURE), lag_and_delay())
    try:
        estimate = identify(problem, least_squares())
        told = lag_quantities(problem, estimate)[EFFECTIVE_LAG]
    except EstimationError:
        return None
    response = estimate.best.rows.response
    left = float(estimate.residuals @ estimate.residuals) / float(response @ response)
    at_the_end = estimate.best.at[ACTUATOR_LAG.name] >= 0.999 * LAG_GRID_S[-1]
    if not left < LARGEST_SHARE_LEFT or at_the_end or not np.isfinite(told.half_width):
        return None
    slowest = min(channel.rate_hz for channels in found.values() for channel in channels)
    own_delay_s = hypot(OWN_DELAY_S, 1.0 / slowest / sqrt(12.0))
    return ToldLag(TELEMETRY, "telemetry of the actuators", told, own_delay_s, "a delay of its own")


def _telemetry(flight: PreparedFlight, families: tuple[str, ...]) -> list[Channel]:
    """Channels of the first family that the log has, when they are fast enough."""
    for family in families:
        channels = flight.recording.family(family)
        if channels:
            return channels if min(one.rate_hz for one in channels) >= TELEMETRY_RATE_HZ else []
    return []


def _columns(number: int, flight: PreparedFlight, channels: list[Channel]) -> AxisColumns:
    """Mean of the telemetry at the first channel's stamps, and the runs of the flight among these."""
    known = [
        (one.time_s[good], one.values[good]) for one in channels if (good := np.isfinite(one.values)).any()
    ]
    time_s = known[0][0] if known else np.empty(0)
    mean = np.mean([np.interp(time_s, *one) for one in known], axis=0) if known else time_s
    flight = flight.shortened
    grid_s = flight.grid.time_s
    ends = [np.searchsorted(time_s, grid_s[[run.start, run.stop - 1]]).tolist() for run in flight.runs]
    return AxisColumns(
        step_s=1.0 / channels[0].rate_hz,
        runs=tuple(slice(first, last) for first, last in ends if last - first > 2),
        responses=mean[:, None],
        fixed=np.empty((time_s.size, 0)),
        moving=LaggedParabola(flight, time_s),
        instruments=np.empty((time_s.size, 0)),
        flight=number,
    )
