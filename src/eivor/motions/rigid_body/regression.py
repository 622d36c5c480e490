"""Regression problem of the rigid body: terms of its equations, columns, instruments and velocities."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from typing import cast

import numpy as np

from eivor.flights.motion import motion_tables
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import QuantityTable
from eivor.models import lagged_runs, separable
from eivor.models.regression import Parameter
from eivor.models.signal_regression import cross_fitted
from eivor.motions.equation import AxisEquation, DrivenColumns, States, Term, evaluated, parsed
from eivor.motions.rates.motion import AXES, PITCH, ROLL
from eivor.motions.rigid_body.dynamics import ATTITUDE, VELOCITY, Rows, felt, into_body, rotation
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.signals.channels import family_members
from eivor.signals.filters import Series, integrated, low_passed, shifted_by, time_derivative
from eivor.signals.recording import GRAVITY
from eivor.signals.signals import Signals
from eivor.signals.thrust_map import input_map
from eivor.tools import Float

# -- Terms --

TURNING = ("roll", "pitch", "yaw")
ALONG = ("x", "y", "z")
#: Numbers of the equations: turning first, then the specific force along each axis.
ROLL_EQUATION, PITCH_EQUATION, YAW_EQUATION, FORCE_X_EQUATION = range(4)
FORCE_Z_EQUATION = 5
#: Axes along which a velocity turns the vehicle about each axis.
ALONG_OTHERS = ((1, 2), (0, 2), (0, 1))

TABLES = motion_tables("eivor.motions.rigid_body")
QUANTITIES = QuantityTable(TABLES.quantities)


def _parameters(name: str, *of: str) -> tuple[Parameter, ...]:
    """Parameters whose names hold those of axes, with the units of their quantities."""
    return tuple(Parameter(item, QUANTITIES[item].unit) for item in map(name.format, of))


COUPLING, DAMPING = _parameters("{}_coupling", *TURNING), _parameters("{}_damping", *TURNING)
DRAG = _parameters("drag_{}", *ALONG)
#: Of the body, which goes with the size of the velocity, beside what the rotors drag.
QUADRATIC_DRAG = _parameters("quadratic_drag_{}", *ALONG)
#: The first is that of the linear and the quadratic drag along z together, at the speeds of a flight.
FRICTION, LIFT, REACTION, THRUST = _parameters(
    "{}", "viscous_friction", "translational_lift", "rotor_reaction", "thrust_gain"
)
#: What the lift of rotors that meet unequal air turns: k_h / I, which is h alpha_p / (N alpha_z) of N rotors.
LIFT_MOMENT = _parameters("{}_by_lift", *TURNING[:2])
#: What drag beside the centre of mass turns: of each axis, by the velocities along the other two.
DRAG_MOMENT = tuple(
    _parameters(f"{name}_by_drag_{{}}", *(ALONG[along] for along in others))
    for name, others in zip(TURNING, ALONG_OTHERS, strict=True)
)
ALL_DRAG_MOMENTS = tuple(item for pair in DRAG_MOMENT for item in pair)
#: What goes with the states of the rotors: these are for rotors at hover.
AT_HOVER = (*DAMPING, *DRAG, *ALL_DRAG_MOMENTS)
#: Of rotors that spin: J / Ixx and J / Iyy.
GYROSCOPIC_MOMENT = _parameters("{}_by_spin", *TURNING[:2])
GAIN, OFFSET = _parameters("{}_gain", *TURNING), _parameters("{}_offset", *TURNING[:2])
#: Elements of the inertia matrix off its diagonal, over Ixx; minus the products of inertia.
PRODUCT = _parameters("product_{}", "xy", "xz", "yz")
#: Rows and columns of these elements.
PAIRS = ((0, 1), (0, 2), (1, 2))


#: What terms are over: rates of the body, their derivatives, and its velocity through the air, on its axes.
RATES, TURNED, MOVED, SPEED = ("p", "q", "r"), ("dp", "dq", "dr"), ("u", "v", "w"), "speed"
#: Sums of thrusts, as they lift and as they turn about each axis, and the derivative of the spin.
THRUSTS, SPIN_UP = ("thrust", "thrust_roll", "thrust_pitch", "thrust_yaw"), "spin_up"
#: Sums of rotors' states over that at hover, by powers of their places; and of states with their spins.
STATES = ("n", "n_x", "n_y", "n_xx", "n_xy", "n_yy", "spin")
#: Izz over Ixx and Iyy, where flights identify that rotors have one inertia.
RATIOS = ("izz_over_ixx", "izz_over_iyy")
#: Sums over the rotors of states, in those at hover, times the velocity at each along an axis.
DRAGGED = ("(u * n - r * n_y)", "(v * n + r * n_x)", "(w * n + p * n_y - q * n_x)")
#: Sums of arms about x and y times the squared velocity across each rotor.
LIFTED = (
    "y * (u * u + v * v) + 2 * r * (v * xy - u * yy) + r * r * (xxy + yyy)",
    "-(x * (u * u + v * v) + 2 * r * (v * xx - u * xy) + r * r * (xxx + xyy))",
)
#: What elements of the inertia matrix off its diagonal leave of the turning about each axis.
BY_PRODUCT = (
    ("p * r - dq", "-p * q - dr", "r * r - q * q"),
    ("-q * r - dp", "p * p - r * r", "p * q - dr"),
    ("q * q - p * p", "q * r - dp", "-p * r - dq"),
)


def _equation(
    name: str, steady: Mapping[Parameter, str], behind: Mapping[Parameter, str], *instruments: str
) -> AxisEquation:
    """Equation of turning about an axis, of means over steps, or of the specific force along one."""
    terms = tuple(
        Term(item.name, text, QUANTITIES[item.name].symbol, item.unit, behind=lagged)
        for lagged, parameters in ((False, steady), (True, behind))
        for item, text in parameters.items()
    )
    words, unit = f"specific force along {name}", "m/s²"
    response: tuple[str, ...] = (f"specific_force_body_{name}", f"felt_{name}")
    if name in TURNING:
        words, unit, response = f"{name} acceleration", "rad/s²", (f"change_{name}",)
    trace = words, unit, "model", "rotors"
    return AxisEquation(name, (), response, terms, trace, instruments_of=instruments, linear=False)


EQUATIONS = (
    _equation(
        "roll",
        {COUPLING[0]: "q * r", LIFT_MOMENT[0]: LIFTED[0]},
        {
            GAIN[0]: "thrust_roll",
            DAMPING[0]: "-(w * n_y + p * n_yy - q * n_xy) / yy",
            OFFSET[0]: "thrust",
            GYROSCOPIC_MOMENT[0]: "q * spin",
            DRAG_MOMENT[0][0]: f"{DRAGGED[1]} / rotors",
            DRAG_MOMENT[0][1]: f"{DRAGGED[2]} / rotors",
        },
        *("q * r", LIFTED[0], "q * spin", *BY_PRODUCT[0], "v", "w"),
    ),
    _equation(
        "pitch",
        {COUPLING[1]: "r * p", LIFT_MOMENT[1]: LIFTED[1]},
        {
            GAIN[1]: "thrust_pitch",
            DAMPING[1]: "-(q * n_xx - p * n_xy - w * n_x) / xx",
            OFFSET[1]: "thrust",
            GYROSCOPIC_MOMENT[1]: "-p * spin",
            DRAG_MOMENT[1][0]: f"{DRAGGED[0]} / rotors",
            DRAG_MOMENT[1][1]: f"{DRAGGED[2]} / rotors",
        },
        *("r * p", LIFTED[1], "-p * spin", *BY_PRODUCT[1], "u", "w"),
    ),
    _equation(
        "yaw",
        {COUPLING[2]: "p * q"},
        {
            GAIN[2]: "thrust_yaw",
            DAMPING[2]: "-(v * n_x - u * n_y + r * (n_xx + n_yy)) / (xx + yy)",
            REACTION: "spin_up",
            DRAG_MOMENT[2][0]: f"{DRAGGED[0]} / rotors",
            DRAG_MOMENT[2][1]: f"{DRAGGED[1]} / rotors",
        },
        *("p * q", *BY_PRODUCT[2], "u", "v"),
    ),
    _equation("x", {QUADRATIC_DRAG[0]: "-speed * u"}, {DRAG[0]: f"-{DRAGGED[0]} / rotors"}, "speed * u"),
    _equation("y", {QUADRATIC_DRAG[1]: "-speed * v"}, {DRAG[1]: f"-{DRAGGED[1]} / rotors"}, "speed * v"),
    _equation(
        "z",
        {
            QUADRATIC_DRAG[2]: "-speed * w",
            LIFT: "u * u + v * v + (2 * r * (v * x - u * y) + r * r * (xx + yy)) / rotors",
        },
        {THRUST: "thrust", DRAG[2]: f"-{DRAGGED[2]} / rotors"},
        *("u * u + v * v", "speed * w"),
    ),
)
#: Terms with the numbers of their equations.
TERMS = tuple((number, term) for number, equation in enumerate(EQUATIONS) for term in equation.terms)
#: Where the velocity on the body's axes is known, and nowhere else.
BY_VELOCITY = {item.name for item in (*QUADRATIC_DRAG, *LIFT_MOMENT, *ALL_DRAG_MOMENTS, LIFT)}


def drives(text: str) -> bool:
    """Whether an expression is over thrusts and spin only."""
    return {*parsed(text).columns} <= {*THRUSTS, SPIN_UP}


# -- Velocity --

NEEDED = (*VELOCITY, *ATTITUDE)


def body_velocity(signals: Signals) -> Float[np.ndarray, "n 3"] | None:
    """Velocity forward, left and up of the body [m/s]; None where velocity or attitude are not known."""
    known = set(NEEDED) <= set(signals.channels)
    return on_body_axes(signals, *map(signals.channel, VELOCITY)) if known else None


def on_body_axes(signals: Signals, u: Series, v: Series, s: Series) -> Float[np.ndarray, "n 3"]:
    """A vector of the world on the body's axes."""
    return np.column_stack(into_body(_rows(signals), u, v, s))


def _rows(signals: Signals) -> Rows:
    """Rotation of the attitude, and none where it has no length."""
    w, x, y, z = (signals.channel(part) for part in ATTITUDE)
    return rotation(np.where(w * w + x * x + y * y + z * z > 0.0, w, 1.0), x, y, z)


FORCE = "specific_force_body_z"
#: Lowest frequency at which the integral serves [Hz].
FROM_HZ = 0.2


def inferred_velocity(signals: Signals, runs: Sequence[slice]) -> Series | None:
    """Velocity along z within each run [m/s], zero elsewhere; None without a specific force along z."""
    if FORCE not in signals.channels:
        return None
    velocity = np.zeros(signals.sample_count)
    for run in runs:
        excess = signals.channel(FORCE)[run] - GRAVITY * _cos_tilt(signals, run)
        velocity[run] = integrated(excess - excess.mean(), signals.step_s)
    return velocity


def _cos_tilt(signals: Signals, run: slice) -> Float[np.ndarray, " length"]:
    if set(ATTITUDE) <= set(signals.channels):
        return np.asarray(_rows(signals)[2][2])[run]
    roll, pitch = (integrated(signals.channel(axis.rate)[run], signals.step_s) for axis in (ROLL, PITCH))
    return np.asarray(np.cos(roll) * np.cos(pitch))


# -- Instruments --

#: Successive lags of references, how many and how long [s]: for turning, for velocity across, for height.
QUICK, SLOW, HEIGHT = (14, 0.04), (4, 1.0), (4, 0.15)
#: Of forces and velocities the axis of turning that tilts the thrust forward, and left, or the height.
BY_AXIS = ((PITCH_EQUATION, SLOW), (ROLL_EQUATION, SLOW), (FORCE_Z_EQUATION, HEIGHT))
#: Lags for which columns are instruments; delays, of a state that was measured [s].
INSTRUMENT_LAGS_S = (0.01, 0.03, 0.07, 0.15)
INSTRUMENT_DELAYS_S = (-0.02, 0.0, 0.02)
#: Terms without columns for these lags.
UNLAGGED = {item.name for item in (*GYROSCOPIC_MOMENT, *ALL_DRAG_MOMENTS)}


def references(
    flight: PreparedFlight, rule: separable.LaggedReferences, axis: int, lags: tuple[int, float]
) -> Float[np.ndarray, "n p"]:
    """References of an axis with their lags; those of no axis of turning are of height."""
    turning = {source.channel: number for number, item in enumerate(AXES) for source in item.references}
    names = tuple(name for name in rule.channels if turning.get(name, FORCE_Z_EQUATION) == axis)
    no_command = np.zeros(flight.signals.sample_count)
    return replace(rule, channels=names, lags=lags).columns(flight.signals, no_command)


def predicted(rotors: RotorStates, rule: separable.LaggedReferences) -> RotorStates:
    """The flight with commands, rates and velocity as references predict them."""
    flight, arms = rotors.flight, rotors.vehicle.arms
    signals, used, channels = flight.signals, flight.used, dict(flight.signals.channels)

    def predict(values: Series, axis: int, lags: tuple[int, float]) -> Series:
        """Prediction by the references of one axis, within what the values were."""
        result = cross_fitted(references(flight, rule, axis, lags), values[:, None], used)[:, 0]
        return np.clip(result, values[used].min(), values[used].max()) if used.any() else result

    turning = [(axis, QUICK) for axis in range(FORCE_X_EQUATION)]
    # commands are sums of thrust and of torques about each axis
    logged = signals.family(flight.input.name)
    shares = zip(np.linalg.lstsq(arms.T, logged.T, rcond=None)[0], (BY_AXIS[2], *turning), strict=True)
    commands = arms.T @ np.stack([predict(share, *by) for share, by in shares])
    commands = np.clip(commands, logged[used].min(), logged[used].max())
    channels |= zip(flight.driving, commands, strict=True)
    rates = zip((axis.rate for axis in AXES), turning, strict=True)
    channels |= {name: predict(signals.channel(name), *by) for name, by in rates}
    velocity = body_velocity(signals)
    if velocity is not None:
        pairs = zip(velocity.T, BY_AXIS, strict=True)
        channels |= zip(VELOCITY, (predict(component, *by) for component, by in pairs), strict=True)
        for part in ATTITUDE:
            channels[part] = np.full(signals.sample_count, float(part == ATTITUDE[0]))
    flight = replace(flight, signals=replace(signals, channels=channels))
    return replace(rotors, flight=flight, signals=body_signals(flight), _last=None)


#: Values of a sensor as its filter leaves them.
Filter = Callable[[Series], Series]


def filtered(column: Series, step_s: float, cutoff_hz: float, corrected_s: float) -> Series:
    """Column behind a second-order low-pass, less the delay that stamps were corrected for [s]."""
    lagging = low_passed(column[:, None], step_s=step_s, cutoff_hz=cutoff_hz)
    early_s = min(max(corrected_s, 0.0), math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz))
    return (shifted_by(lagging, step_s=step_s, delay_s=-early_s) if early_s else lagging)[:, 0]


def before(values: Float[np.ndarray, "*parts n"]) -> Float[np.ndarray, "*parts n"]:
    """Values of the previous sample; the first one stays."""
    return np.concatenate([values[..., :1], values[..., :-1]], axis=-1)


def change_over_step(values: Float[np.ndarray, "*parts n"], step_s: float) -> Float[np.ndarray, "*parts n"]:
    """Mean of the derivative over the step that ends at each sample, exactly."""
    return (values - before(values)) / step_s


# -- Flights --

#: Bands of spectral rows [Hz]: of turning, and of forces.
TURNING_BAND_HZ = (0.05, 20.0)
FORCE_BAND_HZ = (0.05, 8.0)
#: No band reaches beyond this share of the rate of what is measured.
BAND_SHARE = 0.2
#: Lags and delays that a search begins with [s]: in a band up to 20 Hz neighbours differ by little.
SEARCH_LAGS_S = np.geomspace(0.005, 0.2, 12)
SEARCH_DELAYS_S = np.linspace(0.0, 0.03, 4)
#: Accuracy of both [s]: gains are wrong by 5 % for a delay that is wrong by a millisecond.
TOLERANCE_S = 3e-7


def lag_and_delay(
    flights: Sequence[PreparedFlight], known: KnownNumber | None
) -> tuple[separable.Nuisance, separable.Nuisance]:
    """Lag and delay of commands, both continuous, with a known delay as a prior [s]."""
    if all(flight.input.measured for flight in flights):
        return lagged_runs.measured_state()
    lag, delay = lagged_runs.lag_and_delay(SEARCH_LAGS_S, SEARCH_DELAYS_S)
    lag = replace(lag, tolerance=TOLERANCE_S)
    if known is not None and not known.std:
        return lag, delay.known_at(known.value)
    if known is not None:
        delay = replace(delay, prior=separable.Prior(known.value, known.std))
    return lag, replace(delay, tolerance=TOLERANCE_S)


def body_signals(flight: PreparedFlight) -> Signals:
    """Channels that no lag moves; velocity is zero where it is not known, nor can be inferred."""
    signals, step_s = flight.signals, flight.signals.step_s
    rates = np.stack([signals.channel(axis.rate) for axis in AXES])
    known = body_velocity(signals)
    velocity = np.zeros_like(rates) if known is None else np.ascontiguousarray(known.T)
    along_z = inferred_velocity(signals, flight.runs) if known is None else None
    velocity[2] += 0.0 if along_z is None else along_z
    series = dict(zip((*RATES, *MOVED), (*rates, *velocity), strict=True))
    series |= {name: time_derivative(rate, step_s) for name, rate in zip(TURNED, rates, strict=True)}
    series |= zip((f"change_{name}" for name in TURNING), change_over_step(rates, step_s), strict=True)
    series[SPEED] = np.linalg.norm(velocity, axis=0)
    if known is not None:  # what an accelerometer would read where the velocity changes as it does
        derived = felt(_rows(signals), np.stack([*map(signals.channel, VELOCITY)]), step_s)
        series |= zip((f"felt_{axis}" for axis in ALONG), derived, strict=True)
    return replace(signals, channels={**signals.channels, **series})


@dataclass(eq=False)
class RotorStates:
    """Rotor states and signals that the equations of a flight share."""

    flight: PreparedFlight
    vehicle: KnownVehicle
    usual: float  # State of a rotor near hover, to which damping and drag refer
    signals: Signals  # Channels without a lag
    #: Izz over Ixx and Iyy, by which what rotors that spin turn goes with their reaction
    inertia_ratios: tuple[float, float] | None = None
    _last: tuple[Mapping[str, float], tuple[States, States]] | None = None
    predicted: RotorStates | None = None  # The same as references predict it

    def at(self, path: Mapping[str, float]) -> tuple[States, States]:
        """Sums over the rotors at a lag and a delay, with thrusts at samples, and as means over steps."""
        if self._last is None or self._last[0] != path:
            thrust_of, step_s = input_map(self.flight.input_map), self.flight.signals.step_s
            shifted = {**path, "delay_s": path["delay_s"] + 0.5 * step_s}
            state, mid_state = (self.flight.input.state(self._logged, step_s, **p) for p in (path, shifted))
            thrust, halfway = (self.vehicle.arms @ thrust_of(item).T for item in (state, mid_state))
            # Simpson's rule: a rotor follows its command smoothly within a step
            mean = (before(thrust) + 4.0 * halfway + thrust) / 6.0
            *sums, spin = self.vehicle.sums @ state.T
            states = dict(zip(STATES, (*(item / self.usual for item in sums), spin), strict=True))
            states |= zip(RATIOS, self.inertia_ratios or (), strict=False)
            changes = time_derivative(spin, step_s), change_over_step(spin, step_s)
            at_samples, means = (
                {**states, **dict(zip(THRUSTS, driving, strict=True)), SPIN_UP: change}
                for driving, change in zip((thrust, mean), changes, strict=True)
            )
            self._last = path, (at_samples, means)
        return self._last[1]

    @cached_property
    def _logged(self) -> Float[np.ndarray, "n rotors"]:
        """Logged inputs of the rotors, contiguous for each rotor."""
        return np.asfortranarray(self.flight.signals.family(self.flight.input.name))


@dataclass(frozen=True, kw_only=True)
class BodyEquation(AxisEquation):
    """One of the equations with the rotors of a flight, whose states all of them share."""

    rotors: RotorStates = field(compare=False)

    @property
    def turns(self) -> bool:
        return self.name in TURNING

    def states(self, _logged: object, _signals: Signals, path: Mapping[str, float]) -> States:
        return self.rotors.at(path)[self.turns]

    def columns(
        self, signals: Signals, texts: Sequence[str], states: States | None = None, delay_s: float = 0.0
    ) -> Float[np.ndarray, "n k"]:
        """Columns behind the filter of the sensor, unless they are made of filtered rates."""
        results = super().columns(signals, texts, {**self.rotors.vehicle.numbers, **(states or {})}, delay_s)
        for text, column in zip(texts, results.T, strict=True):
            if self.turns and not (drives(text) or text in self.response):
                column[:] = 0.5 * (column + before(column))  # over the step that ends at each sample
            elif self._sensor is not None and text != self.response[0]:
                column[:] = self._sensor(column)
        return results

    @cached_property
    def _sensor(self) -> Filter | None:
        """Filter of the sensor whose values are explained; None where none is known."""
        flight, vehicle = self.rotors.flight, self.rotors.vehicle
        cutoff_hz = vehicle.gyro_cutoff_hz if self.turns else vehicle.accelerometer_cutoff_hz
        if cutoff_hz is None:
            return None
        name = AXES[TURNING.index(self.name)].rate if self.turns else self.response[0]
        taken_s = flight.recording.channel(name).delay_s
        return partial(filtered, step_s=flight.signals.step_s, cutoff_hz=cutoff_hz, corrected_s=taken_s)

    @property
    def band_hz(self) -> tuple[float, float]:
        """Band of rows: of forces without a velocity, from where it is inferred."""
        low, high = TURNING_BAND_HZ if self.turns else FORCE_BAND_HZ
        rates_hz = self.rotors.flight.rates_hz.items()
        slowest = min(rate for role, rate in rates_hz if rate and role != "command")
        inferred = not self.turns and len(self.response) == 1
        return FROM_HZ if inferred else low, min(high, BAND_SHARE * slowest)

    def instruments(
        self, signals: Signals, rule: separable.InstrumentRule, names: tuple[str, ...]
    ) -> np.ndarray:
        """Instruments by references: predicted regressors, or lags of references."""
        if not isinstance(rule, separable.LaggedReferences):
            return super().instruments(signals, rule, names)
        if self.rotors.predicted is None:
            self.rotors.predicted = predicted(self.rotors, rule)
        rotors, flight = self.rotors.predicted, self.rotors.flight
        if self.turns:
            lagged = tuple(item for item in self.terms if item.name not in UNLAGGED)
            moving = DrivenColumns(replace(self, rotors=rotors, terms=lagged), rotors.signals)
            stages, measured = (lagged_runs.ACTUATOR_LAG.name, lagged_runs.DELAY.name), flight.input.measured
            lags_s, delays_s = ((0.0,), INSTRUMENT_DELAYS_S) if measured else (INSTRUMENT_LAGS_S, (0.0,))
            columns = [moving(dict(zip(stages, values, strict=True))) for values in product(lags_s, delays_s)]
        else:
            columns = [references(flight, rule, *BY_AXIS[ALONG.index(self.name)])]
        texts = self.instruments_of
        if not {*NEEDED} <= {*rotors.signals.channels}:
            texts = tuple(of for of in texts if {*MOVED, SPEED}.isdisjoint(parsed(of).columns))
        # what is commanded, in place of states
        spin = rotors.vehicle.arms[3] @ rotors.flight.signals.family(flight.input.name).T
        numbers = {**rotors.vehicle.numbers, "spin": spin}
        return np.column_stack([*columns, *(evaluated(parsed(of), rotors.signals, numbers) for of in texts)])


def equations_of(
    flights: tuple[PreparedFlight, ...], vehicle: KnownVehicle
) -> Iterator[dict[int, AxisEquation]]:
    """Equations of each flight, by number, with the terms that all flights are logged for."""
    known, usual = set.intersection(*({*item.signals.channels} for item in flights)), usual_state(flights)
    has_velocity = {*NEEDED} <= known
    forces = [f"specific_force_body_{axis}" in known and (has_velocity or axis == "z") for axis in ALONG]
    declared = {}
    for (number, item), logged in zip(enumerate(EQUATIONS), (True, True, True, *forces), strict=True):
        if logged:
            terms = tuple(term for term in item.terms if has_velocity or term.name not in BY_VELOCITY)
            declared[number] = {**vars(item), "terms": terms, "response": item.response[: 1 + has_velocity]}
    for flight in flights:
        driven_by = {"inputs": (flight.input.name,)}
        rotors = RotorStates(flight, vehicle, usual, body_signals(flight))
        yield {number: BodyEquation(**item | driven_by, rotors=rotors) for number, item in declared.items()}


def body_equation(axis_columns: lagged_runs.AxisColumns) -> BodyEquation:
    """Equation that columns are of."""
    return cast("BodyEquation", cast("DrivenColumns", axis_columns.moving).axis)


def usual_state(flights: tuple[PreparedFlight, ...]) -> float:
    """State of a rotor at hover: it gives the mean thrust of flights, over the mean specific force in g."""
    curve, force = input_map(flights[0].input_map), "specific_force_body_z"
    thrust = float(np.mean([curve(flight.used_input).mean() for flight in flights]))
    forces = [
        flight.signals.channel(force)[flight.used].mean()
        for flight in flights
        if force in flight.signals.channels
    ]
    load = float(np.mean(forces)) / GRAVITY if forces else 1.0
    return curve.inverse(thrust / load if 0.5 < load < 2.0 else thrust)


def hover_state(flight: PreparedFlight, vehicle: KnownVehicle, thrust: float) -> float | None:
    """State of a rotor at which thrust of that gain carries the weight; None unless it lifts."""
    gain = thrust * vehicle.count
    return input_map(flight.input_map).inverse(GRAVITY / gain) if gain > 0.0 else None


#: Of the surrogate's noises: a flight has the same estimate every time.
SEED = 0


def noises_known(flight: PreparedFlight) -> bool:
    """Whether noises are declared of all that is measured, and in every equation."""
    channels = flight.signals.channels
    speeds = family_members(flight.input.name, channels) if flight.input.measured else ()
    forces = {f"specific_force_body_{along}" for along in ALONG} & set(channels)
    return {*speeds, *(axis.rate for axis in AXES), *forces} <= set(flight.signals.noise)


def noisier(flight: PreparedFlight) -> PreparedFlight:
    """The flight with every declared noise added once more."""
    signals, rng = flight.signals, np.random.default_rng(SEED)
    noisy = {
        name: values + signals.noise[name].sample(signals.sample_count, rng)
        for name, values in signals.channels.items()
        if name in signals.noise
    }
    return replace(flight, signals=replace(signals, channels={**signals.channels, **noisy}))
