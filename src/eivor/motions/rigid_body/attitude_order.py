"""Attitudes whose quaternion is written in another way than its channels say, as body rates tell.

An attitude turns as the gyroscope says: 2 conj(q) q' = (0, p, q, r). Quaternions with the scalar last, or
from world to body, have length one all the same, and turn otherwise. Rates in degrees turn 57 times too far,
of calm flights too, in which none is larger than a vehicle's may be in radians.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eivor.errors import InputError
from eivor.shapes import Float
from eivor.signals.recording import Channel

#: Over which turning is looked at [s]: longer than a sensor's noise, shorter than a turn.
OVER_S = 0.04
#: What is left of the rates, as a share of them: by a wrong order more than the one, by the right one less
#: than the other.
WRONG, RIGHT = 0.8, 0.5
#: Orders that attitudes are written in, by the signed place of w, x, y, z among the logged four.
ORDERS = {
    "x, y, z, w": ((3, 1), (0, 1), (1, 1), (2, 1)),
    "w, x, y, z from world to body": ((0, 1), (1, -1), (2, -1), (3, -1)),
    "x, y, z, w from world to body": ((3, 1), (0, -1), (1, -1), (2, -1)),
}
AS_NAMED = ((0, 1), (1, 1), (2, 1), (3, 1))


def refuse_other_turns(attitude: Sequence[Channel], rates: Sequence[Channel], log_name: str) -> None:
    """Refuse an attitude that turns otherwise than the gyroscope says, where another order or unit does.

    Parameters
    ----------
    attitude : sequence of Channel
        w, x, y, z, with the stamps of the first.
    rates : sequence of Channel
        About x, y, z of the body.
    log_name : str
        Of the log.

    Raises
    ------
    InputError
        With the order that fits, or when the rates are in degrees.
    """
    time = attitude[0].time_s
    if len({one.values.size for one in attitude}) != 1:
        return
    logged = continuous(np.stack([one.values for one in attitude]))
    known = np.isfinite(logged).all(axis=0)
    time, logged = time[known], logged[:, known]
    if time.size < 2:
        return
    apart = max(1, round(OVER_S / float(np.median(np.diff(time)))))
    if time.size <= 2 * apart:
        return
    turned = np.stack([_turned(one, time) for one in rates])
    width = np.maximum(time[apart:] - time[:-apart], 1e-9)
    measured = (turned[:, apart:] - turned[:, :-apart]) / width
    size = float(np.sqrt(np.mean(measured**2)))
    if not size > 0.0:
        return

    def left(order: Sequence[tuple[int, int]]) -> float:
        parts = np.stack([sign * logged[place] for place, sign in order])
        return float(np.sqrt(np.mean((_rates_of(parts, apart) / width - measured) ** 2))) / size

    if left(AS_NAMED) <= WRONG:
        return
    by_attitude = _rates_of(logged, apart) / width
    degrees = float(np.sqrt(np.mean((by_attitude - np.deg2rad(measured)) ** 2)))
    if degrees < RIGHT * np.deg2rad(size):
        raise InputError(
            f"body rates in rad/s in {log_name}",
            f"{rates[0].name} and others that turn 57 times as fast as the attitude, which look like degrees",
            'State the unit in a channel map (unit = "deg/s").',
        )
    found = {name: left(order) for name, order in ORDERS.items()}
    best = min(found, key=lambda name: found[name])
    if found[best] < RIGHT:
        raise InputError(
            f"an attitude w, x, y, z from body to world in {log_name}",
            f"one that turns as the gyroscope says only when it is read as {best}",
            "Map its four parts in this order, with the signs that turn it from body to world.",
        )


def continuous(parts: Float[np.ndarray, "4 n"]) -> Float[np.ndarray, "4 n"]:
    """The same attitudes without jumps to the opposite quaternion, which is the same attitude."""
    known = np.flatnonzero(np.isfinite(parts).all(axis=0))
    found = parts.copy()
    if known.size > 1:
        along = (parts[:, known[1:]] * parts[:, known[:-1]]).sum(axis=0)
        found[:, known[1:]] *= np.cumprod(np.where(along < 0.0, -1.0, 1.0))
    return found


def _turned(rate: Channel, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Angle by which a rate has turned at times, from some time on [rad]."""
    known = np.isfinite(rate.values)
    t, values = rate.time_s[known], rate.values[known]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
    return np.interp(time_s, t, angle)


def _rates_of(parts: Float[np.ndarray, "4 n"], apart: int) -> Float[np.ndarray, "3 m"]:
    """Small turns on the body's axes between attitudes so many samples apart [rad]."""
    (a, b, c, d), (w, x, y, z) = parts[:, :-apart], parts[:, apart:]
    return 2.0 * np.stack(
        [a * x - b * w - c * z + d * y, a * y + b * z - c * w - d * x, a * z - b * y + c * x - d * w]
    )
