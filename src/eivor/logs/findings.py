"""Findings that every reader draws from its channels: counts of what was set right, and implausible units.

Names: `missing_values`, `overflow`, `saturation`, `time_stamps`, `time_unit`, `mixed_units`. Nothing is
corrected here; a finding tells the reader of a result what to look at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.signals.recording import Channel, ChannelQuality, Finding

_GRAVITY = 9.80665
#: So many values of a long channel have the median of all: no more are looked at.
ENOUGH = 1 << 17
_FORCES, _PARTS, _RATES = (
    tuple(f"{family}_{member}" for member in members)
    for family, members in (("specific_force_body", "xyz"), ("attitude", "wxyz"), ("angular_rate", "xyz"))
)
#: Channels whose size is doubted.
_SIZED = frozenset({*_FORCES, *_PARTS, *_RATES, "specific_force_z", "cos_tilt"})
_Values = Mapping[str, Float[np.ndarray, " _"]]


def channel_findings(channels: Mapping[str, Channel]) -> tuple[Finding, ...]:
    """Return everything that stands out in a set of channels.

    Parameters
    ----------
    channels : mapping of str to Channel
        By canonical name, in SI units.

    Returns
    -------
    tuple of Finding
        Counts first, then doubts about units.
    """
    looks = {name: look(channel) for name, channel in channels.items()}
    return findings_of(looks, channels)


@dataclass(frozen=True, slots=True)
class Look:
    """What findings need of every channel.

    Parameters
    ----------
    quality : ChannelQuality
        What was set right.
    step_s : float
        Median step of a sampled channel, NaN where there is none [s].
    values : ndarray
        Its values where sizes are doubted, of a long channel so many that their median is that of all.
    """

    quality: ChannelQuality
    step_s: float
    values: Float[np.ndarray, " n"]


def look(channel: Channel) -> Look:
    """Look at a channel."""
    every = -(-channel.time_s.size // ENOUGH) or 1
    steps = channel.time_s[1::every] - channel.time_s[:-1:every]
    sampled = channel.time_s.size > 2 and not channel.held
    values = np.array(channel.values[::every]) if channel.name in _SIZED else np.empty(0)
    return Look(channel.quality, float(np.median(steps)) if sampled else np.nan, values)


def findings_of(looks: Mapping[str, Look], channels: Mapping[str, Channel]) -> tuple[Finding, ...]:
    """Return what `channel_findings` does, of channels that were looked at as they were made.

    Parameters
    ----------
    looks : mapping of str to Look
        By canonical name.
    channels : mapping of str to Channel
        The same, of which some are asked for.
    """
    qualities = {name: one.quality for name, one in looks.items()}
    steps = [one.step_s for one in looks.values() if np.isfinite(one.step_s)]
    return (*_count_findings(qualities), *_time_findings(steps), *_unit_findings(looks, channels))


_COUNTS: Sequence[tuple[str, Callable[[ChannelQuality], int], str]] = (
    ("missing_values", lambda q: q.missing_values, "samples without a value"),
    ("overflow", lambda q: q.overflowed, "samples outside the channel's possible range, set to missing"),
    ("saturation", lambda q: q.saturated, "samples at the bound of the channel's range"),
    (
        "time_stamps",
        lambda q: q.duplicated_stamps + q.backward_stamps,
        "samples dropped, because their stamp repeats or goes backward",
    ),
    (
        "time_stamps",
        lambda q: q.evened_stamps,
        "samples whose stamps go back and forth, which were evened",
    ),
)


def _count_findings(qualities: Mapping[str, ChannelQuality]) -> list[Finding]:
    findings = []
    for name, count, meaning in _COUNTS:
        concerned = [
            f"{key} {count(quality)}"
            for key, quality in qualities.items()
            # a setpoint without a value is one that is not in force, hence nothing to report
            if count(quality) and not (name == "missing_values" and "reference_" in key)
        ]
        if concerned:
            findings.append(Finding(name, f"{meaning[0].upper()}{meaning[1:]}: {', '.join(concerned)}."))
    return findings


def _time_findings(steps: Sequence[float]) -> list[Finding]:
    """Doubt about the unit of the clock: a flight is sampled between once per second and 100 kHz."""
    if not steps:
        return []
    step = min(steps)
    if 1e-5 <= step <= 1.0:
        return []
    return [
        Finding(
            "time_unit",
            f"The fastest sampled channel has a median step of {step:.3g} s; check the unit of its clock.",
        )
    ]


def _unit_findings(looks: Mapping[str, Look], channels: Mapping[str, Channel]) -> list[Finding]:
    values = {name: one.values for name, one in looks.items() if name in _SIZED}
    doubts = [
        *_force_doubts(values),
        *_attitude_doubts(values),
        *_rate_doubts(values),
        *_velocity_doubts(channels),
    ]
    return [Finding("mixed_units", doubt) for doubt in doubts]


def _median(values: Float[np.ndarray, " n"]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _norm(values: _Values, names: Sequence[str]) -> Float[np.ndarray, " n"] | None:
    """Norm of channels that share one clock; None when one is absent or the lengths differ."""
    parts = [values[name] for name in names if name in values]
    if len(parts) < len(names) or len({part.size for part in parts}) > 1 or not parts[0].size:
        return None
    return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))


def _force_doubts(values: _Values) -> list[str]:
    """Doubt a median specific force other than one g: that of rest, of hover and of most flights."""
    doubts = []
    body = _norm(values, _FORCES)
    candidates = [
        ("The norm of specific_force_body", body),
        ("specific_force_z", values.get("specific_force_z")),
    ]
    for label, force in candidates:
        if force is None:
            continue
        median = abs(_median(force))
        if 0.8 < median < 1.25:
            doubts.append(f"{label} has a median of {median:.3g} m/s^2, which looks like a value in g.")
        elif 800.0 < median < 1250.0:
            doubts.append(f"{label} has a median of {median:.4g} m/s^2, which looks like a value in milli-g.")
        elif median < 0.5 * _GRAVITY or median > 2.0 * _GRAVITY:
            doubts.append(f"{label} has a median of {median:.3g} m/s^2, where about 9.8 is expected.")
    return doubts


def _attitude_doubts(values: _Values) -> list[str]:
    doubts = []
    norm = _norm(values, _PARTS)
    if norm is not None and abs(_median(norm) - 1.0) > 0.05:
        doubts.append(f"The attitude quaternion has a median norm of {_median(norm):.3g} instead of 1.")
    tilt = values.get("cos_tilt")
    if tilt is not None and np.any(np.abs(tilt) > 1.0 + 1e-6):
        doubts.append("cos_tilt leaves [-1, 1]; is it an angle?")
    return doubts


def _rate_doubts(values: _Values) -> list[str]:
    """No gyro of a drone measures 35 rad/s (2000 deg/s) for more than a moment."""
    fast = [name for name in _RATES if name in values and _median(np.abs(values[name])) > 10.0]
    return [f"Typical values of {', '.join(fast)} are above 10 rad/s; are they in deg/s?"] if fast else []


def _velocity_doubts(channels: Mapping[str, Channel]) -> list[str]:
    """Doubt a vertical velocity that is not the slope of the position, in size and in sign."""
    position, velocity = channels.get("position_z"), channels.get("velocity_z")
    if position is None or velocity is None or not np.array_equal(position.time_s, velocity.time_s):
        return []
    both = np.isfinite(position.values) & np.isfinite(velocity.values)
    if both.sum() < 20:
        return []
    z, v, t = position.values[both], velocity.values[both], position.time_s[both]
    slope = np.diff(z) / np.diff(t)
    middle = 0.5 * (v[1:] + v[:-1])
    if np.std(slope) == 0.0 or np.std(middle) == 0.0:
        return []
    if abs(float(np.corrcoef(slope, middle)[0, 1])) < 0.9:
        return []
    ratio = float(np.std(middle) / np.std(slope)) * float(np.sign(np.corrcoef(slope, middle)[0, 1]))
    if 0.5 < ratio < 2.0:
        return []
    return [f"velocity_z is {ratio:.3g} times the slope of position_z; check their units and signs."]
