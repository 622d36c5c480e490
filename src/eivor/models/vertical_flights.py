"""The vertical motion of one or several flights whose actuators lag behind their commands.

One separable problem: friction, gain and lag are shared by all flights, the intercept belongs to a run.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float

from eivor.errors import InstrumentError, TooFewSamplesError
from eivor.models.instruments import InstrumentRule, NoInstruments
from eivor.models.parameter import Parameter
from eivor.models.regression import Regression, SampleRows
from eivor.models.separable import SeparableProblem
from eivor.models.spectral import BinRows, SpectralRegression, SpectralRun
from eivor.models.vertical import GRAVITY, VerticalMotion
from eivor.signals.actuator import actuator_state
from eivor.signals.signals import Signals

#: Grid of lags [s] and delays [s] that are searched.
LAG_GRID_S = np.geomspace(0.002, 0.3, 40)
DELAYS_S = (0.0, 0.010, 0.020, 0.030, 0.040)


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
        True when that family is the actuators' measured state, which neither lags nor is delayed.
    runs : tuple of slice
        Stretches to use.
    band_hz : tuple of float
        Band of spectral rows [Hz].
    """

    signals: Signals
    input: str
    measured: bool
    runs: tuple[slice, ...]
    band_hz: tuple[float, float] = (0.04, 5.0)

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
        command = self.signals.family(self.input)
        state = actuator_state(command, step_s=self.signals.step_s, lag_s=lag_s, delay_s=delay_s)
        mapped: Float[np.ndarray, " n"] = motion.input_map(state).mean(axis=1)
        return mapped * self.signals.channel("cos_tilt")

    def cut(self, columns: Float[np.ndarray, "n columns"]) -> list[Float[np.ndarray, "_ columns"]]:
        """Rows of each run."""
        return [columns[run] for run in self.runs]


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
    lags : ndarray
        Lags to search [s]; a single zero when the actuator's state is measured.
    delays : tuple of float
        Delays to try [s].

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
    lags: Float[np.ndarray, " lags"] = field(default_factory=lambda: LAG_GRID_S)
    delays: tuple[float, ...] = DELAYS_S

    def __post_init__(self) -> None:
        if not any(flight.runs for flight in self.flights):
            raise TooFewSamplesError(
                "at least one usable run of flight", "none", "See the reasons that `eivor inspect` gives."
            )
        if all(flight.measured for flight in self.flights):
            object.__setattr__(self, "lags", np.zeros(1))
            object.__setattr__(self, "delays", (0.0,))
        if len({columns.shape[1] for columns in self._instruments}) != 1:
            raise InstrumentError(
                "the same instruments in every flight of a pool",
                f"{[columns.shape[1] for columns in self._instruments]} columns",
                "Pool flights that log the same references, or name the instruments.",
            )

    @property
    def lag_grid_s(self) -> Float[np.ndarray, " lags"]:
        """Lags to search [s]."""
        return self.lags

    @property
    def delays_s(self) -> tuple[float, ...]:
        """Delays to try [s]."""
        return self.delays

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Linear parameters."""
        return self.motion.parameters

    @cached_property
    def _instruments(self) -> list[Float[np.ndarray, "_ p"]]:
        return [
            self.rule.columns(flight.signals, flight.mapped_input(self.motion, 0.0, 0.0))
            for flight in self.flights
        ]

    # -- rows in time ---------------------------------------------------------------------------------

    @cached_property
    def _fixed_samples(self) -> tuple[Float[np.ndarray, "rows 2"], Float[np.ndarray, "rows p"], SampleRows]:
        """Response and -z', the instruments, and the flight of each row; means of each run removed."""
        fixed: list[np.ndarray] = []
        instruments: list[np.ndarray] = []
        flights: list[np.ndarray] = []
        for number, (flight, Psi) in enumerate(zip(self.flights, self._instruments, strict=True)):
            measured = flight.acceleration
            response = flight.velocity_derivative if measured is None else measured
            columns = np.column_stack([response, -flight.velocity])
            fixed.extend(self._centred(block) for block in flight.cut(columns))
            instruments.extend(self._centred(block) for block in flight.cut(Psi))
            flights.extend(np.full(run.stop - run.start, number, dtype=np.int64) for run in flight.runs)
        return np.concatenate(fixed), np.concatenate(instruments), SampleRows(np.concatenate(flights))

    def _centred(self, block: Float[np.ndarray, "length columns"]) -> Float[np.ndarray, "length columns"]:
        return block - block.mean(axis=0) if self.motion.intercept else block

    def samples(self, lag_s: float, delay_s: float) -> Regression:
        """Rows (-z', U) and z'' in time, means of each run removed when there is an intercept."""
        fixed, instruments, layout = self._fixed_samples
        moving = [
            self._centred(block)
            for flight in self.flights
            for block in flight.cut(flight.mapped_input(self.motion, lag_s, delay_s)[:, None])
        ]
        regressors = np.column_stack([fixed[:, 1], np.concatenate(moving)])
        return Regression(fixed[:, 0], regressors, instruments, self.parameters, layout, self.regressor_noise)

    @cached_property
    def regressor_noise(self) -> Float[np.ndarray, "3 3"] | None:
        """Declared variances of the errors in z', U and z'', averaged over flights; or None.

        A commanded input is exact. Without an accelerometer z'' is the central difference of z', whose
        white noise of variance s^2 it turns into one of variance s^2 / (2 h^2).
        """
        variances = []
        for flight in self.flights:
            noise = {
                name: float(model.autocovariance(0, 0, 1)[0]) for name, model in flight.signals.noise.items()
            }
            if "velocity_z" in noise and flight.acceleration is None:
                noise["specific_force_z"] = noise["velocity_z"] / (2.0 * flight.signals.step_s**2)
            if not {"velocity_z", "specific_force_z"} <= set(noise):
                return None
            variances.append([noise["velocity_z"], 0.0, noise["specific_force_z"]])
        return np.diag(np.mean(variances, axis=0))

    # -- rows in frequency ----------------------------------------------------------------------------

    @cached_property
    def _layout(self) -> BinRows:
        runs = [
            SpectralRun(number, run.stop - run.start, flight.signals.step_s, flight.band_hz)
            for number, flight in enumerate(self.flights)
            for run in flight.runs
        ]
        return BinRows(tuple(runs))

    @cached_property
    def _fixed_bins(self) -> tuple[Complex[np.ndarray, "bins r"], Complex[np.ndarray, "bins 1"], np.ndarray]:
        """Candidate responses, -z', and the instruments."""
        with_acceleration = all(flight.acceleration is not None for flight in self.flights)
        columns = []
        for flight, Psi in zip(self.flights, self._instruments, strict=True):
            responses = [flight.velocity_derivative]
            if with_acceleration and flight.acceleration is not None:
                responses.insert(0, flight.acceleration)
            columns.append(np.column_stack([*responses, -flight.velocity, Psi]))
        spectra = self._spectra(columns)
        count = 2 if with_acceleration else 1
        return spectra[:, :count], spectra[:, count : count + 1], spectra[:, count + 1 :]

    @cached_property
    def _input_spectra(self) -> dict[tuple[float, float], Complex[np.ndarray, "bins 1"]]:
        """Memo of the moving column: every pass of a weighting visits the same grid again."""
        return {}

    def _spectra(self, columns: list[Float[np.ndarray, "_ columns"]]) -> Complex[np.ndarray, "bins columns"]:
        blocks = [
            block
            for flight, values in zip(self.flights, columns, strict=True)
            for block in flight.cut(values)
        ]
        return np.concatenate(
            [run.spectrum(block) for run, block in zip(self._layout.runs, blocks, strict=True)]
        )

    def bins(self, lag_s: float, delay_s: float) -> SpectralRegression:
        """Rows (-z', U) and the responses z'' and d(z')/dt in frequency."""
        key = (lag_s, delay_s)
        if key not in self._input_spectra:
            moving = [flight.mapped_input(self.motion, lag_s, delay_s)[:, None] for flight in self.flights]
            self._input_spectra[key] = self._spectra(moving)
        responses, velocity, instruments = self._fixed_bins
        regressors = np.concatenate([velocity, self._input_spectra[key]], axis=1)
        return SpectralRegression(responses, regressors, instruments, self.parameters, self._layout)
