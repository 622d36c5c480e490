"""Channels of PX4's topics, whatever they were logged in: a ULog, or messages of `px4_msgs` in a bag.

Axes are as PX4 has them: z down (`Frame.NED`). One channel is turned: `input` is positive up, whatever the
sign of the topic it comes from. A channel's stamps are the topic's `timestamp`, less what it is known to be
later than its sample (`eivor.logs.ulog.delays`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from eivor.logs.silences import silenced
from eivor.logs.ulog.attitude_setpoints import attitude_setpoints
from eivor.logs.ulog.delays import delay_findings, topic_delays
from eivor.logs.ulog.instances import Topic, place_of, varying_fields
from eivor.logs.ulog.pulse_widths import are_pulses, as_shares
from eivor.logs.ulog.topics import (
    ACTUATOR_SOURCES,
    ATTITUDE_STATES,
    CHANNEL_SOURCES,
    CHOSEN_BY_RATE,
    CONTROLLER_POSITION,
    CONTROLLER_VELOCITY,
    ESC_FUNCTION,
    ESC_SPEED,
    ESC_TOPIC,
    FIRST_MOTOR_FUNCTION,
    MAX_ESCS,
    NAVIGATION_STATE,
    OPEN_LOOP_STATES,
    PILOT_STATES,
    PULSES_TOPIC,
    RATE_STATES,
    RESET_COUNTERS,
    Source,
)
from eivor.logs.units import UNITS
from eivor.shapes import Bool, Float
from eivor.signals.canonical import CurveSide, held_by_default, unit_of
from eivor.signals.recording import Channel, Finding, clean_channel

#: Stamps further than this from the log's start are damaged [s].
MAX_SPAN_S = 1e6
#: Another source comes before the preferred one when it was logged so many times as often.
MUCH_MORE = 1.5


@dataclass(slots=True)
class _Reading:
    """The state of one reading: topics in, channels and findings out."""

    topics: Mapping[str, Topic]
    delays_s: Mapping[str, float]
    end_s: float
    channels: dict[str, Channel]
    findings: list[Finding]
    silent: list[str]
    never_valid: list[str]


def read_topics(
    topics: Mapping[str, Topic], start: np.uint64, parameters: Mapping[str, float], findings: list[Finding]
) -> dict[str, Channel]:
    """Return all channels that topics hold.

    Parameters
    ----------
    topics : mapping of str to Topic
        One instance of each, by name.
    start : uint64
        Stamp of time 0 [us].
    parameters : mapping of str to float
        Of the vehicle, as far as they are known.
    findings : list of Finding
        Gets what is found.
    """
    delays = {name: topic_delays(topic, parameters) for name, topic in topics.items()}
    late = {name: sum((one.seconds for one in causes), 0.0) for name, causes in delays.items()}
    clocks = {name: _seconds(topic.fields["timestamp"], start) - late[name] for name, topic in topics.items()}
    ends = [float(np.nanmax(clock)) for clock in clocks.values() if np.isfinite(clock).any()]
    reading = _Reading(topics, late, max(ends, default=0.0), {}, findings, [], [])
    for name, sources in CHANNEL_SOURCES.items():
        for source in _by_rate(sources, topics) if name in CHOSEN_BY_RATE else sources:
            if name not in reading.channels:
                _add(reading, clocks, name, source)
    _add_controller_velocity(reading, clocks)
    _add_modes(reading, clocks)
    _add_attitude_setpoints(reading, clocks)
    _add_actuators(reading, clocks, parameters)
    _add_rotor_speeds(reading, clocks)
    findings += _reset_findings(reading, clocks)
    findings += delay_findings(reading.channels.values(), delays)
    if reading.never_valid:
        findings.append(
            Finding("never_valid", f"Logged without one valid value: {', '.join(reading.never_valid)}.")
        )
    if reading.silent:
        findings.append(
            Finding(
                "setpoint_silent", f"Not in force while its topic is silent: {', '.join(reading.silent)}."
            )
        )
    return reading.channels


def _by_rate(sources: tuple[Source, ...], topics: Mapping[str, Topic]) -> list[Source]:
    """Sources in their order, but one that was logged much more often than the first before it."""

    def samples(source: Source) -> int:
        topic = topics.get(source.topic)
        return 0 if topic is None else int(topic.fields["timestamp"].size)

    most = max(sources, key=samples)
    first = next((source for source in sources if samples(source)), most)
    return (
        sorted(sources, key=lambda one: one is not most)
        if samples(most) > MUCH_MORE * samples(first)
        else [*sources]
    )


def _reset_findings(reading: _Reading, clocks: Mapping[str, Float[np.ndarray, " _"]]) -> list[Finding]:
    """Jumps of the estimate, which are no motion: where a counter of the estimator's resets moves."""
    topic = reading.topics.get("vehicle_local_position")
    findings = []
    fields = topic.fields if topic is not None else {}
    for field, meaning in RESET_COUNTERS.items():
        if field not in fields:
            continue
        counts = fields[field]
        times = clocks["vehicle_local_position"][1:][counts[1:] != counts[:-1]]
        if times.size:
            shown = ", ".join(f"{time:.2f}" for time in times[:10]) + (", ..." if times.size > 10 else "")
            findings.append(Finding("estimator_reset", f"The estimate of {meaning} jumps at {shown} s."))
    return findings


def _seconds(stamps: np.ndarray, start: np.uint64) -> Float[np.ndarray, " n"]:
    """Seconds since the log's start; NaN for stamps that cannot be."""
    with np.errstate(over="ignore"):
        ticks = (stamps.astype(np.uint64) - start).view(np.int64)
    time = ticks.astype(np.float64) * 1e-6
    time[np.abs(time) > MAX_SPAN_S] = np.nan
    return time


def _values(topic: Topic, source: Source) -> Float[np.ndarray, " n"] | None:
    """Values of a source, NaN where invalid; None when the log has no such field."""
    if source.field not in topic.fields:
        return None
    values = source.sign * topic.fields[source.field].astype(np.float64)
    if source.valid_field in topic.fields:
        values[topic.fields[source.valid_field] == 0] = np.nan
    return values


def _add(
    reading: _Reading,
    clocks: Mapping[str, Float[np.ndarray, " _"]],
    name: str,
    source: Source,
    where: Bool[np.ndarray, " n"] | None = None,
) -> None:
    """Add a channel from a source, when that has a valid value (among the samples `where`)."""
    topic = reading.topics.get(source.topic)
    values = _values(topic, source) if topic is not None else None
    if values is None:
        return
    if where is not None:
        values[~where] = np.nan
    elif not np.isfinite(values).any():
        reading.never_valid.append(source.label)
    if not np.isfinite(values).any() or (source.zero_is_absent and not np.any(np.nan_to_num(values))):
        return
    channel = replace(
        _channel(name, clocks[source.topic], values, source.label),
        estimated=source.estimated,
        delay_s=reading.delays_s[source.topic],
        curve_side=CurveSide.BEFORE if name == "input" else CurveSide.UNKNOWN,
    )
    if channel.time_s.size == 0:
        return
    if source.is_setpoint:
        until = silenced(channel, reading.end_s)
        if until.time_s.size > channel.time_s.size:
            reading.silent.append(name)
        channel = until
    reading.channels[name] = channel


def _channel(
    name: str,
    time_s: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    label: str,
    curve_side: CurveSide = CurveSide.UNKNOWN,
) -> Channel:
    return clean_channel(
        name,
        time_s,
        values,
        unit_of(name),
        source=label,
        held=held_by_default(name),
        curve_side=curve_side,
    )


def _add_controller_velocity(reading: _Reading, clocks: Mapping[str, Float[np.ndarray, " _"]]) -> None:
    """Add the controller's velocity setpoint: feedback under a height setpoint, else a climb rate."""
    topic = reading.topics.get(CONTROLLER_VELOCITY.topic)
    heights = _values(topic, CONTROLLER_POSITION) if topic is not None else None
    if heights is None:
        return
    in_force = np.isfinite(heights)
    _add(reading, clocks, "feedback_reference_velocity_z", CONTROLLER_VELOCITY, in_force)
    if "trajectory_setpoint" not in reading.topics:
        _add(reading, clocks, "reference_velocity_z", CONTROLLER_VELOCITY, ~in_force)


def _add_modes(reading: _Reading, clocks: Mapping[str, Float[np.ndarray, " _"]]) -> None:
    """Add when a pilot flies, when no loop acts on the thrust, and when sticks set attitude or rates."""
    topic = reading.topics.get(NAVIGATION_STATE.topic)
    states = _values(topic, NAVIGATION_STATE) if topic is not None else None
    if states is None:
        return
    modes = {
        "pilot_in_control": PILOT_STATES,
        "input_open_loop": OPEN_LOOP_STATES,
        "pilot_sets_attitude": (*ATTITUDE_STATES, *RATE_STATES),
    }
    for name, known in modes.items():
        within = np.isin(states, known).astype(np.float64)
        channel = _channel(name, clocks[NAVIGATION_STATE.topic], within, NAVIGATION_STATE.label)
        if channel.time_s.size:
            reading.channels[name] = channel


def _add_attitude_setpoints(reading: _Reading, clocks: Mapping[str, Float[np.ndarray, " _"]]) -> None:
    """Add the setpoints of attitude and rates that are in force anywhere, by who made them."""
    for one in attitude_setpoints(reading.topics, clocks):
        channel = _channel(one.name, clocks[one.topic], one.values, one.label)
        if np.isfinite(channel.values).any():
            reading.channels[one.name] = channel


def _add_actuators(
    reading: _Reading, clocks: Mapping[str, Float[np.ndarray, " _"]], parameters: Mapping[str, float]
) -> None:
    """Add the motor outputs that move, numbered from 1; an unused one is NaN or constant.

    Those in microseconds become shares, where parameters tell their range.
    """
    for topic_name, stem, side in ACTUATOR_SOURCES:
        topic = reading.topics.get(topic_name)
        used = varying_fields(topic, stem) if topic is not None else []
        if topic is None or not used:
            continue
        values = {place_of(field): topic.fields[field].astype(np.float64) for field in used}
        if topic_name == PULSES_TOPIC and are_pulses(list(values.values()), parameters):
            values, finding = as_shares(values, parameters)
            reading.findings.append(finding)
        for number, (place, column) in enumerate(values.items(), start=1):
            name, source = f"actuator_output_{number}", f"{topic_name}.{stem}[{place}]"
            reading.channels[name] = _channel(name, clocks[topic_name], column, source, side)
        return


def _add_rotor_speeds(reading: _Reading, clocks: Mapping[str, Float[np.ndarray, " _"]]) -> None:
    """Add the speeds [rad/s] of the motors that turn, by telemetry, each under its motor's number."""
    topic = reading.topics.get(ESC_TOPIC)
    turning = {
        place: topic.fields[field].astype(np.float64) * UNITS["rpm"][1]
        for place in range(MAX_ESCS)
        if topic is not None and (field := ESC_SPEED.format(place)) in topic.fields
        if np.any(topic.fields[field])
    }
    if topic is None or not turning:
        return
    told = {place: _motor_of(topic, place) for place in turning}
    known = all(told.values()) and len(set(told.values())) == len(told)
    for place, speeds in turning.items():
        name = f"rotor_speed_{told[place] if known else place + 1}"
        label = f"{ESC_TOPIC}.{ESC_SPEED.format(place)}"
        reading.channels[name] = _channel(name, clocks[ESC_TOPIC], speeds, label, CurveSide.BEHIND)


def _motor_of(topic: Topic, place: int) -> int:
    """Number of the motor that a report is of, from 1 on; 0 when it does not say, or not always the same."""
    functions = np.unique(topic.fields.get(ESC_FUNCTION.format(place), np.zeros(1)))
    number = int(functions[0]) - FIRST_MOTOR_FUNCTION + 1
    return number if functions.size == 1 and 1 <= number <= MAX_ESCS else 0
