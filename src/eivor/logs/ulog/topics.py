"""Topics of a ULog: instances, vehicle and origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from eivor.logs.common import by_number, channel_sources, logged_channel, source_tables
from eivor.signals.channels import CurveSide
from eivor.signals.recording import HELICOPTER, ROTARY_WING, VTOL, Channel, Finding, LogOrigin, utc_time

#: What PX4's estimator makes of its sensors.
ESTIMATOR_TOPIC = "vehicle_local_position"


@dataclass(frozen=True, slots=True)
class TopicSource:
    """One place where a channel may be."""

    topic: str
    field: str
    sign: float = 1.0  # -1 where the channel is the negative of the logged value
    valid_field: str = ""  # Field of the same message that is zero when the value means nothing
    zero_is_absent: bool = False  # True when firmware that does not estimate the value logs zeros throughout
    is_setpoint: bool = False

    @property
    def estimated(self) -> bool:
        """Whether the estimator makes the values."""
        return self.topic == ESTIMATOR_TOPIC

    @property
    def label(self) -> str:
        """The source in the log's own words."""
        return f"{'-' if self.sign < 0 else ''}{self.topic}.{self.field}"


TABLES = source_tables("eivor.logs.ulog")
CHANNEL_SOURCES = channel_sources(TABLES, TopicSource)

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

#: The navigation state. A pilot flies in manual, altitude, position, acro and stabilized; in manual, acro and
#: stabilized the thrust is the stick's, and no loop acts on it.
NAVIGATION_STATE = TopicSource("vehicle_status", "nav_state")
PILOT_STATES = (0, 1, 2, 10, 15)
OPEN_LOOP_STATES = (0, 10, 15)
#: In manual, altitude and stabilized mode the sticks set the attitude, in acro the rates; elsewhere loops do.
ATTITUDE_STATES = (0, 1, 15)
RATE_STATES = (10,)
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


@dataclass(frozen=True, slots=True)
class TopicLogging:
    """How PX4's logger treats a topic."""

    topic: str
    default_rate_hz: float
    full_rate_bits: Sequence[int] = ()


#: Names of the bits of SDLOG_PROFILE that matter here.
PROFILE_BITS: Mapping[int, str] = {0: "default set", 3: "system identification", 4: "high rate"}

TOPIC_LOGGING = tuple(TopicLogging(topic, **row) for topic, row in TABLES["logging"].items())


def _with_profile(source: TopicSource) -> str:
    """Return a source's label with the bits of SDLOG_PROFILE that log it; old topics have none."""
    bits = next((entry.full_rate_bits for entry in TOPIC_LOGGING if entry.topic == source.topic), None)
    if bits is None:
        return source.label
    return f"{source.label} [SDLOG_PROFILE bit {' or '.join(map(str, sorted({0, *bits})))}]"


LOOKED_FOR: Mapping[str, tuple[str, ...]] = {
    **{name: tuple(map(_with_profile, sources)) for name, sources in CHANNEL_SOURCES.items()},
    **{name: tuple(texts) for name, texts in TABLES["looked_for"].items()},
}


@dataclass(frozen=True, slots=True)
class Topic:
    """One instance of a topic: raw arrays by field, one entry per message."""

    name: str
    instance: int
    fields: Mapping[str, np.ndarray]

    @property
    def size(self) -> int:
        """Number of messages."""
        return int(self.fields["timestamp"].size)


def varying_fields(topic: Topic, stem: str) -> dict[int, np.ndarray]:
    """Fields ``stem[0]``, ``stem[1]``, ... with at least two different finite values, by their numbers."""
    every = {index: topic.fields.get(f"{stem}[{index}]", np.empty(0)) for index in range(MAX_ACTUATORS)}
    numbers = {index: values.astype(np.float64) for index, values in every.items()}
    return {
        index: values for index, values in numbers.items() if np.unique(values[np.isfinite(values)]).size > 1
    }


def choose_instance(candidates: Sequence[Topic], findings: list[Finding]) -> Topic:
    """Return the instance to use; a choice is reported in `findings`."""
    ordered = sorted(candidates, key=lambda topic: topic.instance)
    if len(ordered) == 1:
        return ordered[0]
    best = max(_usefulness(topic) for topic in ordered)
    useful = [topic for topic in ordered if _usefulness(topic) == best]
    longest = max(useful, key=lambda topic: topic.size)
    chosen = longest if longest.size > 2 * useful[0].size else useful[0]
    sizes = ", ".join(f"{topic.instance}: {topic.size} messages" for topic in ordered)
    sentence = f"{chosen.name}: instance {chosen.instance} is used (there are {sizes})."
    findings.append(Finding("several_instances", sentence))
    return chosen


def _usefulness(topic: Topic) -> int:
    """How much of what the topic is for is there: connected batteries, moving outputs."""
    if topic.name == "battery_status" and "connected" in topic.fields:
        return int(np.any(topic.fields["connected"] != 0))
    if topic.name == "actuator_outputs":
        return len(varying_fields(topic, "output"))
    return 0


#: Topics with the time of satellites, the preferred one first, and that with the air.
CLOCKS, AIR = ("vehicle_gps_position", "sensor_gps"), "vehicle_air_data"
ORIGIN_TOPICS = (*CLOCKS, AIR)
#: Channels of the air and their fields. The barometer's own temperature, where nothing else is logged, is
#: above that of the air.
AIR_FIELDS = {"air_density": ("rho",), "air_temperature": ("ambient_temperature", "baro_temp_celcius")}
#: What the last byte of a release is, PX4's FIRMWARE_TYPE; smaller ones are of development.
KINDS = {64: " alpha", 128: " beta", 192: " rc", 255: ""}


def ulog_origin(
    about: Mapping[str, bytes], topics: Mapping[str, Topic], start: np.uint64, parameters: Mapping[str, float]
) -> LogOrigin:
    """Origin of a log."""
    name = _text(about.get("sys_name", b""))
    airframe = parameters.get("SYS_AUTOSTART", 0.0)
    version = int.from_bytes(about.get("ver_sw_release", b"")[:4], "little")
    release = f" {_release(version)}" if version else ""
    return LogOrigin(
        board=_text(about.get("sys_uuid", b"")),
        airframe=f"{name} airframe {airframe:.0f}".strip() if airframe > 0.0 else "",
        firmware=f"{name}{release}",
        start=next(filter(None, (_start(topics.get(name), start) for name in CLOCKS)), None),
    )


def air_channels(topics: Mapping[str, Topic], start: np.uint64) -> dict[str, Channel]:
    """Channels of the air, on the log's clock."""
    topic = topics.get(AIR)
    if topic is None:
        return {}
    time_s = since_start(topic.fields["timestamp"], start)
    results: dict[str, Channel] = {}
    for name, fields in AIR_FIELDS.items():
        for field in fields:
            values = topic.fields.get(field)
            if name not in results and values is not None and np.any(np.nan_to_num(values)):
                results[name] = logged_channel(name, time_s, values.astype(float), f"{AIR}.{field}")
    return results


def _start(topic: Topic | None, start: np.uint64) -> datetime | None:
    """Time of the log's start by a receiver of satellites; None while it has none."""
    if topic is None or "time_utc_usec" not in topic.fields:
        return None
    utc = topic.fields["time_utc_usec"].astype(float) * 1e-6
    dated = utc > 0.0
    if not dated.any():
        return None
    since = since_start(topic.fields["timestamp"], start)
    return utc_time(float(np.median(utc[dated] - since[dated])))


def since_start(stamps: np.ndarray, start: np.uint64) -> np.ndarray:
    """Seconds since the log's start."""
    with np.errstate(over="ignore"):
        return np.asarray((stamps.astype(np.uint64) - start).view(np.int64) * 1e-6)


def _text(content: bytes) -> str:
    text = content.decode("latin-1").strip("\0 ")
    return text if text.isprintable() else ""


def _release(number: int) -> str:
    major, minor, patch, kind = number.to_bytes(4, "big")
    return f"{major}.{minor}.{patch}{KINDS.get(kind, ' development')}"


#: Kinds of vehicles by vehicle_status.vehicle_type, how it moves at the time, by MAV_TYPE and by CA_AIRFRAME.
LOCOMOTION, MAV_TYPES, AIRFRAMES = by_number(TABLES, "vehicle_type", "MAV_TYPE", "CA_AIRFRAME")


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
