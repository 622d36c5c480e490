"""Options of the recipe as they are typed: checked before any log is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from eivor.asked import words
from eivor.asked.noise import noise as declared_noise
from eivor.errors import UsageError

if TYPE_CHECKING:
    from eivor.flights.motion import Motion
    from eivor.flights.options import FlightOptions
    from eivor.models.separable import Bounds, Prior


def named_motion(name: str, vehicle: str = "") -> Motion[Any]:
    """Return the motion of a name, of a vehicle where one is given; its channels are known from then on.

    Raises
    ------
    UsageError
        With the motions that there are; and when the motion does not ask what flies.
    """
    from eivor.motions import motion_by_name

    motion = motion_by_name(name)
    return motion.of_vehicle(vehicle) if vehicle else motion


def flight_options(
    motion: Motion[Any],
    *,
    window: str = "",
    max_tilt: float | None = None,
    input_channel: str = "",
    input_map: str = "",
    accelerometer_bias: float | None = None,
    instruments: str = "",
    method: str = "reference_iv",
    compare: bool = False,
    lag: str = "",
    lag_from: str = "",
    align: bool = False,
    pool_friction: str = "auto",
    terms: Sequence[str] = (),
    rotor_radius: float | None = None,
    noise: Sequence[str] = (),
) -> FlightOptions:
    """Options of the library, checked before any log is read.

    Raises
    ------
    UsageError
        When one of them does not exist or makes no sense.
    """
    from eivor.estimation.methods import by_name
    from eivor.flights.options import ACCELEROMETER_BIAS, FIT_MAP, FlightOptions
    from eivor.flights.terms import check_options

    chosen = by_name(method)
    if instruments and not (compare or chosen.of_flights.needs_instruments):
        raise UsageError(
            "--instruments with a method that has instruments, or with --compare",
            f"--instruments {instruments} with --method {method}",
            f"Leave them out: {method} uses none.",
        )
    if max_tilt is not None and not math.isfinite(max_tilt):
        max_tilt = 0.0  # refused below, in the library's words
    if accelerometer_bias is not None and input_map != FIT_MAP:
        raise UsageError(
            "--accelerometer-bias with --input-map fit, which rests on it",
            f"--input-map {input_map}" if input_map else "it alone",
            "Leave it out.",
        )
    options = FlightOptions(
        window=words.window(window) if window else None,
        input=input_channel,
        input_map=input_map,
        instruments=words.names(instruments) if instruments else (),
        method=method,
        compare=compare,
        lag=given_lag(lag, lag_from),
        align=align,
        accelerometer_bias=ACCELEROMETER_BIAS if accelerometer_bias is None else accelerometer_bias,
        pool_friction=pool_friction,
        terms=tuple(terms),
        rotor_radius=rotor_radius,
        noise=declared_noise(noise),
    )
    check_options(motion, options)
    return options if max_tilt is None else replace(options, max_tilt_deg=max_tilt)


def given_lag(text: str, file: str) -> Prior | Bounds | None:
    """Return what is known of the lag: as typed, or from another flight's JSON; None for nothing.

    Raises
    ------
    UsageError
        When both are given, or the other flight could not tell its lag.
    InputError
        When the file is no result.
    """
    from eivor.models.separable import Prior

    if text and file:
        raise UsageError("--lag or --lag-from", "both", "Leave out one of them.")
    if text:
        return words.lag(text)
    if not file:
        return None
    from eivor.flights.estimated import EFFECTIVE_LAG
    from eivor.inference.verdict import Status
    from eivor.report.read_fit import load_fit

    found = load_fit(file).quantities.get(EFFECTIVE_LAG)
    if found is None or found.verdict is Status.REFUSED or not 0.0 < found.half_width < math.inf:
        raise UsageError(
            f"a result in '{file}' that tells the effective lag",
            "one without" if found is None else f"one whose lag is {found.verdict.value}",
            "Give the lag by --lag MS:STD, or the result of a flight that tells it.",
        )
    # half a 95 % interval, the choice of the delay included, is two standard deviations at most
    return Prior(found.value, max(found.half_width / 2.0, found.std_error))
