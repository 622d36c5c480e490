"""Topics of a ULog, and the channels that they hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import msgspec
import numpy as np

from eivor.logs import common
from eivor.signals.channels import CurveSide, roll_pitch_yaw
from eivor.signals.recording import HELICOPTER, ROTARY_WING, VTOL, Channel, Finding, LogOrigin, utc_time
from eivor.strict_toml import package_tables
from eivor.tools import Bool, Float

#: What PX4's estimator makes of its sensors.
ESTIMATOR_TOPIC = "vehicle_local_position"


class TopicSource(msgspec.Struct, frozen=True):
    """One place where a channel may be."""

    topic: str
    field: str
    sign: float = 1.0  # -1 where the channel is the negative of the logged value
    valid_field: str = ""  # Field of the same message that is zero when the value means nothing
    zero_is_absent: bool = False  # True when firmware that does not estimate the value logs zeros throughout
    is_setpoint: bool = False

    @property
    def estimated(self) -> bool:
        return self.topic == ESTIMATOR_TOPIC

    @property
    def label(self) -> str:
        return f"{'-' if self.sign < 0 else ''}{self.topic}.{self.field}"


TABLES = package_tables("eivor.logs.ulog")
CHANNEL_SOURCES = common.channel_sources(TABLES, TopicSource)

#: The position controller's velocity setpoint: feedback while a height setpoint is in force, else a commanded
#: climb rate.
CONTROLLER_VELOCITY = TopicSource("vehicle_local_position_setpoint", "vz", is_setpoint=True)
CONTROLLER_POSITION = TopicSource("vehicle_local_position_setpoint", "z", is_setpoint=True)

#: Counters of the estimator's jumps in height and in vertical velocity, both of `vehicle_local_position`.
RESET_COUNTERS: Mapping[str, str] = {"z_reset_counter": "height", "vz_reset_counter": "vertical velocity"}

#: Channels whose source is another one than the preferred where that was logged much more often: PX4 may log
#: the filtered acceleration at 20 Hz beside the raw one at its full rate.
CHOSEN_BY_RATE = tuple(
    f"{quantity}_{axis}" for quantity in ("specific_force_body", "angular_rate") for axis in "xyz"
)

#: The navigation state, and those in which sticks set the attitude or the rates.
NAVIGATION_STATE = TopicSource("vehicle_status", "nav_state")
STICKS: Mapping[str, Sequence[int]] = TABLES["sticks"]
ATTITUDE_SETPOINT, RATES_SETPOINT = "vehicle_attitude_setpoint", "vehicle_rates_setpoint"

#: Motor outputs as they are sent: pulse widths, or counts of DShot.
PULSES_TOPIC = "actuator_outputs"
#: Motor outputs: topic, field stem and side of the thrust curve, the preferred one first. PX4 inverts the
#: curve (THR_MDL_FAC) between the two topics: in `FunctionMotors`, and in the mixer of older firmware.
ACTUATOR_SOURCES: tuple[tuple[str, str, CurveSide], ...] = (
    ("actuator_motors", "control", CurveSide.BEFORE),
    (PULSES_TOPIC, "output", CurveSide.BEHIND),
)
MAX_ACTUATORS = 16
#: Telemetry of electronic speed controllers: rotor speeds [rpm], of motor 1, 2, ... where a field of the same
#: report says which motor it is of, by PX4's number of an actuator's function.
ESC_TOPIC = "esc_status"
ESC_SPEED, ESC_FUNCTION = "esc[{}].esc_rpm", "esc[{}].actuator_function"
MAX_ESCS = 12
FIRST_MOTOR_FUNCTION = 101

NEEDED_TOPICS: tuple[str, ...] = tuple(
    sorted(
        {source.topic for sources in CHANNEL_SOURCES.values() for source in sources}
        | {CONTROLLER_VELOCITY.topic, NAVIGATION_STATE.topic, RATES_SETPOINT}
        | {topic for topic, *_ in ACTUATOR_SOURCES}
        | {ESC_TOPIC}
    )
)


#: Names of the bits of SDLOG_PROFILE that matter here.
PROFILE_BITS: Mapping[int, str] = {0: "default set", 3: "system identification", 4: "high rate"}

#: How PX4's logger treats topics: the rate by default [Hz], and bits of SDLOG_PROFILE that log all of them.
LOGGING: Mapping[str, Mapping[str, Any]] = TABLES["logging"]


def _with_profile(source: TopicSource) -> str:
    """Return a source's label with the bits of SDLOG_PROFILE that log it; old topics have none."""
    if source.topic not in LOGGING:
        return source.label
    bits = LOGGING[source.topic].get("full_rate_bits", ())
    return f"{source.label} [SDLOG_PROFILE bit {' or '.join(map(str, sorted({0, *bits})))}]"


LOOKED_FOR = common.looked_for(TABLES, CHANNEL_SOURCES, _with_profile)


@dataclass(frozen=True, slots=True)
class Topic:
    """One instance of a topic: raw arrays by field, one entry per message."""

    name: str
    instance: int
    fields: Mapping[str, np.ndarray]

    @property
    def size(self) -> int:
        return int(self.fields["timestamp"].size)


def varying_fields(topic: Topic, stem: str) -> dict[int, np.ndarray]:
    """Fields ``stem[0]``, ``stem[1]``, ... with at least two different finite values, by their numbers."""
    every = {index: topic.fields.get(f"{stem}[{index}]", np.empty(0)) for index in range(MAX_ACTUATORS)}
    numbers = {index: values.astype(np.float64) for index, values in every.items()}
    return {
        index: values for index, values in numbers.items() if np.unique(values[np.isfinite(values)]).size > 1
    }


def chosen_topics(every: Iterable[Topic], findings: list[Finding]) -> dict[str, Topic]:
    """The instance of each topic to use; a choice among those of channels is reported in `findings`."""
    instances: dict[str, list[Topic]] = {}
    for topic in every:
        instances.setdefault(topic.name, []).append(topic)
    return {
        name: _chosen(candidates, findings if name in NEEDED_TOPICS else [])
        for name, candidates in instances.items()
    }


def _chosen(candidates: Sequence[Topic], findings: list[Finding]) -> Topic:
    ordered = sorted(candidates, key=lambda topic: topic.instance)
    if len(ordered) == 1:
        return ordered[0]
    best = max(_usefulness(topic) for topic in ordered)
    useful = [topic for topic in ordered if _usefulness(topic) == best]
    longest = max(useful, key=lambda topic: topic.size)
    chosen = longest if longest.size > 2 * useful[0].size else useful[0]
    sizes = (f"{topic.instance}: {topic.size} messages" for topic in ordered)
    findings += common.noted("several_instances", sizes, topic=chosen)
    return chosen


def _usefulness(topic: Topic) -> int:
    """How much of what the topic is for is there: connected batteries, moving outputs."""
    if topic.name == "battery_status" and "connected" in topic.fields:
        return int(np.any(topic.fields["connected"] != 0))
    return len(varying_fields(topic, "output")) if topic.name == "actuator_outputs" else 0


#: Topics with the time of satellites, the preferred one first.
CLOCKS = ("vehicle_gps_position", "sensor_gps")
#: What the last byte of a release is, PX4's FIRMWARE_TYPE; smaller ones are of development.
KINDS = {64: " alpha", 128: " beta", 192: " rc", 255: ""}


def ulog_origin(
    about: Mapping[str, bytes], topics: Mapping[str, Topic], start: np.uint64, parameters: Mapping[str, float]
) -> LogOrigin:
    """Origin of a log."""
    name = _text(about.get("sys_name", b""))
    airframe = parameters.get("SYS_AUTOSTART", 0.0)
    kind, patch, minor, major = version = about.get("ver_sw_release", b"")[:4].ljust(4, b"\0")
    release = f" {major}.{minor}.{patch}{KINDS.get(kind, ' development')}" if any(version) else ""
    return LogOrigin(
        board=_text(about.get("sys_uuid", b"")),
        airframe=f"{name} airframe {airframe:.0f}".strip() if airframe > 0.0 else "",
        firmware=f"{name}{release}",
        start=next(filter(None, (_start(topics.get(name), start) for name in CLOCKS)), None),
    )


def _start(topic: Topic | None, start: np.uint64) -> datetime | None:
    """Time of the log's start by a receiver of satellites; None while it has none."""
    if topic is None or "time_utc_usec" not in topic.fields:
        return None
    utc = topic.fields["time_utc_usec"].astype(float) * 1e-6
    dated = utc > 0.0
    if not dated.any():
        return None
    return utc_time(float(np.median(utc[dated] - since_start(topic.fields["timestamp"], start)[dated])))


def since_start(stamps: np.ndarray, start: np.ndarray | np.uint64) -> Float[np.ndarray, " n"]:
    """Seconds since the log's start, or since other stamps."""
    with np.errstate(over="ignore"):
        return np.asarray((stamps.astype(np.uint64) - start.astype(np.uint64)).view(np.int64) * 1e-6)


def _text(content: bytes) -> str:
    text = content.decode("latin-1").strip("\0 ")
    return text if text.isprintable() else ""


#: Kinds of vehicles by vehicle_status.vehicle_type, how it moves at the time, by MAV_TYPE and by CA_AIRFRAME.
LOCOMOTION, MAV_TYPES, AIRFRAMES = common.by_number(TABLES, "vehicle_type", "MAV_TYPE", "CA_AIRFRAME")


def vehicle_of(topics: Mapping[str, Topic], parameters: Mapping[str, float]) -> str:
    """Kind of vehicle in words, empty when the log does not say."""
    status = topics.get("vehicle_status")
    vehicle_types = status.fields.get("vehicle_type", ()) if status is not None else ()
    kinds = [LOCOMOTION[kind] for kind in np.unique(vehicle_types).tolist() if kind in LOCOMOTION]
    airframe = AIRFRAMES.get(parameters.get("CA_AIRFRAME", 0.0), "")
    named = MAV_TYPES.get(parameters.get("MAV_TYPE", 0.0), airframe)
    if len(kinds) > 1 and ROTARY_WING in kinds:
        return VTOL
    # what moves like another vehicle by PX4's word: its parameters name it closer
    closer = {(ROTARY_WING, HELICOPTER), ("rover", "boat")}
    return named if not kinds or (kinds[0], named) in closer else kinds[0]


NAMES = ("roll", "pitch", "yaw")
#: A quaternion further from one in length is none.
UNIT_WITHIN = 0.05


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
#: Longer means are none of an inertial sensor, longer ways from sample to stamp those of another clock [s].
LONGEST_S = 0.02

#: Delay of a topic [s], and its cause.
Delay = tuple[float, str]


def topic_delays(topic: Topic, parameters: Mapping[str, float]) -> list[Delay]:
    """Known delays of a topic, each with its cause; none for most topics."""
    filter_name = LOW_PASSES.get(topic.name, "")
    cutoff = parameters.get(filter_name, 0.0)
    delays = [(common.low_pass_delay_s(cutoff), f"low-pass of {cutoff:g} Hz, {filter_name}")]
    for name, width_name in NOTCHES.get(topic.name, ()):
        frequency, width = parameters.get(name, 0.0), parameters.get(width_name, 0.0)
        delays.append((common.notch_delay_s(frequency, width), f"notch at {frequency:g} Hz, {name}"))
    lengths = topic.fields.get(MEANS.get(topic.name, ""), np.empty(0))
    if lengths.size:
        length = float(np.median(lengths))
        length *= 1.0 if length < 1.0 else 1e-6
        if 0.0 < length <= LONGEST_S:
            delays.append((0.5 * length, f"half of the {1e3 * length:.3g} ms of which it is the mean"))
    if topic.name in SAMPLED:
        delays.append((_latency_s(topic), "from its sample to its stamp"))
    return [delay for delay in delays if delay[0] > 0.0]


def _latency_s(topic: Topic) -> float:
    """Median time from sample to stamp [s]; 0 when it is not known, or of another clock."""
    sampled = topic.fields.get("timestamp_sample")
    if sampled is None or not sampled.size or sampled.dtype.kind not in "iu":
        return 0.0
    latency_s = float(np.median(since_start(topic.fields["timestamp"], sampled)))
    return latency_s if 0.0 < latency_s <= LONGEST_S else 0.0


def _topic_of(channel: Channel) -> str:
    return channel.source.lstrip("-").partition(".")[0]


def delay_findings(channels: Iterable[Channel], delays: Mapping[str, list[Delay]]) -> list[Finding]:
    """Say what was taken off the stamps of the topics that channels come from."""
    texts = [
        f"{name}: {1e3 * sum(seconds for seconds, _ in delays[name]):.2g} ms "
        f"({', '.join(cause for _, cause in delays[name])})"
        for name in sorted({_topic_of(channel) for channel in channels if channel.delay_s})
    ]
    return common.noted("delays", "; ".join(texts))


def unknown_filters(channels: Iterable[Channel], holder: str) -> list[Finding]:
    """Say that delays of filters are not known where the parameters are not."""
    if not any(_topic_of(channel) in LOW_PASSES for channel in channels):
        return []
    return common.noted("unknown_filters", holder, filters=", ".join(LOW_PASSES.values()))


# -- Pulse widths --

#: Groups of outputs, by what their parameters begin with.
GROUPS = ("PWM_MAIN", "PWM_AUX")
#: What pulse widths of motors can be, running or disarmed [us].
WIDTHS = (700.0, 2300.0)
#: Values of PWM_MAIN_TIM0 and the like that mean DShot.
DSHOT_RATES = range(-5, -1)


def are_pulses(columns: Sequence[Float[np.ndarray, " n"]], parameters: Mapping[str, float]) -> bool:
    """Whether outputs are pulse widths: all in their range, but for zeros, and none of them by DShot."""
    values = np.concatenate(columns) if columns else np.empty(0)
    values = values[np.isfinite(values) & (values != 0.0)]
    if not values.size or values.min() < WIDTHS[0] or values.max() > WIDTHS[1]:
        return False
    timers = [f"{group}_TIM{number}" for group in GROUPS for number in range(MAX_ACTUATORS)]
    by_dshot = any(int(parameters.get(name, 0.0)) in DSHOT_RATES for name in timers)
    return not (by_dshot or parameters.get("DSHOT_CONFIG", 0.0) > 0.0)


def as_shares(
    widths: Mapping[int, Float[np.ndarray, " n"]], parameters: Mapping[str, float], findings: list[Finding]
) -> dict[int, Float[np.ndarray, " n"]]:
    """Outputs of motors as shares, in the order of the motors; as they are where no range is known."""
    group, motors = motor_outputs(list(widths), parameters)
    ranges = {motor: pulse_range(group, motor, parameters) for motor in motors}
    ranges_known = {name: item for name, item in ranges.items() if item is not None}
    if len(ranges_known) < len(ranges):
        names = f"{group}_MIN1 and {group}_MAX1, or PWM_MIN and PWM_MAX"
        findings += common.noted("pulse_range_unknown", names, topic=PULSES_TOPIC)
        return dict(widths)
    in_words: dict[tuple[float, float], str] = {}
    for low, high, names in ranges_known.values():
        in_words.setdefault((low, high), f"{low:g} to {high:g} ({names})")
    findings += common.noted("pulse_widths", in_words.values(), topic=PULSES_TOPIC)
    return {
        name: np.asarray(np.clip((widths[name] - low) / (high - low), 0.0, 1.0))
        for name, (low, high, _) in ranges_known.items()
    }


def motor_outputs(indices: Sequence[int], parameters: Mapping[str, float]) -> tuple[str, dict[int, int]]:
    """Group that outputs are of, and the motor of each, from 1 on; of all in order where nothing gives."""
    for group in GROUPS:
        function = {index: int(parameters.get(f"{group}_FUNC{index + 1}", 0.0)) for index in indices}
        motors = {
            name: which - FIRST_MOTOR_FUNCTION + 1
            for name, which in function.items()
            if FIRST_MOTOR_FUNCTION <= which < FIRST_MOTOR_FUNCTION + MAX_ACTUATORS
        }
        if motors:
            return group, dict(sorted(motors.items(), key=lambda item: item[1]))
    return GROUPS[0], {index: number for number, index in enumerate(indices, start=1)}


def pulse_range(
    group: str, position: int, parameters: Mapping[str, float]
) -> tuple[float, float, str] | None:
    """Range of an output, from 0 on [us], and the parameters that give it; None where none does."""
    names = []
    for end in ("MIN", "MAX"):
        candidates = (f"{group}_{end}{position + 1}", f"{group}_{end}", f"PWM_{end}")
        defined = (name for name in candidates if WIDTHS[0] <= parameters.get(name, -1.0) <= WIDTHS[1])
        names.append(next(defined, ""))
    low, high = (parameters.get(name, np.nan) for name in names)
    return (low, high, " and ".join(names)) if low < high else None


@dataclass(slots=True)
class _Reading:
    topics: Mapping[str, Topic]
    clocks: Mapping[str, Float[np.ndarray, " _"]]  # Stamps of messages, from the log's start on [s]
    delays_s: Mapping[str, float]
    end_s: float
    findings: list[Finding]
    channels: dict[str, Channel] = field(default_factory=dict)
    inactive_setpoints: list[str] = field(default_factory=list)
    never_valid: list[str] = field(default_factory=list)

    def values(self, source: TopicSource) -> Float[np.ndarray, " n"] | None:
        """Values of a source, NaN where invalid; None when the log has no such field."""
        fields = self.fields(source.topic)
        if source.field not in fields:
            return None
        values = source.sign * fields[source.field].astype(np.float64)
        if source.valid_field in fields:
            values[fields[source.valid_field] == 0] = np.nan
        return values

    def fields(self, topic: str) -> Mapping[str, np.ndarray]:
        """Fields of a topic; none where it is not logged."""
        return self.topics[topic].fields if topic in self.topics else {}

    def in_states(self, topic: str, states: Sequence[int]) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle was in one of some states at each message of a topic."""
        stamps = self.clocks.get(topic, np.empty(0))
        logged = self.fields(NAVIGATION_STATE.topic).get(NAVIGATION_STATE.field)
        if logged is None:
            return np.zeros(stamps.size, dtype=np.bool_)
        times = self.clocks[NAVIGATION_STATE.topic]
        finite = np.isfinite(times)
        return common.held_at(times[finite], np.isin(logged, states)[finite], stamps, initial=False)

    def put(
        self,
        name: str,
        topic: str,
        values: np.ndarray,
        label: str,
        side: CurveSide = CurveSide.UNKNOWN,
        *,
        is_setpoint: bool = False,
        **options: Any,
    ) -> None:
        """Add a channel, when it has a value."""
        channel = common.logged_channel(name, self.clocks[topic], values, label, curve_side=side, **options)
        if np.isfinite(channel.values).any():
            silent = (self.end_s, self.inactive_setpoints)
            self.channels[name] = common.silenced(channel, *silent) if is_setpoint else channel

    def add(self, name: str, source: TopicSource, where: Bool[np.ndarray, " n"] | None = None) -> None:
        """Add a channel from a source, when that has a valid value (among the samples `where`)."""
        values = self.values(source)
        if values is None:
            return
        if where is not None:
            values[~where] = np.nan
        elif not np.isfinite(values).any():
            self.never_valid.append(source.label)
        if source.zero_is_absent and not np.any(np.nan_to_num(values)):
            return
        side = CurveSide.BEFORE if name == "input" else CurveSide.UNKNOWN
        options = {"estimated": source.estimated, "delay_s": self.delays_s[source.topic]}
        self.put(name, source.topic, values, source.label, side, is_setpoint=source.is_setpoint, **options)


def read_topics(
    topics: Mapping[str, Topic], start: np.uint64, parameters: Mapping[str, float], findings: list[Finding]
) -> dict[str, Channel]:
    """Return all channels that topics hold."""
    delays = {name: topic_delays(topic, parameters) for name, topic in topics.items()}
    late = {name: sum((seconds for seconds, _ in causes), 0.0) for name, causes in delays.items()}
    times = {name: since_start(topic.fields["timestamp"], start) for name, topic in topics.items()}
    clocks = {
        name: np.where(np.abs(time) > common.MAX_SPAN_S, np.nan, time) - late[name]
        for name, time in times.items()
    }
    ends = [float(np.nanmax(clock)) for clock in clocks.values() if np.isfinite(clock).any()]
    reading = _Reading(topics, clocks, late, max(ends, default=0.0), findings)
    sizes = {name: topic.size for name, topic in topics.items()}
    sources = CHANNEL_SOURCES, CHOSEN_BY_RATE
    for name, source in common.in_preference(*sources, lambda source: sizes.get(source.topic, 0)):
        if name not in reading.channels:
            reading.add(name, source)
    _add_controller_velocity(reading)
    _add_modes(reading)
    _add_setpoints(reading)
    _add_actuators(reading, parameters)
    _add_rotor_speeds(reading)
    findings += _rotor_findings(reading) + _reset_findings(reading)
    findings += delay_findings(reading.channels.values(), delays)
    findings += common.noted("never_valid", reading.never_valid)
    findings += common.noted("silent_topic", reading.inactive_setpoints)
    return reading.channels


def _rotor_findings(reading: _Reading) -> list[Finding]:
    types = reading.fields("vehicle_status").get("vehicle_type", np.zeros(0))
    on_rotors = types == 1
    if not (on_rotors.any() and np.isin(types, list(LOCOMOTION.keys() - {1})).any()):
        return []
    times = np.append(reading.clocks["vehicle_status"], reading.end_s)
    edges = np.flatnonzero(np.diff(on_rotors, prepend=False, append=False))
    spans = (f"{times[a]:.0f}:{times[b]:.0f}" for a, b in edges.reshape(-1, 2))
    return common.noted("on_rotors", spans)


def _reset_findings(reading: _Reading) -> list[Finding]:
    """Jumps of the estimate, which are no motion: where a counter of the estimator's resets moves."""
    findings: list[Finding] = []
    for counter, meaning in RESET_COUNTERS.items():
        counts = reading.fields(ESTIMATOR_TOPIC).get(counter, np.empty(0))
        if not counts.size:
            continue
        times = reading.clocks[ESTIMATOR_TOPIC][1:][counts[1:] != counts[:-1]]
        text = ", ".join(f"{time:.2f}" for time in times[:10]) + (", ..." if times.size > 10 else "")
        findings += common.noted("estimator_reset", text, what=meaning)
    return findings


def _add_controller_velocity(reading: _Reading) -> None:
    """Add the controller's velocity setpoint: feedback under a height setpoint, else a climb rate."""
    heights = reading.values(CONTROLLER_POSITION)
    if heights is None:
        return
    in_force = np.isfinite(heights)
    reading.add("feedback_reference_velocity_z", CONTROLLER_VELOCITY, in_force)
    if "trajectory_setpoint" not in reading.topics:
        reading.add("reference_velocity_z", CONTROLLER_VELOCITY, ~in_force)


def _add_setpoints(reading: _Reading) -> None:
    """Add setpoints of the attitude, distinguished by who makes them, and of rates where sticks do."""
    topic = ATTITUDE_SETPOINT
    by_sticks = reading.in_states(topic, STICKS["attitude"])
    for name, (values, source) in zip(NAMES, _angles(reading.fields(topic)), strict=False):
        for kind, where in (("", by_sticks), ("feedback_", ~by_sticks)):
            series = np.where(where, values, np.nan)
            reading.put(f"{kind}reference_{name}", topic, series, f"{topic}.{source}")
    topic = RATES_SETPOINT
    by_sticks = reading.in_states(topic, STICKS["rates"])
    for axis, name in zip("xyz", NAMES, strict=True):
        if name in reading.fields(topic):
            series = np.where(by_sticks, reading.fields(topic)[name].astype(np.float64), np.nan)
            reading.put(f"reference_angular_rate_{axis}", topic, series, f"{topic}.{name}")


def _angles(fields: Mapping[str, np.ndarray]) -> list[tuple[Float[np.ndarray, " n"], str]]:
    """Roll, pitch and yaw of the setpoint [rad], of its quaternion or, where it has none, of its angles."""
    parts = [f"q_d[{index}]" for index in range(4)]
    if all(part in fields for part in parts):
        quaternion = np.stack([fields[part].astype(np.float64) for part in parts])
        length = np.linalg.norm(quaternion, axis=0)
        is_unit = np.abs(length - 1.0) <= UNIT_WITHIN
        if is_unit.any():
            result = roll_pitch_yaw(np.where(is_unit, quaternion / np.where(is_unit, length, 1.0), np.nan))
            return [(angle, "q_d") for angle in result]
    angles = [f"{name}_body" for name in NAMES]
    is_logged = all(angle in fields for angle in angles)
    return [(fields[angle].astype(np.float64), angle) for angle in angles] if is_logged else []


def _add_modes(reading: _Reading) -> None:
    """Add when a pilot flies, when no loop acts on the thrust, and when sticks set attitude or rates."""
    states = reading.values(NAVIGATION_STATE)
    if states is None:
        return
    for name, numbers in TABLES["modes"].items():
        in_mode = np.isin(states, numbers).astype(np.float64)
        reading.put(name, NAVIGATION_STATE.topic, in_mode, NAVIGATION_STATE.label)


def _add_actuators(reading: _Reading, parameters: Mapping[str, float]) -> None:
    """Add the motor outputs that move, numbered from 1; an unused one is NaN or constant."""
    for topic_name, stem, side in ACTUATOR_SOURCES:
        topic = reading.topics.get(topic_name)
        values = varying_fields(topic, stem) if topic is not None else {}
        if not values:
            continue
        if topic_name == PULSES_TOPIC and are_pulses(list(values.values()), parameters):
            values = as_shares(values, parameters, reading.findings)
        for number, (i, column) in enumerate(values.items(), start=1):
            reading.put(f"actuator_output_{number}", topic_name, column, f"{topic_name}.{stem}[{i}]", side)
        return


def _add_rotor_speeds(reading: _Reading) -> None:
    fields = reading.fields(ESC_TOPIC)
    names = {index: ESC_SPEED.format(index) for index in range(MAX_ESCS)}
    turning = {index: name for index, name in names.items() if np.any(fields.get(name, 0))}
    selected = {esc: _motor_of(fields, esc) for esc in turning}
    is_mapped = all(selected.values()) and len(set(selected.values())) == len(selected)
    for esc, name in turning.items():
        speeds = fields[name].astype(np.float64) * common.UNITS["rpm"][1]
        channel = f"rotor_speed_{selected[esc] if is_mapped else esc + 1}"
        reading.put(channel, ESC_TOPIC, speeds, f"{ESC_TOPIC}.{name}", CurveSide.BEHIND)


def _motor_of(fields: Mapping[str, np.ndarray], position: int) -> int:
    """Number of the motor that a report is of, from 1 on; 0 when it does not say, or not always the same."""
    functions = np.unique(fields.get(ESC_FUNCTION.format(position), np.zeros(1)))
    number = int(functions[0]) - FIRST_MOTOR_FUNCTION + 1
    return number if functions.size == 1 and 1 <= number <= MAX_ESCS else 0
