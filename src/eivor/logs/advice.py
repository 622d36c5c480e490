"""What to log so that a flight can be identified: the sentences for a flight card."""

from __future__ import annotations

from eivor.errors import UsageError
from eivor.logs.ulog_topics import (
    CHANNEL_SOURCES,
    EXTRA_TOPIC_LINES,
    PROFILE_BITS,
    TOPIC_LOGGING,
    TopicLogging,
)


def logging_advice(log_format: str = "ulog", channel: str = "") -> tuple[str, ...]:
    """Sentences that say what to log.

    Parameters
    ----------
    log_format : str
        "ulog" (PX4), "csv" or "parquet".
    channel : str
        A canonical channel: only the advice for it; empty for the advice on the whole flight.

    Returns
    -------
    tuple of str
        Whole sentences, the most important first. Empty when nothing is known about `channel`.

    Raises
    ------
    UsageError
        When nothing is known about the format.
    """
    if log_format in ("csv", "parquet"):
        return _TABLE_ADVICE if not channel else (f"Add a column '{channel}', or map one in a channel map.",)
    if log_format != "ulog":
        raise UsageError(
            "a log format: 'ulog', 'csv' or 'parquet'", f"'{log_format}'", "Name one of these formats."
        )
    if not channel:
        return _PX4_ADVICE
    topics = list(dict.fromkeys(source.topic for source in CHANNEL_SOURCES.get(channel, ())))
    known = {entry.topic: entry for entry in TOPIC_LOGGING}
    return tuple(_topic_sentence(known[topic]) for topic in topics if topic in known)


def _topic_sentence(entry: TopicLogging) -> str:
    """Say at which rate PX4 logs a topic, and what raises it."""
    rate = "at every message" if entry.default_rate_hz == float("inf") else f"at {entry.default_rate_hz:g} Hz"
    sentence = f"PX4's default profile (SDLOG_PROFILE bit 0) logs {entry.topic} {rate}"
    raising = [bit for bit in entry.full_rate_bits if bit != 0]
    if raising and entry.default_rate_hz != float("inf"):
        bits = " or ".join(f"bit {bit} ({PROFILE_BITS[bit]})" for bit in raising)
        return f"{sentence}; {bits} logs it at its full rate."
    return f"{sentence}."


_PX4_ADVICE = (
    "Set SDLOG_PROFILE to 25: bit 0 (default set), bit 3 (system identification: accelerations, rates and "
    "motor commands at full rate) and bit 4 (high rate: thrust setpoint, attitude and stick at full rate).",
    "No profile bit raises the rate of the position estimate and of its setpoints above 10 Hz: copy "
    "etc/logging/logger_topics.txt onto the card, with the topics of the profile and the lines "
    + ", ".join(f"'{line}'" for line in EXTRA_TOPIC_LINES)
    + " (topic, interval in ms). That file replaces the profile.",
    "Fly altitude steps, so that the height reference changes: a hover cannot be identified.",
)

_TABLE_ADVICE = (
    "Log at 100 Hz or more, one row per instant, with a column 'time' in seconds.",
    "Log the motor commands (not only the thrust setpoint), the vertical velocity, the specific force or the "
    "vertical acceleration, the attitude, and the height reference.",
    "Log setpoints as they are commanded, not filtered or interpolated.",
)
