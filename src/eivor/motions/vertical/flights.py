"""The vertical motion of one or several flights: commands that actuators lag behind, or their measured state.

One separable problem: friction, gain and lag are shared by all flights, the intercept belongs to a run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from eivor.models.equation import Parameter
from eivor.models.instruments import DrivenSignals, InstrumentRule, NoInstruments
from eivor.models.lagged_runs import (
    ACTUATOR_LAG,
    BAND_HZ,
    DELAY,
    AxisColumns,
    LaggedRuns,
    lag_and_delay,
    measured_state,
)
from eivor.models.regression import Regression
from eivor.models.separable import Nuisance, SampledState, SeparableProblem, Values
from eivor.models.spectral import SpectralRegression
from eivor.motions.vertical.fitted_curve import FittedCurve
from eivor.motions.vertical.model import GRAVITY, VerticalMotion
from eivor.motions.vertical.row_noise import noise_powers, row_noise
from eivor.motions.vertical.terms import OptionalTerm, TermIngredients, term_instruments
from eivor.shapes import Float
from eivor.signals.actuator import actuator_state, shifted_by
from eivor.signals.signals import Signals


@dataclass(frozen=True)
class VerticalFlight:
    """One flight on its grid, and the runs of it that count.

    Parameters
    ----------
    signals : Signals
        z up, with `velocity_z`, `cos_tilt`, the input's family, the references, and `specific_force_z`
        unless only the velocity was logged.
    input : str
        Family of channels that drive the vehicle ("rotor_command").
    measured : bool
        True when that family is the actuators' measured state, which does not lag, and may be late or early.
    runs : tuple of slice
        Stretches to use; of their samples those count that are valid.
    band_hz : tuple of float
        Band of spectral rows [Hz].
    radii, voltage : ndarray, shape (n,), optional
        Height over the ground in rotor radii, and the supply's voltage over that which the gain belongs to,
        less one: for terms that need them.
    densities : mapping of str to float
        Amplitude densities of declared noises by channel, in the channel's unit per root of Hz.
    """

    signals: Signals
    input: str
    measured: bool
    runs: tuple[slice, ...]
    band_hz: tuple[float, float] = BAND_HZ
    radii: Float[np.ndarray, " n"] | None = None
    voltage: Float[np.ndarray, " n"] | None = None
    densities: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def velocity(self) -> Float[np.ndarray, " n"]:
        """Z' [m/s]."""
        return self.signals.channel("velocity_z")

    @cached_property
    def velocity_derivative(self) -> Float[np.ndarray, " n"]:
        """Central difference of z' [m/s^2]."""
        derivative: Float[np.ndarray, " n"] = np.gradient(self.velocity, self.signals.step_s)
        return derivative

    @cached_property
    def acceleration(self) -> Float[np.ndarray, " n"] | None:
        """Z'' from the accelerometer [m/s^2]; None when it was not logged."""
        if "specific_force_z" not in self.signals.channels:
            return None
        return self.signals.channel("specific_force_z") - GRAVITY

    def mapped_input(self, motion: VerticalMotion, lag_s: float, delay_s: float) -> Float[np.ndarray, " n"]:
        """Cosine of tilt times the mean of the mapped actuator states, over the whole grid."""
        logged, step_s = self.signals.family(self.input), self.signals.step_s
        if self.measured:
            state = shifted_by(logged, step_s=step_s, delay_s=delay_s)
        else:
            state = actuator_state(logged, step_s=step_s, lag_s=lag_s, delay_s=delay_s)
        mapped: Float[np.ndarray, " n"] = motion.input_map(state).mean(axis=1)
        return mapped * self.signals.channel("cos_tilt")

    def cut(self, columns: Float[np.ndarray, "n columns"]) -> list[Float[np.ndarray, "_ columns"]]:
        """Rows of each run that count."""
        valid = self.signals.valid
        return [columns[run] if valid is None else columns[run][valid[run]] for run in self.runs]


@dataclass(frozen=True)
class MovingColumns:
    """The mapped input, which moves with lag and delay, and the optional terms.

    Parameters
    ----------
    flight : VerticalFlight
        Whose input.
    motion : VerticalMotion
        With the input map.
    terms : tuple of OptionalTerm
        Terms beside the model's.
    """

    flight: VerticalFlight
    motion: VerticalMotion
    terms: tuple[OptionalTerm, ...] = ()

    def __call__(self, at: Values) -> Float[np.ndarray, "n m"]:
        """U at a lag and a delay, and a column for each term."""
        mapped = self.flight.mapped_input(self.motion, at[ACTUATOR_LAG.name], at[DELAY.name])
        if not self.terms:
            return mapped[:, None]
        of = self._ingredients(mapped)
        return np.column_stack([mapped, *(term.column(of) for term in self.terms)])

    def instruments(self, references: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n q"]:
        """References, and where there are any an instrument for each term."""
        if not (self.terms and references.shape[1]):
            return references
        own = term_instruments(self.terms, self._ingredients(self._unlagged), references, self.flight.runs)
        return np.column_stack([references, own])

    def _ingredients(self, mapped: Float[np.ndarray, " n"]) -> TermIngredients:
        lift = GRAVITY / self._mean * mapped
        return TermIngredients(self.flight.velocity, lift, self.flight.radii, self.flight.voltage)

    @cached_property
    def _unlagged(self) -> Float[np.ndarray, " n"]:
        return self.flight.mapped_input(self.motion, 0.0, 0.0)

    @cached_property
    def _mean(self) -> float:
        """Mean of the mapped input over the runs, of either sign; one where it is zero."""
        return float(np.concatenate(self.flight.cut(self._unlagged[:, None])).mean()) or 1.0


@dataclass(frozen=True)
class VerticalFlights(SeparableProblem):
    """Regressions of vertical motion for each actuator lag and delay.

    Parameters
    ----------
    flights : tuple of VerticalFlight
        One or more, of one vehicle.
    motion : VerticalMotion
        The model.
    rule : InstrumentRule
        What serves as instruments.
    nuisances : tuple of Nuisance
        Lag and delay of the actuators. Default: what is searched for commands, and for a state that is
        measured no lag and a delay of either sign.
    curve : FittedCurve, optional
        How the model's input map was found out; None for one that was chosen.
    terms : tuple of OptionalTerm
        Terms beside the model's; their parameters follow its own.

    Raises
    ------
    TooFewSamplesError
        When no flight has a run.
    InstrumentError
        When the rule gives different columns for different flights.
    """

    flights: tuple[VerticalFlight, ...]
    motion: VerticalMotion
    rule: InstrumentRule = field(default_factory=NoInstruments)
    nuisances: tuple[Nuisance, ...] = ()
    curve: FittedCurve | None = None
    terms: tuple[OptionalTerm, ...] = ()
    runs: LaggedRuns = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.nuisances:
            measured = all(flight.measured for flight in self.flights)
            step_s = max((flight.signals.step_s for flight in self.flights), default=0.0)
            nuisances = measured_state() if measured else lag_and_delay(step_s=step_s)
            object.__setattr__(self, "nuisances", nuisances)
        columns = tuple(self._columns(number, flight) for number, flight in enumerate(self.flights))
        runs = LaggedRuns(
            columns, self.parameters, self.nuisances, self.motion.intercept, partial(row_noise, self)
        )
        object.__setattr__(self, "runs", runs)

    @property
    def few_rows(self) -> bool:
        """Whether there are terms: voltage and height change slowly."""
        return bool(self.terms)

    @property
    def lag(self) -> Nuisance:
        """The actuators' lag."""
        return self._nuisance(ACTUATOR_LAG)

    @property
    def delay(self) -> Nuisance:
        """The actuators' delay."""
        return self._nuisance(DELAY)

    def _nuisance(self, parameter: Parameter) -> Nuisance:
        return next(nuisance for nuisance in self.nuisances if nuisance.parameter == parameter)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Linear parameters."""
        return (*self.motion.parameters, *(term.parameter for term in self.terms))

    @property
    def instrument_count(self) -> int:
        """Number of instruments."""
        return self.runs.columns[0].instruments.shape[1]

    def moving(self, flight: VerticalFlight) -> MovingColumns:
        """Columns of one of the flights that are the input's and the terms'."""
        return MovingColumns(flight, self.motion, self.terms)

    def _columns(self, number: int, flight: VerticalFlight) -> AxisColumns:
        """Columns of one flight: z'' measured and from the velocity, -z', the mapped input, terms."""
        moving = self.moving(flight)
        responses = [flight.velocity_derivative]
        if flight.acceleration is not None:
            responses.insert(0, flight.acceleration)
        return AxisColumns(
            flight.signals.step_s,
            flight.runs,
            np.column_stack(responses),
            -flight.velocity[:, None],
            moving,
            moving.instruments(
                self.rule.columns(DrivenSignals(flight.signals, flight.mapped_input(self.motion, 0.0, 0.0)))
            ),
            number,
            band_hz=flight.band_hz,
            valid=flight.signals.valid,
        )

    def rows(self, at: Values) -> Regression:
        """Rows (-z', U) and z'' in time, means of each run removed when there is an intercept."""
        return self.runs.rows(at)

    def bins(self, at: Values) -> SpectralRegression:
        """Rows (-z', U) and the responses z'' and d(z')/dt in frequency."""
        return self.runs.bins(at)

    def many_bins(self, points: Sequence[Values]) -> list[SpectralRegression]:
        """Rows in frequency at many lags and delays."""
        return self.runs.many_bins(points)

    def sampled_state(self, _at: Values) -> SampledState | None:
        """The vertical velocity, where every flight has an accelerometer."""
        if any(flight.acceleration is None for flight in self.flights):
            return None
        lengths = [
            sum(one.shape[0] for one in flight.cut(flight.velocity[:, None])) for flight in self.flights
        ]
        each = [noise_powers(flight, self.motion.input_map) for flight in self.flights]
        velocity, driving, response = np.sqrt(np.average(each, axis=0, weights=lengths)).tolist()
        driven = np.zeros(len(self.parameters))
        driven[1] = driving
        return SampledState(0, velocity, response, driven)
