"""What is known of a simulated flight besides its recording.

Conventions, settled here once: z is up, SI units, and the arrays stand on the log's grid, one row for
each stamp. Rotor states are in the unit of their commands, and the input gain belongs to the *mean* over
the rotors of the mapped state, as in the vertical model: specific force = K_u U - K v + b with
U = cosine of tilt x mean_i map(rotor_i).

The friction of a real vehicle is not one number: rotor drag grows with rotor speed, parasitic drag with
the square of air speed. `FlightTruth` therefore holds the nominal value (at hover, in still air), and
`effective_parameters` gives the value that this flight would give to an estimator without any error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eivor.errors import CollinearError, ShapeError, TooFewSamplesError
from eivor.shapes import Bool, Float
from eivor.signals.recording import Recording


@dataclass(frozen=True, slots=True)
class FlightTruth:
    """Noise-free arrays of a simulated flight, and its nominal parameters.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Stamps [s] of the rows.
    specific_force_z : ndarray, shape (n,)
        Acceleration plus g along the world's z [m/s^2].
    air_velocity_z : ndarray, shape (n,)
        Vertical velocity minus vertical wind [m/s].
    rotor_state : ndarray, shape (n, rotors)
        Actual rotor states, in the commands' unit.
    cos_tilt : ndarray, shape (n,)
        Cosine of the angle between the body's and the world's z.
    actuator_lag : float
        Time constant of the rotors [s].
    delay : float
        Time from a command to its effect on the rotor's first-order lag [s].
    viscous_friction : float
        K at hover in still air [1/s].
    input_gain : float
        K_u [m/s^2 per unit of the mean mapped rotor state], at the beginning where it changes.
    hover_input : float
        Rotor state at hover.

    Raises
    ------
    ShapeError
        When the arrays differ in their number of rows.
    """

    time_s: Float[np.ndarray, " n"]
    specific_force_z: Float[np.ndarray, " n"]
    air_velocity_z: Float[np.ndarray, " n"]
    rotor_state: Float[np.ndarray, "n rotors"]
    cos_tilt: Float[np.ndarray, " n"]
    actuator_lag: float
    delay: float
    viscous_friction: float
    input_gain: float
    hover_input: float

    def __post_init__(self) -> None:
        arrays = (self.time_s, self.specific_force_z, self.air_velocity_z, self.rotor_state, self.cos_tilt)
        counts = [array.shape[0] for array in arrays]
        if len(set(counts)) != 1 or self.rotor_state.ndim != 2:
            raise ShapeError(
                "arrays with one row for each stamp, the rotor state with one column for each rotor",
                f"rows {counts} and a rotor state of shape {self.rotor_state.shape}",
                "Put every array of the truth on the log's grid.",
            )


@dataclass(frozen=True, slots=True)
class SimulatedFlight:
    """A recording as a log would hold it, and the truth behind it.

    Parameters
    ----------
    recording : Recording
        Noisy channels, frame z up.
    truth : FlightTruth
        Noise-free arrays on the recording's grid, and nominal parameters.
    flew : bool
        False when the vehicle was lost; recording and truth then end where it was.
    """

    recording: Recording
    truth: FlightTruth
    flew: bool


class EffectiveParameters(NamedTuple):
    """Parameters of the vertical model that fit one flight's noise-free data best."""

    viscous_friction: float
    """K [1/s]."""
    input_gain: float
    """K_u [m/s^2 per unit of the mean mapped rotor state]."""
    intercept: float
    """b [m/s^2]."""


def effective_parameters(
    truth: FlightTruth,
    rows: Bool[np.ndarray, " n"],
    input_map: Callable[[Float[np.ndarray, "m rotors"]], Float[np.ndarray, "m rotors"]],
) -> EffectiveParameters:
    """Least squares of the true specific force on (-air velocity, U, 1) over the given rows.

    Parameters
    ----------
    truth : FlightTruth
        The flight.
    rows : ndarray of bool, shape (n,)
        Rows to use, normally those that an estimate used.
    input_map : callable
        Maps rotor states elementwise, for instance `np.square`.

    Returns
    -------
    EffectiveParameters
        K [1/s], K_u [m/s^2 per unit of the mean mapped state], b [m/s^2]. In gusts, K and K_u are of the
        motion through the air, which an estimator that sees the ground velocity only can still reach
        with instruments that the gusts do not touch.

    Raises
    ------
    ShapeError
        When the mask does not fit the flight.
    TooFewSamplesError
        With fewer than four rows.
    CollinearError
        When velocity or input does not vary over the rows, so that they are one with the intercept.

    Notes
    -----
    Columns are scaled to unit norm after their means are taken off: a squared rotor speed is of the order
    of 1e6, an intercept of 1. One QR-based solution of n rows and two columns.
    """
    if rows.shape != truth.time_s.shape:
        raise ShapeError(
            f"a mask of {truth.time_s.size} rows",
            f"a mask of shape {rows.shape}",
            "Give one truth value for each row of the flight.",
        )
    if int(rows.sum()) < 4:
        raise TooFewSamplesError(
            "at least four rows", f"{int(rows.sum())} rows", "Choose a longer part of the flight."
        )
    columns = np.column_stack(
        [
            -truth.air_velocity_z[rows],
            truth.cos_tilt[rows] * input_map(truth.rotor_state[rows]).mean(axis=1),
        ]
    )
    response = truth.specific_force_z[rows]
    means, response_mean = columns.mean(axis=0), float(response.mean())
    centred = columns - means
    norms = np.linalg.norm(centred, axis=0)
    floor = 1e-12 * np.sqrt(rows.sum()) * np.maximum(np.abs(means), 1.0)
    if np.any(norms <= floor) or np.linalg.cond(centred / norms) > 1e10:
        raise CollinearError(
            "a velocity and an input that vary, each in its own way",
            "rows over which at least one of them is constant or follows the other",
            "Choose rows with vertical motion.",
        )
    scaled = np.linalg.lstsq(centred / norms, response - response_mean)[0]
    friction, gain = (scaled / norms).tolist()
    return EffectiveParameters(friction, gain, response_mean - float(means @ (scaled / norms)))
