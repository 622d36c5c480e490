"""Motor outputs as channels: shares of the motors' range, checked against the throttle, and rotor speeds."""

from __future__ import annotations

import numpy as np

from eivor.logs.dataflash.messages import Messages
from eivor.logs.dataflash.motors import OUTPUTS, disagreement, motor_columns, motor_range
from eivor.logs.dataflash.reading import Reading
from eivor.logs.units import UNITS
from eivor.shapes import Float
from eivor.signals.canonical import CurveSide
from eivor.signals.recording import Finding

MAX_ESCS = 32


def add_outputs(reading: Reading) -> None:
    """Add the motors' outputs; the thrust that they stand for is the input where no throttle is logged."""
    table = reading.tables.get("RCOU")
    if table is None or not table.clock:
        return
    columns = _used(table, reading)
    widths = {motor: table.values(column) for motor, column in columns.items()}
    widths = {motor: np.where(one > 0.0, one, np.nan) for motor, one in widths.items()}
    if not widths:
        return
    known = motor_range(reading.parameters)
    if known is None:
        for motor, one in widths.items():
            reading.add(f"actuator_output_{motor}", table, one, f"RCOU.{columns[motor]}", CurveSide.BEHIND)
        sentence = (
            "RCOU holds pulse widths in microseconds, and no parameter tells their range (MOT_PWM_MIN and "
            "MOT_PWM_MAX, or RC3_MIN and RC3_MAX): they stay as they are, and no input map fits an offset."
        )
        reading.findings.append(Finding("pulse_range_unknown", sentence))
        return
    shares = {motor: known.share(one) for motor, one in widths.items()}
    for motor, one in shares.items():
        reading.add(f"actuator_output_{motor}", table, one, f"RCOU.{columns[motor]}", CurveSide.BEHIND)
    sentence = (
        f"RCOU holds pulse widths in microseconds: they are read as shares of the range {known.low:g} to "
        f"{known.high:g} ({known.names}), of which {known.spin_min:g} to {known.spin_max:g} is in use."
    )
    reading.findings.append(Finding("pulse_widths", sentence))
    voltage = _voltage(table, reading)
    thrust = np.mean([known.thrust(one, voltage) for one in shares.values()], axis=0)
    throttle = reading.channels.get("input")
    if throttle is None:
        reading.add("input", table, thrust, "RCOU through the thrust curve", CurveSide.BEFORE)
        return
    asked = np.interp(reading.time_s(table), throttle.time_s, throttle.values)
    free = np.all([(one > 0.0) & (one < 1.0) for one in shares.values()], axis=0)
    doubt = disagreement(np.where(free, asked, np.nan), thrust, known)
    if doubt:
        reading.findings.append(Finding("motor_range", doubt))


def _used(table: Messages, reading: Reading) -> dict[int, str]:
    """Column of each motor; old firmware calls them Ch1, Ch2, ..."""
    columns: dict[int, str] = {}
    for motor, output in motor_columns(reading.parameters).items():
        for column in (f"C{output}", f"Ch{output}", f"Chan{output}"):
            if output <= OUTPUTS and table.has(column):
                columns.setdefault(motor, column)
    return columns


def _voltage(table: Messages, reading: Reading) -> Float[np.ndarray, " n"]:
    """Ratio of the battery's voltage to its largest, by which the thrust is corrected; 1 where it is not."""
    told = reading.tables.get("MOTB")
    column = next((name for name in ("BatVolt", "BV") if told is not None and told.has(name)), "")
    if told is None or not column or not told.clock:
        return np.ones(table.count)
    ratio = told.values(column)
    sound = np.isfinite(ratio) & (ratio > 0.1) & (ratio < 2.0)
    if not sound.any():
        return np.ones(table.count)
    order = np.argsort(told.time_s()[sound], kind="stable")
    return np.asarray(np.interp(table.time_s(), told.time_s()[sound][order], ratio[sound][order]))


def add_rotor_speeds(reading: Reading) -> None:
    """Add the speeds of rotors by the telemetry of their controllers [rad/s]."""
    table = reading.tables.get("ESC")
    column = next((name for name in ("Instance", "I") if table is not None and table.has(name)), "")
    if table is None or not column or not table.has("RPM") or not table.clock:
        return
    instances = table.stored(column)
    motors = {output - 1: motor for motor, output in motor_columns(reading.parameters).items()}
    for instance in np.unique(instances).tolist()[:MAX_ESCS]:
        one = table.where(instances == instance)
        speeds = one.values("RPM") * UNITS["rpm"][1]
        if np.any(np.nan_to_num(speeds)):
            name = f"rotor_speed_{motors.get(instance, instance + 1)}"
            reading.add(name, one, speeds, "ESC.RPM", CurveSide.BEHIND)
