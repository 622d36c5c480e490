"""Tests for omitted terms and for sensors that disagree."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eivor.errors import EstimationError, InstrumentError, TooFewSamplesError
from eivor.estimation.estimate import Estimate
from eivor.estimation.weighting import SpectralWhitening
from eivor.flights.grid import on_grid
from eivor.flights.lag_prior import EFFECTIVE_LAG, LAG_SUMS
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import Difference, PreparedFlight, SensorAgreement, estimated
from eivor.models.lagged_runs import ACTUATOR_LAG, AxisColumns
from eivor.models.regression import Parameter
from eivor.models.separable import GivenBins
from eivor.models.spectral import SpectralRegression
from eivor.motions.equation import (
    LEAST_DIFFERENCE,
    OFFSET,
    SCALE,
    explained,
    has_two_responses,
    response_difference,
)
from eivor.motions.vertical import regression
from eivor.motions.vertical.regression import MAPPED, RADII, SUPPLY, VOLTAGE_SHARE, VerticalFlights
from eivor.motions.vertical.select import rotated, vertical_row
from eivor.signals.filters import first_order_lag
from eivor.signals.recording import GRAVITY, Channel, Finding
from eivor.tools import Complex, Float, capitalised

# -- Omitted-variable tests --

PREFIX = "left_out_"
#: A term is missed below this p-value; a change with the supply widens intervals below the other.
MISSED, DOUBTFUL = 0.005, 0.05
CURVATURE = "thrust_curvature"
#: Name of the test of thrust that changes in descent, in the air of the rotors.
DESCENT = "thrust_in_descent"
#: Name of the test of clocks that drift apart: a lag that grows through a flight.
CLOCK_DRIFT = "clock_drift"
#: Terms whose coefficients are reported as shares of the gain.
SHARES = (CURVATURE, SUPPLY, CLOCK_DRIFT)
#: Smaller ones matter to nothing; of the supply that is what the thrust of one command changes by.
LEAST_TERM = {SUPPLY: 0.02}
#: No clock runs faster or slower by a larger share; and what an unknown one may be off by.
LARGEST_DRIFT, UNKNOWN_DRIFT = 1e-3, 5e-4
#: Heights below this count as this [m].
LEAST_HEIGHT = 0.05

#: What a term needs, and its column. Here the lift is the mapped input of that mean, and heights are in m.
_TERMS: dict[str, tuple[str, Callable[[Mapping[str, np.ndarray]], Float[np.ndarray, " n"]]]] = {
    regression.DRAG: ("velocity_z", regression.QUADRATIC_DRAG.expression.evaluate),
    regression.GROUND: (RADII, lambda of: np.maximum(of[RADII], LEAST_HEIGHT) ** -2.0),
    CURVATURE: ("mean", lambda of: of["mean"] * (of[MAPPED] / of["mean"] - 1.0) ** 2),
    DESCENT: ("velocity_z", lambda of: np.maximum(-of["velocity_z"], 0.0)),
    SUPPLY: (VOLTAGE_SHARE, lambda of: of[MAPPED] * of[VOLTAGE_SHARE]),
    # K_u U(t - r t) is K_u (U - r t U') nearly
    CLOCK_DRIFT: ("time", lambda of: -of["time"] * np.gradient(of[MAPPED], of["time"])),
}


def omitted_variable_tests(
    problem: VerticalFlights, estimate: Estimate, flights: Sequence[PreparedFlight]
) -> tuple[dict[str, Difference], dict[str, dict[str, float]]]:
    """Coefficient of each term as if it alone were added, and changes of others; none without instruments."""
    if not all(item.instruments.shape[1] for item in problem.columns):
        return {}, {}
    gain = abs(estimate.parameters["input_gain"]) or math.nan
    linear = _linear(problem, estimate)
    without = dict(zip((item.name for item in problem.parameters), estimate.theta.tolist(), strict=True))
    differences: dict[str, Difference] = {}
    changes: dict[str, dict[str, float]] = {}
    for name, (column, instrument) in _term_bins(problem, estimate, flights).items():
        extended = replace(
            linear,
            regressors=np.hstack([column, linear.regressors]),
            instruments=np.hstack([linear.instruments, instrument]),
            parameters=(Parameter(name, ""), *linear.parameters),
        )
        try:
            known = estimated(GivenBins(extended), {})[0].differences
        except (EstimationError, InstrumentError, TooFewSamplesError):
            continue
        shift, size = known[name], gain if name in SHARES else 1.0
        differences[name] = replace(shift, value=shift.value / size, std_error=shift.std_error / size)
        changes[name] = {other: item.value - without.get(other, 0.0) for other, item in known.items()}
        changes[name][EFFECTIVE_LAG] = sum(changes[name].get(lag, 0.0) for lag in LAG_SUMS[EFFECTIVE_LAG])
    return differences, changes


def _term_bins(
    problem: VerticalFlights, estimate: Estimate, flights: Sequence[PreparedFlight]
) -> dict[str, list[Complex[np.ndarray, "bins 1"]]]:
    """Column and instrument of each term that all flights have channels for, in frequency."""
    columns, measured = problem.columns, []
    by_time = any(regression.voltage(flight) is None for flight in flights)  # one coefficient has one meaning
    for item, flight in zip(columns, flights, strict=True):
        mapped, height = item.moving(estimate.nuisances)[:, 0], regression.height_over_ground(flight)[0]
        volts, mean = regression.voltage(flight), float(mapped[flight.used].mean())
        time, (first, last) = flight.grid.time_s, flight.grid.time_s[flight.used][[0, -1]]
        if by_time or volts is None:  # from half before to half after the middle of what is used
            deviation = (time - first) / (last - first) - 0.5
        else:
            deviation = volts / float(volts[flight.used].mean()) - 1.0
        time = time - float(np.mean(flight.span_s))
        known = {"velocity_z": -item.fixed[:, 0], MAPPED: mapped, RADII: height}
        known |= {VOLTAGE_SHARE: deviation, "time": time}
        known["mean"] = np.full(1, mean) if mean else None
        measured.append({name: values for name, values in known.items() if values is not None})
    pairs = zip(measured, columns, strict=True)
    by_references = [row | regression.explained_channels(row, item) for row, item in pairs]
    added = {SUPPLY if term is regression.VOLTAGE_TERM else term.parameter.name for term in problem.terms}
    return {
        name: [problem.spectra([column(row)[:, None] for row in rows]) for rows in (measured, by_references)]
        for name, (channel, column) in _TERMS.items()
        if name not in added and all(channel in row for row in measured)
    }


def _linear(problem: VerticalFlights, estimate: Estimate) -> SpectralRegression:
    """Rows in frequency at the estimate; derivatives by the nuisances searched for are parameters as well."""
    at, bins = estimate.nuisances, problem.bins(estimate.nuisances)
    searched = [nuisance for nuisance in problem.nuisances if nuisance.searched]
    slopes = [
        item.derivative(lambda to: problem.bins(to).regressors @ estimate.theta, at) for item in searched
    ]
    parameters = (*problem.parameters, *(item.parameter for item in searched))
    return replace(bins, regressors=np.column_stack([bins.regressors, *slopes]), parameters=parameters)


@dataclass(frozen=True, slots=True)
class OmittedTerms:
    """Tests of the terms that the model leaves out."""

    differences: Mapping[str, Difference] = field(default_factory=dict)
    #: What the voltage changed by over the time used, in the mean over the flights, as a share: the supply's
    #: coefficient is then the power of the voltage that thrust goes with, and else what thrust changes by
    voltage_change: float | None = None
    #: From the time that the lag rests on to the farther end of the flight, where clocks may agree [s]
    clock_reach_s: float = 0.0
    #: What other parameters change by with a term in the equation
    changes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def change(self, name: str, parameter: str) -> tuple[float, float]:
        """Distances down and up to a parameter's value with a term, where it is missed."""
        change = self.changes.get(name, {}).get(parameter, 0.0) if self.missed(name) else 0.0
        return max(-change, 0.0), max(change, 0.0)

    def missed(self, name: str) -> bool:
        """Whether a term is significant and large enough to matter."""
        size = self.significant(name, MISSED) * abs(self._factor(name))
        return size > 0.0 and size >= LEAST_TERM.get(name, 0.0)

    @property
    def supply_change(self) -> float:
        """Change of the thrust of one command over the flight, as a share; zero unless significant."""
        return self.significant(SUPPLY, DOUBTFUL) * abs(self._factor(SUPPLY))

    def clocks_apart_s(self, several: bool) -> tuple[float, float]:
        """Significant drift between clocks over the flight, and its uncertainty [s]."""
        item = self.differences.get(CLOCK_DRIFT)
        unknown = UNKNOWN_DRIFT if item is None else min(item.half_width, UNKNOWN_DRIFT)
        known = min(self.significant(CLOCK_DRIFT, DOUBTFUL if several else MISSED), LARGEST_DRIFT)
        return known * self.clock_reach_s, unknown * self.clock_reach_s * several

    def significant(self, name: str, p_value: float) -> float:
        """Size of a coefficient that is significant; zero otherwise."""
        difference = self.differences.get(name)
        return 0.0 if difference is None or not difference.p_value < p_value else abs(difference.value)

    @property
    def supply_sentence(self) -> str:
        """The same in words, and what to do."""
        first = "Log battery_voltage" if self.voltage_change is None else "Add the term with --term voltage"
        return f"{self.spoken(SUPPLY)}. {first}, or identify a part of the flight with --window."

    def spoken(self, name: str) -> str:
        """A sentence with a capital letter."""
        return capitalised(self.sentence(name))

    def _factor(self, name: str) -> float:
        return 1.0 if name != SUPPLY or self.voltage_change is None else self.voltage_change

    @property
    def numbers(self) -> dict[str, float]:
        """Coefficients, half-widths and p-values by name."""
        results = {
            f"{PREFIX}{name}{of}": number
            for name, item in self.differences.items()
            for of, number in (("", item.value), ("_half_width", item.half_width), ("_p_value", item.p_value))
        }
        if SUPPLY in self.differences and self.voltage_change is not None:
            results[f"{PREFIX}{SUPPLY}_voltage_change"] = self.voltage_change
        return results

    @property
    def report(self) -> tuple[tuple[str, str], ...]:
        """Terms that are missed, and the tests of the others."""
        message = [self.sentence(name) for name in self.differences if self.missed(name)]
        others = [(name, item.p_value) for name, item in self.differences.items() if not self.missed(name)]
        for words, low, high in (("in doubt", 0.0, DOUBTFUL), ("not missed", DOUBTFUL, 2.0)):
            named = [f"{name.replace('_', ' ')} (p {p:.2g})" for name, p in others if low <= p < high]
            message += [f"{words}: {', '.join(named)}"] if named else []
        return (("left out", "; ".join(message)),) if message else ()

    def sentence(self, name: str) -> str:
        """The omitted term in words, with number and unit."""
        value, half = self.differences[name].value, self.differences[name].half_width
        if name == regression.DRAG:
            drag = f"a drag of {value:.2g} ± {half:.2g} 1/m times the squared speed"
            return f"{drag} is missed: K is that of these speeds"
        if name in (regression.GROUND, DESCENT):
            near = "towards the ground, as if the ground were near"
            descent = f"by {abs(value):.2g} ± {half:.2g} m/s² for each m/s of descent"
            return f"thrust {'grows' if value > 0.0 else 'falls'} {descent if name == DESCENT else near}"
        if name == CURVATURE:
            sign = "more" if value > 0.0 else "less"
            by = f"{value:+.2g} ± {half:.2g} times the squared share of the input beyond its mean"
            return f"thrust bends {sign} than the input map: {by}"
        if name == CLOCK_DRIFT:
            return f"the clocks of command and motion drift apart by {1e6 * value:.0f} ± {1e6 * half:.0f} ppm"
        changed = self.voltage_change
        if changed is not None:
            return (
                f"the thrust of one command went as the battery's voltage to the power {value:.2g} ± "
                f"{half:.2g}: the voltage changed by {changed:.0%}, and the thrust by "
                f"{abs(value * changed):.0%} (± {half * changed:.0%})"
            )
        direction, share = "rose" if value > 0.0 else "fell", f"{abs(value):.1%} (± {half:.1%})"
        return f"the thrust of one command {direction} by {share} with the supply or the time"


#: Frequencies of the runs, and power there that sums to the mean square.
Spectrum = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]
NO_SPECTRUM: Spectrum = np.zeros(0), np.zeros(0)


def coherent_friction(velocity: Spectrum, frequency_hz: float, used_s: float) -> float:
    """Friction error by a unit of force at a frequency, at the worst of all phases [s/m]."""
    frequencies, power = velocity
    total, at_frequency = float(power.sum()), power[np.abs(frequencies - frequency_hz) <= 1.0 / used_s]
    return float(np.sqrt(float(at_frequency.sum())) / total) if total > 0.0 else 0.0


def velocity_spectrum(problem: VerticalFlights) -> Spectrum:
    """Power spectrum of the velocity as instruments predict it."""
    frequencies, powers, count = [], [], 0
    for item in problem.columns:
        if not item.instruments.shape[1]:
            return NO_SPECTRUM
        velocity = explained(item.instruments, item.runs, -item.fixed)[:, 0]
        for run in item.runs:
            values = velocity[run] - velocity[run].mean()
            frequencies.append(np.fft.rfftfreq(values.size, item.step_s))
            powers.append(2.0 * np.abs(np.fft.rfft(values)) ** 2 / values.size)
            count += values.size
    return np.concatenate(frequencies), np.concatenate(powers) / count


#: By cause: changes of joint parameters for a unit of it in the response.
Sensitivities = Mapping[str, Mapping[str, float]]


def change_by(cause: str, name: str, known: Sensitivities) -> float:
    """Change of a parameter for a unit of a cause; zero where it does not act."""
    return known.get(cause, {}).get(ACTUATOR_LAG.name if name == EFFECTIVE_LAG else name, 0.0)


def behind(offset_s: float, name: str, known: Sensitivities) -> tuple[float, float]:
    """Possible errors of a parameter, up and down, by an offset in time between the sensors."""
    by_velocity, by_force = (change_by(f"late {sensor}", name, known) for sensor in SENSORS)
    shifts = (offset_s * by_force, -offset_s * by_velocity)
    return max(*shifts, 0.0), max(*(-shift for shift in shifts), 0.0)


def sensitivities(
    problem: VerticalFlights, estimate: Estimate, flights: Sequence[PreparedFlight]
) -> Sensitivities:
    """Two-stage least squares of each cause's column on those of the flights, with their weights."""
    # of an offset the rate of change of the acceleration, of a tilt the horizontal acceleration
    columns = problem.columns
    if not all(item.instruments.shape[1] for item in columns):
        return {}
    sideways = [_sideways(flight) for flight in flights]
    tilts = [name for name in sideways[0] if all(name in other for other in sideways)]
    causes = [OFFSET.name, *(TILTS[name].name for name in tilts)]
    cause_columns = []
    for item, moving in zip(columns, sideways, strict=True):
        series = (item.responses.mean(axis=1), *(moving[name] for name in tilts))
        cause_columns.append(np.gradient(np.array(series), item.step_s, axis=1).T)
    linear = _linear(problem, estimate)
    regressors = np.hstack([linear.regressors, problem.spectra(cause_columns)])
    count = regressors.shape[1]
    theta = np.pad(estimate.theta, (0, count - estimate.theta.size))
    names = (*linear.parameters, *(Parameter(cause, "") for cause in causes))
    extended = replace(linear, regressors=regressors, parameters=names)
    whitened = SpectralWhitening().last_pass(GivenBins(extended), theta, {})
    rows = whitened.rows({})
    products = rows.instruments.T @ rows.regressors
    known_columns = count - len(causes)
    effects = [products[:, known_columns:]]
    for sensor in SENSORS if extended.responses.shape[1] == len(SENSORS) else ():
        delayed = problem.spectra([_lateness(item, sensor, estimate.theta[0]) for item in columns])
        response = replace(extended, responses=delayed).whitened_rows(whitened.blend, whitened.power)[:, 0]
        effects.append((rows.instruments.T @ response)[:, None])
        causes.append(f"late {sensor}")
    prior_rows = np.sqrt(estimate.equation.variance) * estimate.prior_rows()
    design = np.vstack([products[:, :known_columns], prior_rows])
    effects_and_priors = np.vstack([np.hstack(effects), np.zeros((len(prior_rows), len(causes)))])
    shifts = zip(causes, np.linalg.lstsq(design, effects_and_priors, rcond=None)[0].T.tolist(), strict=True)
    return {cause: dict(zip(estimate.names, row, strict=True)) for cause, row in shifts}


def _lateness(item: AxisColumns, sensor: str, friction: float) -> Float[np.ndarray, "n 2"]:
    """Change of both responses by a second of delay of one sensor."""
    acceleration = item.responses.mean(axis=1)
    change = -np.gradient(acceleration, item.step_s)
    if sensor == "accelerometer":
        return np.column_stack([change, np.zeros(change.size)])
    # the column of the friction is late, too
    return np.column_stack([-friction * acceleration, change - friction * acceleration])


def omitted_terms(
    problem: VerticalFlights, estimate: Estimate, flights: Sequence[PreparedFlight]
) -> OmittedTerms:
    """Tests of the terms, and the change of the voltage where all flights have one."""
    used = [volts[flight.used] for flight in flights if (volts := regression.voltage(flight)) is not None]
    changes = [float(np.sqrt(12.0) * item.std() / item.mean()) for item in used]
    known = float(np.mean(changes)) if 0 < len(changes) == len(flights) else None
    reach_s = max(_clock_reach_s(*pair, estimate) for pair in zip(problem.columns, flights, strict=True))
    differences, moved = omitted_variable_tests(problem, estimate, flights)
    return OmittedTerms(differences, known, reach_s, moved)


def _clock_reach_s(item: AxisColumns, flight: PreparedFlight, estimate: Estimate) -> float:
    """Distance from the mean time, weighted by the input's power, to the farther end [s]."""
    lift = item.moving(estimate.nuisances)[:, :1]
    weighting = explained(item.instruments, item.runs, lift) if item.instruments.shape[1] else lift
    time, used, (start, end) = flight.grid.time_s, flight.used, flight.span_s
    power = np.gradient(weighting[:, 0], time)[used] ** 2
    mean_time = float(np.average(time[used], weights=power)) if power.any() else 0.5 * (start + end)
    return max(mean_time - start, end - mean_time)


# -- Sensors --

TILTS = {name: Parameter(f"tilt_{name}", "rad") for name in ("forward", "left", "x", "y")}
#: Differences that are too small to matter.
LEAST_SENSOR_DIFFERENCE = LEAST_DIFFERENCE | {tilt.name: float(np.deg2rad(0.3)) for tilt in TILTS.values()}
#: One sensor that reads so many times what the other does is in another unit.
OTHER_UNIT_TIMES = 3.0
SENSORS = ("velocity", "accelerometer")
#: No sensor is mounted so far off [degrees].
LARGEST_TILT_DEG = 20.0
#: Body axes whose tilt is taken out of an attitude; and the largest share of it by which the mean thrust may
#: stand off the accelerometer's axis: all of it where the accelerometer leans, none where the attitude does.
BODY_AXES, LEANING_SHARE = ("forward", "left"), 0.5
#: The vehicle moved sideways when its horizontal speed varied by so much [m/s].
SIDEWAYS_SPEED = 0.3
#: Lags of the horizontal velocities that serve as instruments, one behind the other [s].
SIDEWAYS_LAGS_S = (0.2, 0.2, 0.4)


def difference_problem(problem: VerticalFlights, flights: Sequence[PreparedFlight]) -> GivenBins | None:
    """Regression of D - A on the column of each kind of disagreement; None without both."""
    if not has_two_responses(problem):
        return None
    sideways = [_sideways(flight) for flight in flights]
    names = tuple(sideways[0]) if all(speeds.keys() == sideways[0].keys() for speeds in sideways) else ()
    pairs = [(item, [of[name] for name in names]) for item, of in zip(problem.columns, sideways, strict=True)]
    slopes = ([-np.gradient(v, item.step_s) for v in speeds] for item, speeds in pairs)
    leaning = [
        np.array(of).reshape(-1, len(item.fixed)).T for (item, _), of in zip(pairs, slopes, strict=True)
    ]
    tilts = tuple(TILTS[name] for name in names)
    return response_difference(problem, leaning, [_lags(*pair) for pair in pairs], tilts)


def turned(flights: Sequence[PreparedFlight]) -> tuple[str, str]:
    """The sensor with the opposite sign, if any, and a sentence about it."""
    pairs = {"height": ("position_z", "velocity_z"), "accelerometer": ("velocity_z", "specific_force_z")}
    opposite = [name for name, pair in pairs.items() if any(_opposite(flight, *pair) for flight in flights)]
    if opposite == ["height"] and any("specific_force_z" in item.signals.channels for item in flights):
        return "height", "The height goes down where velocity and accelerometer go up: check its sign."
    words = f"{' and '.join(opposite)} go{'' if opposite[1:] else 'es'}"
    return ("velocity", f"The velocity goes down where {words} up.") if opposite else ("", "")


def _opposite(flight: PreparedFlight, level: str, rate: str) -> bool:
    """Whether changes of a level over half a second go against the sums of its rate."""
    levels, rates = (
        flight.signals.channels.get(key, regression.channel_on_grid(flight, key)) for key in (level, rate)
    )
    steps = max(round(0.5 / flight.signals.step_s), 1)
    valid = flight.used[steps:] & flight.used[:-steps]
    if levels is None or rates is None or not valid.any():
        return False
    series = levels, np.cumsum(np.nan_to_num(rates))
    changes = np.array([(item[steps:] - item[:-steps])[valid] for item in series])
    return bool(np.corrcoef(changes)[0, 1] < -0.5)


def sideways_speed(flights: Sequence[PreparedFlight]) -> float:
    """Root mean square of the horizontal speed, of the fastest flight; NaN where none is logged [m/s]."""
    speeds = [float("nan")]
    for flight in flights:
        channels = [flight.recording.channels.get(f"velocity_{axis}") for axis in "xy"]
        parts = [on_grid(channel, flight.grid)[0][flight.used] for channel in channels if channel is not None]
        if len(parts) == 2:
            speeds.append(float(np.sqrt(np.mean(np.square(parts).sum(axis=0)))))
    return float(np.fmax.reduce(speeds))


def _lags(of: AxisColumns, velocities: list[Float[np.ndarray, " n"]]) -> Float[np.ndarray, "n p"]:
    results = []
    for velocity in velocities:
        results.append(velocity)
        for lag_s in SIDEWAYS_LAGS_S:
            results.append(first_order_lag(results[-1], step_s=of.step_s, lag_s=lag_s))
    return np.array(results).reshape(-1, len(of.fixed)).T


def _sideways(flight: PreparedFlight) -> dict[str, Float[np.ndarray, " n"]]:
    """Horizontal velocities along the vehicle's axes, or the world's, in which it moved."""
    log, used = flight.recording, flight.used
    if not {"velocity_x", "velocity_y"} <= log.channels.keys():
        return {}
    channels = (log.channels[f"velocity_{axis}"] for axis in "xy")
    (east, known_x), (north, known_y) = (on_grid(channel, flight.grid) for channel in channels)
    if not (known_x & known_y)[used].all():
        return {}
    results, heading = {"x": east, "y": north}, _heading(flight)
    if heading is not None:
        cosine, sine = heading
        results = {"forward": cosine * east + sine * north, "left": cosine * north - sine * east}
    return {name: v - v[used].mean() for name, v in results.items() if v[used].std() > SIDEWAYS_SPEED}


def _heading(flight: PreparedFlight) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] | None:
    """Cosine and sine of the yaw on the flight's grid; None without an attitude."""
    parts = [flight.recording.channels.get(f"attitude_{axis}") for axis in "wxyz"]
    known = [channel for channel in parts if channel is not None and channel.time_s.size]
    if len(known) != 4 or any(not np.array_equal(item.time_s, known[0].time_s) for item in known):
        return None
    w, x, y, z = (channel.values for channel in known)
    prediction = w**2 + x**2 - y**2 - z**2, 2.0 * (w * z + x * y)
    cosine, sine = (on_grid(replace(known[0], values=part), flight.grid)[0] for part in prediction)
    length = np.hypot(cosine, sine)
    if not length[flight.used].all():
        return None
    length = np.where(length > 0.0, length, 1.0)
    return cosine / length, sine / length


def sentence(name: str, difference: Difference) -> str:
    """A difference in words, with number and unit."""
    value, half = difference.value, difference.half_width
    if name == OFFSET.name:
        early, late = SENSORS if value > 0.0 else SENSORS[::-1]
        return f"The {late} is {1e3 * abs(value):.1f} ± {1e3 * half:.1f} ms behind the {early}."
    if name == SCALE.name:
        return _scale_sentence(difference)
    along = {
        "tilt_forward": ("forward", "backward"),
        "tilt_left": ("to the left", "to the right"),
        "tilt_x": ("along x", "against x"),
        "tilt_y": ("along y", "against y"),
    }[name][int(value < 0.0)]
    degrees, width = np.rad2deg([abs(value), half])
    if degrees > LARGEST_TILT_DEG:
        return (
            f"Attitude and accelerometer do not go together: it would take a tilt of {degrees:.0f} ± "
            f"{width:.0f} degrees {along}. Check their axes and signs."
        )
    return f"Attitude and accelerometer differ by {degrees:.1f} ± {width:.1f} degrees {along}."


def _scale_sentence(scale: Difference) -> str:
    value, times = scale.value, velocity_over_accelerometer(scale.value)
    if may_stand_still(scale):
        still, moving = SENSORS if value < 0.0 else SENSORS[::-1]
        return f"The {still} does not follow the {moving}."
    if not 1.0 / OTHER_UNIT_TIMES < times < OTHER_UNIT_TIMES:
        return f"The velocity reads {times:.3g} times what the accelerometer does."
    width, more = scale.half_width / (1.0 - value / 2.0) ** 2, "more" if value > 0.0 else "less"
    return f"The velocity reads {abs(times - 1.0):.1%} (± {width:.1%}) {more} than the accelerometer."


def may_stand_still(scale: Difference) -> bool:
    """Whether one sensor may stand still, so that their ratio has no known sign."""
    return abs(abs(scale.value) - 2.0) <= scale.half_width


def velocity_over_accelerometer(scale: float) -> float:
    """Ratio of velocity to accelerometer, from their difference over the mean of both."""
    return (1.0 + scale / 2.0) / (1.0 - scale / 2.0) if scale != 2.0 else np.inf


def either_sentence(agreement: SensorAgreement) -> str:
    """Differences that the flight cannot tell apart, in words."""
    text = " Or: ".join(sentence(name, item) for name, item in agreement.either.items())
    return f"{text} This flight does not identify which." if len(agreement.either) > 1 else text


def sensor_agreement_sentence(agreement: SensorAgreement) -> str:
    """Agreement of both sensors, in a line."""
    message = [sentence(name, item) for name, item in agreement.significant.items()]
    if agreement.either:
        message.append(either_sentence(agreement))
    if agreement.otherwise:
        message.append("Velocity and accelerometer disagree in another way than by offset, scale or tilt.")
    if message:
        return " ".join(message)
    units = {OFFSET.name: ("offset", 1e3, " ms"), SCALE.name: ("scale", 100, " %")}
    numbers = []
    for name, item in agreement.differences.items():
        words, times, unit = units.get(name, ("tilt", float(np.rad2deg(1.0)), " degrees"))
        numbers.append(f"{words} {times * item.value:+.1f} ± {times * item.half_width:.1f}{unit}")
    return f"velocity and accelerometer agree: {', '.join(numbers)}"


def corrected(
    flights: tuple[PreparedFlight, ...], agreement: SensorAgreement, options: FlightOptions
) -> tuple[PreparedFlight, ...]:
    """Flights with tilts taken out of the attitude, and to align, offset and scale out of a sensor."""
    known = agreement.significant
    tilts = {name: known[tilt.name] for name, tilt in TILTS.items() if tilt.name in known}
    levelled = tuple(_levelled(flight, tilts) for flight in flights)
    offset_s, scale = (known[name].value if name in known else 0.0 for name in (OFFSET.name, SCALE.name))
    if not (options.align and (offset_s or scale)):
        return levelled
    return tuple(_aligned(flight, offset_s, scale) for flight in levelled)


def _levelled(flight: PreparedFlight, tilts: Mapping[str, Difference]) -> PreparedFlight:
    """A flight with its attitude corrected, unless the mean thrust shows that the accelerometer leans."""
    channels, known = dict(flight.signals.channels), flight.recording.channels
    names = [f"specific_force_body_{axis}" for axis in "xyz"] if flight.runs else []
    forces = [force for name in names if (force := regression.channel_on_grid(flight, name)) is not None]
    if not (tilts and tilts.keys() <= set(BODY_AXES) and len(forces) == 3):
        return flight
    means = [float(force[flight.used].mean()) for force in forces]
    forward, left = (tilts[name].value if name in tilts else 0.0 for name in BODY_AXES)
    leaning = -(means[0] * forward + means[1] * left) / means[2] / (forward**2 + left**2)
    if math.hypot(forward, left) > np.deg2rad(LARGEST_TILT_DEG) or not leaning < LEANING_SHARE:
        return flight
    time_s, row = vertical_row([known[f"attitude_{axis}"] for axis in "wxyz"])
    turned = np.cross([left, -forward, 0.0], row)
    by_force = rotated([known[name] for name in names], (time_s, turned))
    for change in (by_force, Channel("cos_tilt", time_s, turned[:, 2], "")):
        if change is not None:
            channels[change.name] = channels[change.name] + on_grid(change, flight.grid)[0]
    texts = (sentence(TILTS[name].name, tilt).rstrip(".") for name, tilt in tilts.items())
    notes = [Finding("attitude_corrected", f"{text}: the attitude is corrected by it.") for text in texts]
    return replace(
        flight,
        signals=replace(flight.signals, channels=channels),
        corrected=(*flight.corrected, *(TILTS[name].name for name in tilts)),
        findings=(*flight.findings, *notes),
    )


def _aligned(flight: PreparedFlight, offset_s: float, scale: float) -> PreparedFlight:
    channels, time = dict(flight.signals.channels), flight.grid.time_s
    later = "specific_force_z" if offset_s > 0.0 else "velocity_z"
    channels[later] = np.interp(time + abs(offset_s), time, channels[later])
    force, velocity = channels["specific_force_z"], channels["velocity_z"]
    if flight.runs and scale:
        offset = force - np.gradient(velocity, flight.signals.step_s)
        gravity = float(offset[flight.used].mean())
        # a mean that is off by more than half of the scale is that of a wrong accelerometer
        if abs(gravity * (1.0 + scale) - GRAVITY) < abs(gravity - GRAVITY):
            channels["specific_force_z"] = (1.0 + scale) * force
        else:
            channels["velocity_z"] = velocity / (1.0 + scale)
    removed = (*flight.corrected, OFFSET.name, SCALE.name)
    return replace(flight, signals=replace(flight.signals, channels=channels), corrected=removed)
