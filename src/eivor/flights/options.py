"""Options of a flight's identification."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.linear import Method
from eivor.flights.references import Declared, check_noise
from eivor.models.separable import Bounds, Prior

#: Largest tilt that a vertical model bears: its cosine is 0.9.
MAX_TILT_DEG = float(np.rad2deg(np.arccos(0.9)))
#: In place of a map's name: it is found out from the flight.
FIT_MAP = "fit"
#: Standard deviation of the bias of an accelerometer that was calibrated [m/s^2].
ACCELEROMETER_BIAS = 0.1
LONGEST_LAG_S = 1.0

#: Largest radius of a rotor [m].
LARGEST_RADIUS = 5.0
FASTEST_HZ = 32_000.0

ORDERS = (1, 2, 3)

#: What flights of a pool may share of what belongs to a flight.
POOL_FRICTIONS = ("auto", "common", "separate")


@dataclass(frozen=True, slots=True)
class FlightOptions:
    """Choices for the identification of a flight; the defaults are the recipe's.

    Parameters
    ----------
    window : tuple of float, optional
        Start and end [s] on the log's clock. Default: the whole log.
    max_tilt_deg : float
        Samples tilted further are left out [deg].
    input : str
        Channel, or family of channels, that drives the vehicle; empty for the first of rotor_command,
        rotor_speed, input that is in the log.
    input_map : str
        linear, square, power:EXPONENT or mixed:SHARE. "fit" estimates an exponent for rotors, a share for
        thrust. Empty for the log's own, else square for rotors and linear for thrust.
    instruments : tuple of str
        ("references",), ("lags",), or names of channels; empty for the method's own: references, and
        lags for extended_iv.
    method : str or Method
        One of `eivor.methods`, or its name.
    compare : bool
        Estimate with every method and list the results side by side.
    lag : Prior or Bounds, optional
        What is known of the effective lag, actuator lag plus delay, from elsewhere [s]. ``ev.Prior(0.070,
        0.015)`` is 70 ms with a standard error of 15 ms, ``ev.Bounds(0.050, 0.090)`` 50 to 90 ms.
        ``ev.Bounds(0.0, 0.0)`` is neither lag nor delay.
    align : bool
        Take an offset in time and a scale out of sensors that disagree, as far as the motion can.
    accelerometer_bias : float
        What a map that is found out rests on: the standard deviation of the accelerometer's bias [m/s^2].
        Where a gain is followed it may be infinite, for nothing known of it.
    pool_friction : str
        What flights of a pool share of what belongs to a flight, such as the friction. "auto": each flight's
        own, and a common value where they agree. "separate": each flight's own, and their mean. "common":
        one value throughout.
    pool_anyway : bool
        Pool flights whose autopilots' parameters, or sizes of whose inputs, say that the vehicles differ.
    terms : tuple of str
        Optional terms of the motion that its equation is to have, by the words of `Abilities.terms`.
    rotor_radius : float, optional
        Radius of a rotor [m], for what a motion identifies in radii.
    controller_rate_hz : float, optional
        How often the controller issues commands [Hz], where stamps and parameters of a log do not show it.
    order : int, optional
        Order of the response from commands to the vehicle's motion: 1 without a lag of the actuators, 2 with
        one, 3 with two in series. Default: 2, and of turning 3 where the flight says so.
    noise : mapping of str to float or DataSheet, or str, optional
        Measurement noise by channel, for methods that take it out. It is the standard deviation of a logged
        sample in the channel's SI unit, or the sensor's data sheet. A family's name stands for all of it.
        "estimate" reads it off each channel's fastest part. Default: that of the log's channel map.

    Raises
    ------
    UsageError
        When the tilt is not between 0 and 90 degrees, the window is empty, or the lag is none.
    """

    window: tuple[float, float] | None = None
    max_tilt_deg: float = MAX_TILT_DEG
    input: str = ""
    input_map: str = ""
    instruments: tuple[str, ...] = ()
    method: str | Method = "reference_iv"
    compare: bool = False
    lag: Prior | Bounds | None = None
    align: bool = False
    accelerometer_bias: float = ACCELEROMETER_BIAS
    pool_friction: str = "auto"
    pool_anyway: bool = False
    terms: tuple[str, ...] = ()
    rotor_radius: float | None = None
    controller_rate_hz: float | None = None
    order: int | None = None
    noise: Mapping[str, Declared] | str | None = None

    def __post_init__(self) -> None:
        self._check_types()
        if not 0.0 < self.max_tilt_deg < 90.0:
            expected = "a largest tilt between 0 and 90 degrees"
            raise UsageError(expected, f"{self.max_tilt_deg:g}", "The default is 25.8.")
        if not self.accelerometer_bias > 0.0:
            expected = "a standard deviation of the accelerometer's bias above zero"
            raise UsageError(expected, f"{self.accelerometer_bias:g} m/s^2", "The default is 0.1.")
        if self.input_map == FIT_MAP and math.isinf(self.accelerometer_bias):
            expected = "a finite accelerometer_bias with the map 'fit', which rests on it"
            raise UsageError(expected, "inf", "Give its standard deviation in m/s^2: the default is 0.1.")
        if self.rotor_radius is not None and not 0.0 < self.rotor_radius <= LARGEST_RADIUS:
            expected = f"a rotor's radius between 0 and {LARGEST_RADIUS:g} m"
            remedy = "Give it in metres: half a propeller's diameter, such as 0.12."
            raise UsageError(expected, f"{self.rotor_radius:g} m", remedy)
        if self.controller_rate_hz is not None and not 0.0 < self.controller_rate_hz <= FASTEST_HZ:
            expected = f"a controller's rate between 0 and {FASTEST_HZ:g} Hz"
            remedy = "Give it in Hz, such as 400; leave it out where it is not known."
            raise UsageError(expected, f"{self.controller_rate_hz:g} Hz", remedy)
        if isinstance(self.lag, Prior) and not self.lag.mean > 0.0:
            raise UsageError("a lag above zero", f"{self.lag.mean:g} s", "Give it in seconds.")
        if isinstance(self.lag, Bounds) and not 0.0 <= self.lag.low <= self.lag.high <= LONGEST_LAG_S:
            received = f"{self.lag.low:g} and {self.lag.high:g} s"
            remedy = "Give them in seconds: ev.Bounds(0.050, 0.090)."
            raise UsageError(f"bounds of the lag between 0 and {LONGEST_LAG_S:g} s", received, remedy)
        checks.index_of("pool_friction", self.pool_friction, POOL_FRICTIONS, "The default is auto.")
        if self.window is not None and not self.window[0] < self.window[1]:
            received = f"{self.window[0]:g}:{self.window[1]:g}"
            remedy = "Give both in seconds from the log's start."
            raise UsageError("a window START:END with START before END", received, remedy)

    def _check_types(self) -> None:
        for name in ("max_tilt_deg", "accelerometer_bias", "rotor_radius", "controller_rate_hz"):
            if getattr(self, name) is not None or name in ("max_tilt_deg", "accelerometer_bias"):
                checks.number(name, getattr(self, name))
        check_order(self.order)
        if not isinstance(self.method, Method):
            checks.text("method", self.method)
        for name in ("input", "input_map"):
            checks.text(name, getattr(self, name))
        for name, example in (("instruments", "references"), ("terms", "quadratic-drag")):
            checks.items(name, getattr(self, name), str, "names", f'Give ("{example}",), for example.')
        for name in ("compare", "align", "pool_anyway"):
            checks.flag(name, getattr(self, name))
        check_noise(self.noise)
        if self.lag is not None:
            remedy = "Give ev.Prior(0.070, 0.015) or ev.Bounds(0.050, 0.090), in seconds."
            checks.kind("lag", self.lag, (Prior, Bounds), "a Prior, or Bounds,", remedy)
        if self.window is not None:
            check_window(self.window)


def check_order(order: int | None) -> None:
    """Refuse what is no order of a response; None has it chosen."""
    if order is not None:
        checks.whole("order", order)
        if order not in ORDERS:
            raise UsageError("an order of 1, 2 or 3", f"{order}", "Leave it out to have it chosen.")


def check_window(window: object) -> None:
    """Refuse what is no pair of numbers."""
    remedy = "Give (START, END) in seconds from the log's start."
    checks.items("window", window, checks.NUMBERS, "two numbers", remedy)
    if isinstance(window, tuple | list) and len(window) != 2:
        raise UsageError("a window of two numbers", f"{len(window)}", remedy)
