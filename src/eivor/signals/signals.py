"""Signals on a time grid, with their noises."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from eivor import checks
from eivor.errors import DataError, MissingChannelError, NonFiniteError, ShapeError, UsageError
from eivor.signals.channels import family_members
from eivor.signals.noise import MeasurementNoise
from eivor.tools import Bool, Float


@dataclass(frozen=True)
class Signals:
    """Channels sampled together at a uniform rate.

    Raises
    ------
    ShapeError
        When there is no channel, or channels or mask differ in length.
    DataError
        When there are complex numbers, texts or dates among the values.
    UsageError
        When a noise is declared for a channel that is not there, or an argument is of another type.
    NonFiniteError
        When the rate is not positive and finite, the start not finite or the offset negative, or a channel
        is not finite at a valid sample.
    """

    rate_hz: float  # Samples per second [Hz]
    #: Canonical names to values of shape (n,) in SI units, z up, converted to double precision; what a mask
    #: hides counts as NaN. Nothing is modified in place.
    channels: Mapping[str, Float[np.ndarray, " n"]]
    #: Measurement noise by channel. A channel that is not named has no declared noise, which is not none
    noise: Mapping[str, MeasurementNoise] = field(default_factory=dict)
    valid: Bool[np.ndarray, " n"] | None = None  # Samples that may be used, shape (n,); default: all
    start_s: float = 0.0  # Time of the first sample on the log's clock [s]
    #: Samples of the same record before the first one, which noises that started with the record need
    offset: int = 0

    def __post_init__(self) -> None:
        checks.number("rate_hz", self.rate_hz)
        checks.number("start_s", self.start_s)
        checks.whole("offset", self.offset)
        checks.mapping("channels", self.channels, object, "values")
        checks.mapping("noise", self.noise, MeasurementNoise, "noises")
        if not 0.0 < self.rate_hz < math.inf:
            remedy = "Give the number of samples per second."
            raise NonFiniteError("a positive rate in Hz", f"rate_hz={self.rate_hz}", remedy)
        if not math.isfinite(self.start_s) or self.offset < 0:
            expected = "a finite start, and an offset of zero samples or more"
            received = f"start_s={self.start_s}, offset={self.offset}"
            raise NonFiniteError(expected, received, "Leave them out where they are not known.")
        converted = {
            name: checks.real_array(f"channel '{name}'", values) for name, values in self.channels.items()
        }
        mask = None if self.valid is None else _mask(self.valid)
        shapes = {values.shape for values in (*converted.values(), *(() if mask is None else (mask,)))}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1 or not converted:
            expected = "at least one channel, and one-dimensional channels and mask of equal length"
            lengths = {name: values.shape for name, values in converted.items()}
            received = f"shapes {lengths}" + ("" if mask is None else f" and a mask of shape {mask.shape}")
            raise ShapeError(expected, received, "Resample every channel to one grid first.")
        unknown = [name for name in self.noise if name not in converted]
        if unknown:
            expected = f"noise of the channels {', '.join(converted)}"
            received = f"noise of {', '.join(repr(name) for name in unknown)}"
            raise UsageError(expected, received, "Name channels that are there.")
        with np.errstate(invalid="ignore", over="ignore"):
            # the sum of finite values is finite almost always, and costs no copy
            doubtful = {name: values for name, values in converted.items() if not math.isfinite(values.sum())}
        for name, values in doubtful.items():
            bad = ~np.isfinite(values) if mask is None else ~np.isfinite(values) & mask
            if bad.any():
                raise NonFiniteError(
                    f"finite values in channel '{name}' at every valid sample",
                    f"{int(bad.sum())} that are NaN or infinite, the first at sample {int(np.argmax(bad))}",
                    "Mark those samples as not valid, or repair them.",
                )
        object.__setattr__(self, "channels", converted)
        object.__setattr__(self, "valid", mask)

    @property
    def sample_count(self) -> int:
        """Number of samples on the grid, valid or not."""
        return int(next(iter(self.channels.values())).size)

    @property
    def step_s(self) -> float:
        """Time between samples [s]."""
        return 1.0 / self.rate_hz

    def channel(self, name: str) -> Float[np.ndarray, " n"]:
        """Values of the channel called `name`; a `MissingChannelError` when there is none."""
        checks.text("a channel", name)
        if name not in self.channels:
            expected = f"a channel called '{name}'"
            received = f"channels {', '.join(sorted(self.channels))}"
            raise MissingChannelError(expected, received, "Add it, or name another channel.")
        return self.channels[name]

    def family(self, name: str) -> Float[np.ndarray, "n members"]:
        """Channels of a family as contiguous columns, see `family_members`; none gives zero columns."""
        members = family_members(name, self.channels)
        if not members:
            return np.empty((self.sample_count, 0))
        return np.stack([self.channels[member] for member in members]).T


def stretches(mask: Bool[np.ndarray, " n"]) -> list[slice]:
    """Contiguous stretches of true samples, in order. Performs no checks."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [slice(first, stop) for first, stop in zip(*[iter(edges.tolist())] * 2, strict=True)]


def _mask(valid: object) -> Bool[np.ndarray, "*shape"]:
    """Mask of the samples that count; those that its own mask hides do not."""
    mask = np.ma.filled(valid, False) if np.ma.isMaskedArray(valid) else np.asarray(valid)
    if mask.dtype == np.bool_:
        return mask
    if mask.dtype.kind not in "iu" or not np.isin(mask, (0, 1)).all():
        expected = "a mask of True and False for valid"
        raise DataError(expected, f"values of the type {mask.dtype}", "Compare first: x > 0.")
    return np.asarray(mask, dtype=np.bool_)
