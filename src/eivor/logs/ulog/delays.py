"""How much later than its sample a PX4 topic is stamped: filters, means over an interval, the way to the log.

As PX4's modules do it (`sensors`, `ekf2`):

* `vehicle_acceleration` is behind a Butterworth low-pass of the second order at IMU_ACCEL_CUTOFF, and notches
  (IMU_ACC_NF0_*, IMU_ACC_NF1_*); `vehicle_angular_velocity` behind one at IMU_GYRO_CUTOFF, and notches
  (IMU_GYRO_NF0_*, IMU_GYRO_NF1_*; before 1.13 IMU_GYRO_NF_*). Far below its cutoff f_c such a low-pass is
  late by sqrt(2) / (2 pi f_c), a notch of frequency f and bandwidth B by B / (2 pi f^2).
* `sensor_combined` has neither: it is the mean over an interval that ends with its stamp, late by half of it.
* Topics that say when their sample was taken (`timestamp_sample`) are stamped when they are published.

Notches that follow the rotors are not known from parameters; theirs is left.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from eivor.logs.delays import low_pass_delay_s, notch_delay_s
from eivor.logs.ulog.instances import Topic
from eivor.signals.recording import Channel, Finding

#: Topics that are measured, whose stamp is that of publication.
SAMPLED = ("vehicle_local_position", "vehicle_acceleration", "vehicle_angular_velocity", "vehicle_attitude")
#: Parameters of low-passes and of notches (frequency, bandwidth), by topic.
LOW_PASSES: Mapping[str, str] = {
    "vehicle_acceleration": "IMU_ACCEL_CUTOFF",
    "vehicle_angular_velocity": "IMU_GYRO_CUTOFF",
}
NOTCHES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "vehicle_acceleration": tuple((f"IMU_ACC_NF{n}_FRQ", f"IMU_ACC_NF{n}_BW") for n in (0, 1)),
    "vehicle_angular_velocity": (
        *((f"IMU_GYRO_NF{n}_FRQ", f"IMU_GYRO_NF{n}_BW") for n in (0, 1)),
        ("IMU_GYRO_NF_FREQ", "IMU_GYRO_NF_BW"),
    ),
}
#: Means over an interval, by topic, and the field that holds its length [us; in old logs s].
MEANS: Mapping[str, str] = {"sensor_combined": "accelerometer_integral_dt"}
#: Longer ways from sample to stamp are those of another clock [s].
LONGEST_WAY_S = 0.02
#: Longer intervals are no means of an inertial sensor [s].
LONGEST_MEAN_S = 0.02


@dataclass(frozen=True, slots=True)
class Delay:
    """One cause of a topic's delay.

    Parameters
    ----------
    seconds : float
        How much later than what it tells its stamp is [s].
    cause : str
        What makes it.
    """

    seconds: float
    cause: str


def topic_delays(topic: Topic, parameters: Mapping[str, float]) -> tuple[Delay, ...]:
    """Known delays of a topic, each with its cause; none for most topics."""
    return tuple(delay for delay in _delays(topic, parameters) if delay.seconds > 0.0)


def _delays(topic: Topic, parameters: Mapping[str, float]) -> Iterator[Delay]:
    cutoff = parameters.get(LOW_PASSES.get(topic.name, ""), 0.0)
    if cutoff > 0.0:
        cause = f"low-pass of {cutoff:g} Hz, {LOW_PASSES[topic.name]}"
        yield Delay(low_pass_delay_s(cutoff), cause)
    for frequency_name, width_name in NOTCHES.get(topic.name, ()):
        frequency, width = parameters.get(frequency_name, 0.0), parameters.get(width_name, 0.0)
        if frequency > 0.0 and width > 0.0:
            cause = f"notch at {frequency:g} Hz, {frequency_name}"
            yield Delay(notch_delay_s(frequency, width), cause)
    if topic.name in MEANS:
        length = _mean_length(topic)
        yield Delay(0.5 * length, f"half of the {1e3 * length:.3g} ms of which it is the mean")
    if topic.name in SAMPLED:
        yield Delay(_way(topic), "from its sample to its stamp")


def _mean_length(topic: Topic) -> float:
    """Median length of the intervals of a topic of means [s]; 0 when it does not say."""
    lengths = topic.fields.get(MEANS[topic.name])
    if lengths is None or not lengths.size:
        return 0.0
    length = float(np.median(lengths))
    length *= 1.0 if length < 1.0 else 1e-6
    return length if 0.0 < length <= LONGEST_MEAN_S else 0.0


def _way(topic: Topic) -> float:
    """Median time from sample to stamp [s]; 0 when it is not known, or of another clock."""
    sampled = topic.fields.get("timestamp_sample")
    if sampled is None or not sampled.size or sampled.dtype.kind not in "iu":
        return 0.0
    with np.errstate(over="ignore"):
        ticks = (topic.fields["timestamp"].astype(np.uint64) - sampled.astype(np.uint64)).view(np.int64)
    way = 1e-6 * float(np.median(ticks))
    return way if 0.0 < way <= LONGEST_WAY_S else 0.0


def delay_findings(channels: Iterable[Channel], delays: Mapping[str, tuple[Delay, ...]]) -> list[Finding]:
    """Say what was taken off the stamps of the topics that channels come from."""
    used = {channel.source.lstrip("-").partition(".")[0] for channel in channels if channel.delay_s}
    told = [
        f"{name}: {1e3 * sum(one.seconds for one in delays[name]):.2g} ms "
        f"({', '.join(one.cause for one in delays[name])})"
        for name in sorted(used)
    ]
    return [Finding("sensor_delay", f"Taken off the stamps of {'; '.join(told)}.")] if told else []


def unknown_filters(channels: Iterable[Channel], holder: str) -> list[Finding]:
    """Say that delays of filters are not known where the parameters are not.

    Parameters
    ----------
    channels : iterable of Channel
        Of the log.
    holder : str
        What holds no parameters: "A bag holds".
    """
    if not any(channel.source.lstrip("-").partition(".")[0] in LOW_PASSES for channel in channels):
        return []
    sentence = (
        f"{holder} no parameters: cutoffs of the filters of accelerations and rates "
        f"({', '.join(LOW_PASSES.values())}) are not known, and their delay is not taken off. The vehicle's "
        "own ULog has them."
    )
    return [Finding("sensor_delay", sentence)]
