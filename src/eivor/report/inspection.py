"""What a log holds, and what `identify` would say about it: found by running it, not by guessing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.errors import EivorError
from eivor.flights.options import FlightOptions
from eivor.flights.recipe import identify_flight
from eivor.flights.result import FlightEstimate
from eivor.report.card import logging_advice_for, missing_channels
from eivor.signals.recording import Channel, Recording

#: Logged parameters worth showing: the hover input, the thrust curve, the vehicle, its limits of climb.
SHOWN_PARAMETERS = (
    "MPC_THR_HOVER",
    "MOT_THST_HOVER",
    "THR_MDL_FAC",
    "MPC_THR_MIN",
    "MPC_THR_MAX",
    "MPC_Z_VEL_MAX_UP",
    "MPC_Z_VEL_MAX_DN",
    "SYS_AUTOSTART",
    "CA_ROTOR_COUNT",
    "SDLOG_PROFILE",
)


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """One channel in numbers.

    Parameters
    ----------
    channel : Channel
        The channel.
    lowest, highest : float
        Range of its values in its unit; NaN when it has none.
    gaps : tuple of (start, end)
        Intervals without a sample [s].
    """

    channel: Channel
    lowest: float
    highest: float
    gaps: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Inspection:
    """A log, and what can be made of it.

    Parameters
    ----------
    recording : Recording
        The log.
    channels : tuple of ChannelSummary
        In the order of their names.
    result : FlightEstimate or None
        What `identify` says; None when it cannot even begin.
    obstacle : EivorError or None
        Why it cannot.
    missing : tuple of str
        Channels without which nothing can be identified, and that the log lacks.
    advice : tuple of str
        How to log them.
    """

    recording: Recording
    channels: tuple[ChannelSummary, ...]
    result: FlightEstimate | None
    obstacle: EivorError | None
    missing: tuple[str, ...]
    advice: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """The verdict that `identify` gives, "unusable" when it cannot begin."""
        return "unusable" if self.result is None else self.result.verdict.status.value

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons of that verdict."""
        if self.result is not None:
            return self.result.verdict.sentences
        return (str(self.obstacle),) if self.obstacle is not None else ()

    @property
    def parameters(self) -> dict[str, float]:
        """Logged parameters worth showing."""
        logged = self.recording.parameters
        return {name: logged[name] for name in SHOWN_PARAMETERS if name in logged}


def inspection(recording: Recording, options: FlightOptions) -> Inspection:
    """Inspect a log; never raises for what the log lacks.

    Parameters
    ----------
    recording : Recording
        From `read_log`.
    options : FlightOptions
        What to run `identify_flight` with.
    """
    result, obstacle = None, None
    try:
        result = identify_flight(recording, options)
    except EivorError as error:
        obstacle = error
    missing = missing_channels(recording)
    advice = [sentence for name in missing for sentence in logging_advice_for(recording, name)]
    return Inspection(
        recording,
        tuple(_summary(recording.channels[name]) for name in sorted(recording.channels)),
        result,
        obstacle,
        missing,
        tuple(dict.fromkeys(advice)),
    )


def _summary(channel: Channel) -> ChannelSummary:
    finite = channel.values[np.isfinite(channel.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (float("nan"), float("nan"))
    # a held channel may rest: silence is no gap in it
    gaps = () if channel.held and channel.rate_hz < 1.0 else tuple(channel.gaps())
    return ChannelSummary(channel, low, high, gaps)


def stretches(mask: np.ndarray, start_s: float, step_s: float) -> list[tuple[float, float]]:
    """First and last second of each stretch of true samples [s]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [
        (start_s + step_s * float(first), start_s + step_s * float(last - 1))
        for first, last in zip(edges[::2], edges[1::2], strict=True)
    ]
