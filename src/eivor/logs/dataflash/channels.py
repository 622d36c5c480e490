"""Reader of DataFlash logs, and their channels."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from eivor.errors import EmptyLogError
from eivor.linalg.system import PASSED_ROWS, row_blocks
from eivor.logs import common
from eivor.logs.dataflash import sources as ardupilot
from eivor.logs.dataflash.messages import (
    HEAD,
    Messages,
    begins_within,
    is_text,
    read_lines,
    read_messages,
    rows_of,
)
from eivor.signals.channels import CurveSide
from eivor.signals.filters import Series
from eivor.signals.recording import (
    HELICOPTER,
    ROTARY_WING,
    VTOL,
    Channel,
    Finding,
    Frame,
    Recording,
    clean_channel,
)
from eivor.tools import Bool, Float

#: Gas constant of dry air [J/(kg K)], and zero degrees Celsius [K].
DRY_AIR, ZERO_CELSIUS = 287.05, 273.15


def _add_air_density(reading: ardupilot.MessageReading, table: Messages) -> None:

    def values() -> Series:
        return table.values("Press") / (DRY_AIR * (table.values("Temp") + ZERO_CELSIUS))

    if "air_temperature" in reading.channels:
        reading.add("air_density", table, values, "BARO.Press and .Temp")


#: Parameter of the low-pass, by the beginning of a channel's name.
LOW_PASSES = {"specific_force_body": "INS_ACCEL_FILTER", "angular_rate": "INS_GYRO_FILTER"}


def delay_of(channel: str, parameters: Mapping[str, float]) -> float:
    """Delay of a channel [s], zero where none is known."""
    family = channel.rpartition("_")[0]
    delay = common.low_pass_delay_s(parameters.get(LOW_PASSES.get(family, ""), 0.0))
    if family == "angular_rate" and parameters.get("INS_NOTCH_ENABLE", 0.0) > 0.0:
        frequency, width = parameters.get("INS_NOTCH_FREQ", 0.0), parameters.get("INS_NOTCH_BW", 0.0)
        delay += common.notch_delay_s(frequency, width)
    return delay


def delay_findings(channels: Iterable[Channel], parameters: Mapping[str, float]) -> list[Finding]:
    """Say what was taken off the stamps, and why."""
    selected = {}
    for channel in channels:
        if channel.delay_s > 0.0:
            name = LOW_PASSES[channel.name.rpartition("_")[0]]
            words = f"low-pass of {parameters[name]:g} Hz, {name}" if name in parameters else "notch"
            selected[channel.source.partition(".")[0], words] = 1e3 * channel.delay_s
    texts = [f"{message}: {delay:.2g} ms ({words})" for (message, words), delay in selected.items()]
    return common.noted("delays", "; ".join(texts))


#: Numbers of SERVOn_FUNCTION: motors 1 to 8, and 9 to 12.
MOTOR_FUNCTIONS = {**{33 + n: 1 + n for n in range(8)}, **{82 + n: 9 + n for n in range(4)}}
#: Outputs that RCOU has.
OUTPUTS = 14
#: The autopilot's own values where a parameter is not logged.
SPIN_MIN, SPIN_MAX, CURVE = 0.15, 0.95, 0.65
#: How far a line through both thrusts may be from the diagonal: in slope, and in its height where the log is.
SLOPE_WITHIN, OFFSET_WITHIN = 0.1, 0.05
#: Throttles below are those of the ground; fewer messages, or less spread, say nothing.
LEAST_THROTTLE, LEAST_COUNT, LEAST_SPREAD = 0.1, 50, 0.01


@dataclass(frozen=True, slots=True)
class MotorRange:
    """Range of the motors' pulse widths, and the curve of their thrust."""

    low: float  # [us]
    high: float  # [us]
    names: str
    spin_min: float
    spin_max: float
    curve: float  # Share of the square in the thrust

    def share(self, widths: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Shares of the range in use, from zero to one."""
        actuator = (widths - self.low) / (self.high - self.low)
        return np.asarray(np.clip((actuator - self.spin_min) / (self.spin_max - self.spin_min), 0.0, 1.0))

    def thrust(
        self, share: Float[np.ndarray, "*shape"], voltage: Float[np.ndarray, "*shape"]
    ) -> Float[np.ndarray, "*shape"]:
        """Share of the full thrust at a share of the range and a ratio of the voltage."""
        state = share * voltage
        lift = (1.0 - self.curve) * voltage + self.curve * voltage**2
        return np.asarray(((1.0 - self.curve) * state + self.curve * state**2) / lift)


def motor_columns(parameters: Mapping[str, float]) -> dict[int, int]:
    """Output of each motor, both from 1 on."""
    selected = {
        MOTOR_FUNCTIONS[function]: output
        for output in range(1, OUTPUTS + 1)
        if (function := int(parameters.get(f"SERVO{output}_FUNCTION", 0.0))) in MOTOR_FUNCTIONS
    }
    return dict(sorted(selected.items())) or {motor: motor for motor in range(1, 5)}


def motor_range(parameters: Mapping[str, float]) -> MotorRange | None:
    """Range of the motors; None where no parameter gives it."""
    for names in (("MOT_PWM_MIN", "MOT_PWM_MAX"), ("RC3_MIN", "RC3_MAX")):
        low, high = (parameters.get(name, 0.0) for name in names)
        if 0.0 < low < high:
            break
    else:
        return None
    spin_min = parameters.get("MOT_SPIN_MIN", SPIN_MIN)
    spin_max = parameters.get("MOT_SPIN_MAX", SPIN_MAX)
    curve = min(max(parameters.get("MOT_THST_EXPO", CURVE), -1.0), 1.0)
    if not 0.0 <= spin_min < spin_max <= 1.0:
        return None
    return MotorRange(low, high, " and ".join(names), spin_min, spin_max, curve)


def disagreement(throttle: Series, thrust: Series, motor: MotorRange) -> list[Finding]:
    """Finding on pulse widths that do not fit the throttle."""
    flight = np.isfinite(throttle) & np.isfinite(thrust) & (throttle > LEAST_THROTTLE)
    throttle_in, thrust_in = throttle[flight], thrust[flight]
    if throttle_in.size < LEAST_COUNT or throttle_in.std() < LEAST_SPREAD:
        return []
    order = np.argsort(throttle_in, kind="stable")
    throttle_in, thrust_in = throttle_in[order], thrust_in[order]
    half = throttle_in.size // 2
    separated = throttle_in[half:] - throttle_in[: throttle_in.size - half] > 0.5 * LEAST_SPREAD
    if separated.sum() < LEAST_COUNT // 2:
        return []
    rises = (thrust_in[half:] - thrust_in[: throttle_in.size - half])[separated]
    slope = float(np.median(rises / (throttle_in[half:] - throttle_in[: throttle_in.size - half])[separated]))
    offset = float(np.median(thrust_in - throttle_in))
    fits = abs(slope - 1.0) <= SLOPE_WITHIN and abs(offset) <= OFFSET_WITHIN
    return common.noted("motor_range", not fits, slope=slope, offset=offset, motor=motor)


MAX_ESCS = 32


def _add_outputs(reading: ardupilot.MessageReading, table: Messages) -> None:
    """Add the motors' outputs; the thrust that they stand for is the input where no throttle is logged."""
    # old firmware calls columns Ch1, Ch2, ...
    outputs = motor_columns(reading.parameters)
    names = {motor: table.first(f"C{n}", f"Ch{n}", f"Chan{n}") for motor, n in outputs.items()}
    columns = {motor: name for motor, name in names.items() if name}
    widths = {motor: table.values(column) for motor, column in columns.items()}
    shares = {motor: np.where(width > 0.0, width, np.nan) for motor, width in widths.items()}
    if not shares:
        return
    pulses = motor_range(reading.parameters)
    if pulses is not None:
        shares = {motor: pulses.share(width) for motor, width in shares.items()}
    for motor, values in shares.items():
        reading.add(f"actuator_output_{motor}", table, values, f"RCOU.{columns[motor]}", CurveSide.BEHIND)
    if pulses is None:
        parameters = "MOT_PWM_MIN and MOT_PWM_MAX, or RC3_MIN and RC3_MAX"
        reading.findings += common.noted("pulse_range_unknown", parameters, topic="RCOU")
        return
    in_use = f"of which {pulses.spin_min:g} to {pulses.spin_max:g} is in use"
    words = f"{pulses.low:g} to {pulses.high:g} ({pulses.names}), {in_use}"
    reading.findings += common.noted("pulse_widths", words, topic="RCOU")
    voltage = _voltage(table, reading)
    thrust = np.mean([pulses.thrust(share, voltage) for share in shares.values()], axis=0)
    throttle = reading.channels.get("input")
    if throttle is None:
        reading.add("input", table, thrust, "RCOU through the thrust curve", CurveSide.BEFORE)
        return
    throttle_values = np.interp(reading.time_s(table), throttle.time_s, throttle.values)
    free = np.all([(share > 0.0) & (share < 1.0) for share in shares.values()], axis=0)
    reading.findings += disagreement(np.where(free, throttle_values, np.nan), thrust, pulses)


def _voltage(table: Messages, reading: ardupilot.MessageReading) -> Series:
    """Ratio of the battery's voltage to its largest, which corrects the thrust; 1 where not logged."""
    motor_table = reading.table("MOTB")
    column = motor_table.first("BatVolt", "BV") if motor_table is not None else ""
    if motor_table is None or not column:
        return np.ones(table.count)
    ratio = motor_table.values(column)
    sound = np.isfinite(ratio) & (ratio > 0.1) & (ratio < 2.0)
    if not sound.any():
        return np.ones(table.count)
    order = np.argsort(motor_table.time_s()[sound], kind="stable")
    return np.asarray(np.interp(table.time_s(), motor_table.time_s()[sound][order], ratio[sound][order]))


def _add_rotor_speeds(reading: ardupilot.MessageReading, table: Messages) -> None:
    column = table.first("Instance", "I")
    if not column:
        return
    instances = table.stored(column)
    motors = {output - 1: motor for motor, output in motor_columns(reading.parameters).items()}
    for instance in np.unique(instances).tolist()[:MAX_ESCS]:
        where = table.where(instances == instance)
        speeds = where.values("RPM") * common.UNITS["rpm"][1]
        if np.any(np.nan_to_num(speeds)):
            name = f"rotor_speed_{motors.get(instance, instance + 1)}"
            reading.add(name, where, speeds, "ESC.RPM", CurveSide.BEHIND)


def _add_modes(reading: ardupilot.MessageReading, table: Messages) -> None:
    column = table.first("ModeNum", "Mode")
    for name, numbers in ardupilot.TABLES["modes"].items() if column else ():
        in_mode = np.isin(table.values(column), reading.with_sweeps(numbers)).astype(np.float64)
        reading.add(name, table, in_mode, f"MODE.{column}")


def _add_landed(reading: ardupilot.MessageReading, table: Messages) -> None:
    numbers = table.values("Id")
    is_event = np.isin(numbers, list(ardupilot.LANDED_EVENTS))
    if is_event.any():
        values = np.array([ardupilot.LANDED_EVENTS[int(number)] for number in numbers[is_event].tolist()])
        reading.add("landed", table.where(is_event), values, "EV.Id")


def _add_disarmed(reading: ardupilot.MessageReading, table: Messages) -> None:
    if "landed" not in reading.channels:
        reading.add("landed", table, (table.values("ArmState") == 0.0).astype(np.float64), "ARM.ArmState")


def _add_throttle(reading: ardupilot.MessageReading, table: Messages) -> None:
    number = int(reading.parameters.get("RCMAP_THROTTLE", 3.0))
    column = table.first(f"C{number}", f"Ch{number}")
    low, high = (
        reading.parameters.get(f"RC{number}_{end}", default) for end, default in (("MIN", 1e3), ("MAX", 2e3))
    )
    if column and low < high:
        widths = table.values(column)
        shares = np.where(widths > 0.0, np.clip((widths - low) / (high - low), 0.0, 1.0), np.nan)
        reading.add("pilot_throttle", table, shares, f"RCIN.{column}")


_DEG = common.UNITS["deg"][1]
#: Of which functions of half of roll, pitch and yaw the two products are that each part is the sum of, or the
#: difference (x and z).
_COS, _SIN = (np.cos, np.sin), (np.sin, np.cos)
_FACTORS = {
    "w": (_COS, _COS, _COS),
    "x": (_SIN, _COS, _COS),
    "y": (_COS, _SIN, _COS),
    "z": (_COS, _COS, _SIN),
}
#: A heading in radians that counts its turns is below.
LARGEST_ANGLE = 1e6
_ANGLES = ("roll", "pitch", "yaw")
#: What is swept, by SIDS.Ax, and what one of SIDD.Targ is in its unit.
SWEPT = {
    **{1 + n: (f"reference_{angle}", _DEG) for n, angle in enumerate(_ANGLES)},
    **{4 + n: (f"reference_{angle}", _DEG) for n, angle in enumerate(_ANGLES)},
    **{7 + n: (f"reference_angular_rate_{axis}", _DEG) for n, axis in enumerate("xyz")},
    **{10 + n: (f"injected_torque_{axis}", 1.0) for n, axis in enumerate("xyz")},
    13: ("injected_throttle", 1.0),
}


def _add_attitude(reading: ardupilot.MessageReading, table: Messages) -> None:
    for part in "wxyz":
        reading.add(f"attitude_{part}", table, partial(_quaternion, table, part), "ATT.Roll, .Pitch and .Yaw")


def _quaternion(table: Messages, part: str) -> Series:
    # a yaw without jumps makes a quaternion without jumps of sign
    result = table.values("Yaw")
    result *= _DEG
    result = _unwrapped(result)
    others = [(table.stored(name), table.layout.fields[name].factor * _DEG) for name in ("Roll", "Pitch")]
    for start, stop in row_blocks(0, table.count, PASSED_ROWS):
        angles = [factor * counts[start:stop].astype(np.float64) for counts, factor in others]
        halves = [0.5 * angle for angle in (*angles, result[start:stop])]
        first, second = (
            np.prod([function(half) for function, half in zip(functions, halves, strict=True)], axis=0)
            for functions in zip(*_FACTORS[part], strict=True)
        )
        result[start:stop] = first + second if part in "wy" else first - second
    return result


#: Setpoints of attitude [deg] and of rates [deg/s] by message, and their columns.
_SETPOINTS = {
    "ATT": {f"reference_{angle}": f"Des{angle.capitalize()}" for angle in _ANGLES},
    "RATE": {f"reference_angular_rate_{axis}": f"{turn}Des" for axis, turn in zip("xyz", "RPY", strict=True)},
}


def _add_setpoints(reading: ardupilot.MessageReading, table: Messages) -> None:
    """Add the setpoints of attitude or of rates, distinguished by who makes them."""
    sticks = ardupilot.STICKS
    modes = reading.with_sweeps(sticks["attitude"]) if table.name == "ATT" else sticks["rates"]
    by_sticks = reading.modes_at(table, modes)
    for name, column in _SETPOINTS[table.name].items():
        for kind, where in (("", by_sticks), ("feedback_", ~by_sticks)):
            if table.has(column) and where.any():
                make_setpoint = partial(_setpoint, table, column, None if where.all() else where)
                reading.add(f"{kind}{name}", table, make_setpoint, f"{table.name}.{column}")


def _setpoint(table: Messages, column: str, where: Bool[np.ndarray, " n"] | None) -> Series:
    """Setpoint [rad, rad/s], and no value where it is of another kind; None where it is not."""
    values = table.values(column)
    values *= _DEG
    values = _unwrapped(values) if column == "DesYaw" else values
    if where is not None:
        values[~where] = np.nan
    return values


def _unwrapped(angle: Series) -> Series:
    """Unwrap an angle [rad] in place; zero where it is no plausible angle."""
    angle[~((angle > -LARGEST_ANGLE) & (angle < LARGEST_ANGLE))] = 0.0
    turns = np.diff(angle)
    turns /= 2.0 * np.pi
    np.round(turns, out=turns)
    if np.any(turns):
        np.cumsum(turns, out=turns)
        turns *= 2.0 * np.pi
        angle[1:] -= turns
    return angle


def _add_sweeps(reading: ardupilot.MessageReading, sweep: Messages) -> None:
    settings = reading.table("SIDS", "Ax")
    # by the last settings before a sample, else by the parameter
    axis = reading.parameters.get("SID_AXIS", 0.0)
    axes = np.full(sweep.count, axis)
    if settings is not None:
        axes = common.held_at(settings.time_s(), settings.values("Ax"), sweep.time_s(), axis)
    present = np.unique(axes).tolist()
    for unused in (axis for axis in present if axis not in SWEPT):
        reading.findings += common.noted("sweep_unused", axis=unused)
    for name, factor in dict.fromkeys(SWEPT[axis] for axis in present if axis in SWEPT):
        swept = np.isin(axes, [axis for axis, (channel, _) in SWEPT.items() if channel == name])
        _add_sweep(reading, name, sweep, np.where(swept, sweep.values("Targ") * factor, 0.0))


def _add_sweep(reading: ardupilot.MessageReading, name: str, sweep: Messages, values: Series) -> None:
    """Add a sweep: zero between its samples, where stick setpoints stay."""
    given_channel = reading.channels.get(name)
    reading.add(name, sweep, np.nan_to_num(values), "SIDD.Targ")
    channel = reading.channels.get(name)
    if channel is None:
        return
    last = np.flatnonzero(np.diff(channel.time_s, append=np.inf) > common.SILENCE_S)
    step = float(np.median(np.diff(channel.time_s))) if channel.time_s.size > 1 else 0.01
    time = np.insert(channel.time_s, last + 1, channel.time_s[last] + step)
    injected = np.insert(channel.values, last + 1, 0.0)
    if time[0] > 0.0:
        time, injected = np.insert(time, 0, 0.0), np.insert(injected, 0, 0.0)
    channel = replace(channel, time_s=time, values=injected)
    merged = channel if given_channel is None else _with_sweep(given_channel, channel)
    reading.put(merged, lambda: merged)


def _with_sweep(channel: Channel, sweep: Channel) -> Channel:
    """Stick setpoint with the sweep in its place while one runs; zero where there is neither."""
    rests = common.held_at(sweep.time_s, sweep.values, channel.time_s, 0.0) == 0.0
    moves = np.flatnonzero(sweep.values != 0.0)
    time = np.concatenate([channel.time_s[rests], sweep.time_s[moves]])
    values = np.concatenate([np.nan_to_num(channel.values[rests]), sweep.values[moves]])
    order = np.argsort(time, kind="stable")
    return clean_channel(
        sweep.name, time[order], values[order], sweep.unit, source=sweep.source, held=sweep.held
    )


#: Functions that add channels of a message, in order, with the columns that they need.
MAKERS: tuple[tuple[Callable[[ardupilot.MessageReading, Messages], None], str, tuple[str, ...]], ...] = (
    (_add_attitude, "ATT", ardupilot.ATTITUDE),
    (_add_setpoints, "ATT", ()),
    (_add_setpoints, "RATE", ()),
    (_add_sweeps, "SIDD", ("Targ",)),
    (_add_modes, "MODE", ()),
    (_add_landed, "EV", ("Id",)),
    (_add_disarmed, "ARM", ("ArmState",)),
    (_add_throttle, "RCIN", ()),
    (_add_air_density, "BARO", ("Press", "Temp")),
    (_add_outputs, "RCOU", ()),
    (_add_rotor_speeds, "ESC", ("RPM",)),
)


#: Kinds of vehicles by what the firmware calls itself, in small letters, and by VER.BU, the kind of firmware.
FIRMWARES: Mapping[str, str] = ardupilot.TABLES["firmwares"]
(BUILDS,) = common.by_number(ardupilot.TABLES, "builds")
#: What a vehicle is by its kind and FRAME_CLASS: helicopters of Copter, boats of Rover.
FRAMES = {**{(ROTARY_WING, number): HELICOPTER for number in (6.0, 11.0, 13.0)}, ("rover", 2.0): "boat"}


def vehicle_of(tables: Mapping[str, Messages], parameters: Mapping[str, float]) -> str:
    """Kind of vehicle in words, empty when the log does not say."""
    kind = _kind_of_firmware(tables)
    if kind == "fixed wing" and parameters.get("Q_ENABLE", 0.0) > 0.0:
        return VTOL
    texts = (text.lower() for (text,) in rows_of(tables, "MSG", "Message"))
    if kind == ROTARY_WING and any(text.startswith("frame: heli") for text in texts):
        return HELICOPTER
    return FRAMES.get((kind, parameters.get("FRAME_CLASS", 0.0)), kind)


def _kind_of_firmware(tables: Mapping[str, Messages]) -> str:
    kinds = [BUILDS[kind] for (kind,) in sorted(rows_of(tables, "VER", "BU")) if kind in BUILDS]
    if kinds:
        return kinds[0]
    for (text,) in rows_of(tables, "MSG", "Message"):
        words = text.lower().split(" v", 1)
        for prefix in ("ardu", "apm:", ""):
            name = words[0].removeprefix(prefix).strip()
            if len(words) == 2 and name in FIRMWARES:
                return FIRMWARES[name]
    return ""


def _advice(channel: str) -> tuple[str, ...]:
    messages = dict.fromkeys(source.message for source in ardupilot.CHANNEL_SOURCES.get(channel, ()))
    return tuple(
        f"ArduPilot logs {name} {ardupilot.RATES[name]}" for name in messages if name in ardupilot.RATES
    )


def read_dataflash(file: Path, _options: common.ReadOptions) -> Recording:
    """Read a DataFlash log."""
    with file.open("rb") as stream:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    tables, findings = _tables(content)
    parameters = _parameters(tables)
    ardupilot.choose_estimator(tables, parameters, findings)
    reading = ardupilot.MessageReading.from_tables(tables, parameters, findings)
    _add_all(reading)
    if not reading.channels:
        raise EmptyLogError(
            "a DataFlash log with flight data (XKF1, NKF1, RATE, CTUN, IMU, ATT, ...)",
            f"'{file.name}' without a value of any of them",
            "Check LOG_BITMASK and LOG_BACKEND_TYPE, that the vehicle was armed, and that the beginning of "
            "the file is there, where messages are described (FMT).",
        )
    findings += delay_findings(reading.heads.values(), parameters)
    findings += common.noted("silent_message", reading.inactive_setpoints)
    return Recording(
        name=file.name,
        format="dataflash",
        channels=reading.channels.finished(),
        frame=Frame.NED,
        parameters=parameters,
        looked_for=ardupilot.LOOKED_FOR,
        findings=(*findings, *common.findings_of(reading.profiles, reading.channels)),
        vehicle=vehicle_of(tables, parameters),
        origin=ardupilot.dataflash_origin(tables, parameters),
    )


def _add_all(reading: ardupilot.MessageReading) -> common.KeptChannels:
    counts = {name: table.count for name, table in reading.tables.items()}
    sources = ardupilot.CHANNEL_SOURCES, ardupilot.CHOSEN_BY_RATE
    for name, source in common.in_preference(*sources, lambda source: counts.get(source.message, 0)):
        if name not in reading.channels:
            _add(reading, name, source)
    for add, message, columns in MAKERS:
        table = reading.table(message, *columns)
        if table is not None:
            add(reading, table)
    reading.forget_clocks()
    reading.channels.cut = lambda *part: _add_all(reading.part(*part))
    return reading.channels


def _tables(content: mmap.mmap) -> tuple[dict[str, Messages], list[Finding]]:
    reader = read_lines if is_text(content[: common.HEAD_BYTES]) else read_messages
    messages, findings = reader(content, ardupilot.NEEDED)
    unusable = sorted(message.name for message in messages if not message.layout.fields)
    findings += common.noted("disagreeing_fields", unusable)
    misfits: list[str] = []
    tables: dict[str, Messages] = {}
    dropped = 0
    for message in messages:
        left_out = message.layout.misfits()
        misfits += [f"{message.name}.{name}" for name in left_out]
        fields = {name: item for name, item in message.layout.fields.items() if name not in left_out}
        if not fields or message.name in tables:
            continue
        lowest = _lowest(replace(message, layout=replace(message.layout, fields=fields)))
        if lowest.clock and lowest.count:
            time_s = lowest.time_s()
            sound = common.believable(time_s - float(np.median(time_s)))
            dropped += int((~sound).sum())
            lowest = lowest.where(sound)
        if lowest.count:
            tables[lowest.name] = lowest
    findings += common.noted("misfit_columns", sorted(misfits)) + common.noted("wrong_stamps", dropped)
    return tables, findings


def _lowest(table: Messages) -> Messages:
    """Messages of the lowest instance of a sensor or a battery that has many of them."""
    if table.name not in ("IMU", "BAT", "CURR", "BARO", "GPS"):
        return table
    column = table.first("I", "Inst", "Instance")
    if not column or not table.count:
        return table
    instances = table.stored(column)
    numbers, counts = np.unique(instances, return_counts=True)
    lowest = numbers[counts >= 0.1 * counts.max()].min()  # others are damage, or were lost at once
    return table.where(instances == lowest)


def _parameters(tables: Mapping[str, Messages]) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, value in rows_of(tables, "PARM", "Name", "Value"):
        if np.isfinite(value) and name.isprintable() and name:
            values.setdefault(name, value)
    return dict(sorted(values.items()))


def _add(reading: ardupilot.MessageReading, name: str, source: ardupilot.MessageSource) -> None:
    table = reading.table(source.message, source.column)
    if table is None:
        return
    factor = source.factor_in(table)
    if source.zero_is_absent and not np.any(np.nan_to_num(table.values(source.column))):
        return

    def values() -> Series:
        result = table.values(source.column)
        result *= factor
        if source.needs_height_loop:
            manual = reading.with_sweeps(ardupilot.WITHOUT_HEIGHT_MODES)
            result[reading.modes_at(table, manual, initial=True)] = np.nan
            result[reading.landed_at(table)] = np.nan
        return result

    reading.add(
        name,
        table,
        values,
        f"{'-' if factor < 0.0 else ''}{table.name}.{source.column}",
        estimated=source.estimated,
        delay_s=delay_of(name, reading.parameters),
        is_setpoint=source.is_setpoint,
        curve_side=CurveSide.BEFORE if name == "input" else CurveSide.UNKNOWN,
    )


FORMATS = (
    common.LogFormat(
        "dataflash",
        "ArduPilot DataFlash",
        lambda head, _: head.startswith(HEAD) or is_text(head) or begins_within(head),
        read_dataflash,
        endings=(".bin", ".log"),
        **common.advised(ardupilot.TABLES["advice"], _advice),
    ),
)
