"""How much later than its sample an ArduPilot's inertial measurement is: its low-pass, and a fixed notch.

IMU and the rates of RATE are what the vehicle is flown by, behind a low-pass of the second order at
INS_ACCEL_FILTER or INS_GYRO_FILTER, the gyro also behind the notch of INS_NOTCH_FREQ and INS_NOTCH_BW where
INS_NOTCH_ENABLE is set. Notches that follow the rotors are not known from parameters; theirs is left.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from eivor.logs.delays import low_pass_delay_s, notch_delay_s
from eivor.signals.recording import Channel, Finding

#: Parameter of the low-pass, by the beginning of a channel's name.
LOW_PASSES = {"specific_force_body": "INS_ACCEL_FILTER", "angular_rate": "INS_GYRO_FILTER"}


def delay_of(channel: str, parameters: Mapping[str, float]) -> float:
    """Delay of a channel [s], zero where none is known.

    Parameters
    ----------
    channel : str
        Canonical name.
    parameters : mapping of str to float
        Of the log.
    """
    family = channel.rpartition("_")[0]
    cutoff = parameters.get(LOW_PASSES.get(family, ""), 0.0)
    delay = low_pass_delay_s(cutoff) if cutoff > 0.0 else 0.0
    if family == "angular_rate" and parameters.get("INS_NOTCH_ENABLE", 0.0) > 0.0:
        frequency, width = parameters.get("INS_NOTCH_FREQ", 0.0), parameters.get("INS_NOTCH_BW", 0.0)
        delay += notch_delay_s(frequency, width) if frequency > 0.0 and width > 0.0 else 0.0
    return delay


def delay_findings(channels: Iterable[Channel], parameters: Mapping[str, float]) -> list[Finding]:
    """Say what was taken off the stamps, and why."""
    told = {}
    for channel in channels:
        if channel.delay_s > 0.0:
            name = LOW_PASSES[channel.name.rpartition("_")[0]]
            words = f"low-pass of {parameters[name]:g} Hz, {name}" if name in parameters else "notch"
            told[channel.source.partition(".")[0], words] = 1e3 * channel.delay_s
    if not told:
        return []
    sentence = "; ".join(f"{message}: {delay:.2g} ms ({words})" for (message, words), delay in told.items())
    return [Finding("sensor_delay", f"Taken off the stamps of {sentence}.")]
