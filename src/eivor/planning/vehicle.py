"""What is known of a vehicle before a flight is planned: from a result, a file, or rough numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float
from eivor.simulation.flights.closed_loop import AltitudeController
from eivor.toml_table import read_toml

#: What each rough number may be: its lowest and highest value.
RANGES = {
    "hover_input": (0.05, 0.95),
    "viscous_friction": (0.05, 1.5),
    "lag_s": (0.005, 0.25),
    "gust_rms": (0.0, 3.0),
    "acceleration_noise": (0.0, 5.0),
    "velocity_noise": (0.0, 1.0),
    "tilt_rms": (0.0, 0.2),
}
#: Gain of a velocity loop times its lag, and the largest one [1/s]; of the position loop, a share of that.
QUICKNESS, LARGEST_VELOCITY_GAIN, POSITION_SHARE, INTEGRAL_SHARE = 0.35, 4.0, 0.3, 0.05
#: Half a step of a controller at 100 Hz [s].
HALF_STEP_S = 0.005


@dataclass(frozen=True)
class Densities:
    """One-sided densities over frequency of what no model predicts, straight lines in logarithms.

    Parameters
    ----------
    frequency_hz : ndarray, shape (n,)
        Increasing [Hz].
    force, accelerometer, velocity : ndarray, shape (n,)
        Of the force on the vehicle and of the accelerometer's error [(m/s^2)^2/Hz], and of the velocity's
        [(m/s)^2/Hz].
    """

    frequency_hz: Float[np.ndarray, " n"]
    force: Float[np.ndarray, " n"]
    accelerometer: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]

    def at(self, name: str, frequency_hz: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Density of that name above zero frequency; constant beyond the ends, force falls above them."""
        values = np.maximum(getattr(self, name), 1e-12)
        found = np.exp(np.interp(np.log(frequency_hz), np.log(self.frequency_hz), np.log(values)))
        if name == "force":
            found = found * np.minimum(1.0, (self.frequency_hz[-1] / frequency_hz) ** 2)
        return np.asarray(found)


@dataclass(frozen=True)
class VehicleGuess:
    """Rough numbers of a vehicle. Its mass is not needed.

    Parameters
    ----------
    hover_input : float
        Input at which it hovers, a share of full input.
    viscous_friction : float
        K [1/s].
    lag_s : float
        Actuator lag and delay together [s].
    gust_rms : float
        Standard deviation of the vertical wind [m/s], where `densities` does not say what acts on it.
    acceleration_noise, velocity_noise : float
        Standard deviations of the errors at 100 Hz [m/s^2, m/s], where `densities` does not say them.
    tilt_rms : float
        Standard deviation of roll and of pitch [rad].
    densities : Densities, optional
        What an estimate left. Default: gusts and white noise of these sizes.
    controller : AltitudeController, optional
        How the vehicle follows its height setpoint. Default: one that suits the lag.
    asked : str
        What an estimate could not tell, by its word in `eivor.planning.targets`; empty for nothing.

    Raises
    ------
    UsageError
        When a number is out of its range.
    """

    hover_input: float = 0.5
    viscous_friction: float = 0.3
    lag_s: float = 0.05
    gust_rms: float = 0.3
    acceleration_noise: float = 0.4
    velocity_noise: float = 0.03
    tilt_rms: float = 0.05
    densities: Densities | None = None
    controller: AltitudeController | None = None
    asked: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        checks.within(self, RANGES, "A rough number will do.")
        if self.densities is not None:
            checks.kind("densities", self.densities, Densities, "Densities", "Leave it out.")
        if self.controller is not None:
            checks.kind("controller", self.controller, AltitudeController, "a controller", "Leave it out.")
        checks.text("asked", self.asked)

    @property
    def input_gain(self) -> float:
        """K_u of a rotor whose thrust goes with the square of its share [m/s^2]."""
        return GRAVITY / self.hover_input**2

    @property
    def follows(self) -> AltitudeController:
        """The controller that it is simulated with."""
        if self.controller is not None:
            return self.controller
        velocity = min(QUICKNESS / (self.lag_s + HALF_STEP_S), LARGEST_VELOCITY_GAIN)
        return AltitudeController(POSITION_SHARE * velocity, velocity, INTEGRAL_SHARE * velocity**2)

    @property
    def left(self) -> Densities:
        """What no model predicts: gusts that last a second, and white noise, unless an estimate says it."""
        if self.densities is not None:
            return self.densities
        frequency = np.geomspace(0.05, 5.0, 12)
        gust = 4.0 * self.gust_rms**2 / (1.0 + (2.0 * np.pi * frequency) ** 2)
        white = np.ones(frequency.size) / 50.0
        return Densities(
            frequency,
            self.viscous_friction**2 * gust,
            self.acceleration_noise**2 * white,
            self.velocity_noise**2 * white,
        )


def vehicle_of_result(document: Mapping[str, Any]) -> VehicleGuess:
    """Vehicle of a document of schema ``eivor.identify/1``; what it does not tell is taken as usual.

    Raises
    ------
    UsageError
        When it is a result of another motion than the vertical one.
    """
    if document["model"]["name"] != "vertical_motion":
        raise UsageError(
            "a result of the vertical motion",
            f"one of '{document['model']['name']}'",
            "Others are not planned.",
        )
    told = {**document["parameters"], **document["derived"]}
    usual = VehicleGuess()
    flown = (document.get("prediction") or {}).get("flown") or {}
    gains = flown.get("controller")
    residual = flown.get("residual")
    taken = flown.get("taken", {})
    return VehicleGuess(
        hover_input=_hover(told["hover_input"], document["model"]["input_map"], usual.hover_input),
        viscous_friction=_within("viscous_friction", taken.get("viscous_friction", usual.viscous_friction)),
        lag_s=_within("lag_s", taken.get("lag_s", usual.lag_s)),
        tilt_rms=_within("tilt_rms", flown.get("tilt_rms", usual.tilt_rms)),
        densities=None if residual is None else _densities(residual),
        controller=None if gains is None else AltitudeController(**gains),
        asked=_asked(told),
    )


def rough_vehicle(
    *,
    hover: float | None = None,
    friction: float | None = None,
    lag: float | None = None,
    gusts: float | None = None,
) -> VehicleGuess:
    """Vehicle of rough numbers as they are typed: the lag in milliseconds; what is not given is as usual.

    Raises
    ------
    UsageError
        When a number is out of its range.
    """
    usual = VehicleGuess()
    return VehicleGuess(
        hover_input=usual.hover_input if hover is None else hover,
        viscous_friction=usual.viscous_friction if friction is None else friction,
        lag_s=usual.lag_s if lag is None else 1e-3 * lag,
        gust_rms=usual.gust_rms if gusts is None else gusts,
    )


def read_vehicle(path: Path) -> VehicleGuess:
    """Vehicle from a TOML file with the rough numbers of `VehicleGuess`, all optional.

    Raises
    ------
    InputError
        When the file cannot be read, a key is unknown, or a value no number.
    UsageError
        When a number is out of its range.
    """
    table = read_toml(path, "a vehicle")
    usual = VehicleGuess()
    guess = VehicleGuess(
        hover_input=table.number("hover_input", usual.hover_input),
        viscous_friction=table.number("viscous_friction", usual.viscous_friction),
        lag_s=table.number("lag_s", usual.lag_s),
        gust_rms=table.number("gust_rms", usual.gust_rms),
        acceleration_noise=table.number("acceleration_noise", usual.acceleration_noise),
        velocity_noise=table.number("velocity_noise", usual.velocity_noise),
        tilt_rms=table.number("tilt_rms", usual.tilt_rms),
    )
    table.finish()
    return guess


def _within(name: str, value: float) -> float:
    """Return the value, or the end of its range that is nearest."""
    return float(np.clip(value, *RANGES[name]))


def _hover(quantity: Mapping[str, Any], input_map: str, usual: float) -> float:
    """Hover input as the share of a rotor whose thrust goes with its square; speeds have no share."""
    value = quantity["value"]
    if value is None or not 0.0 < value < 1.0:
        return usual
    share = math.sqrt(value) if input_map == "linear" else value
    return _within("hover_input", share)


def _densities(residual: Mapping[str, Any]) -> Densities:
    return Densities(
        *(
            np.array(residual[name], dtype=np.float64)
            for name in ("frequency_hz", "force", "accelerometer", "velocity")
        )
    )


def _asked(told: Mapping[str, Any]) -> str:
    """First of friction, lag and gain that is not identified."""
    order = {"friction": "viscous_friction", "lag": "effective_lag", "gain": "input_gain"}
    for word, name in order.items():
        if told[name]["verdict"] != "identified":
            return word
    return ""
