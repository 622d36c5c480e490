"""A small writer of DataFlash logs: messages of any layout in order of time, a flight in four dialects."""

import struct

import numpy as np

from flights.flight_logs import simulated

__all__ = ["simulated"]

KINDS = {"b": "i1", "B": "u1", "M": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8"}
KINDS |= {"f": "f4", "d": "f8", "g": "f2", "c": "i2", "C": "u2", "e": "i4", "E": "u4", "L": "i4"}
KINDS |= {"n": "S4", "N": "S16", "Z": "S64", "a": "(32,)i2"}
SCALES = {"c": 100, "C": 100, "e": 100, "E": 100, "L": 10_000_000}
BOOT_S = 100.0


def fmt(number, length, name, codes, columns):
    head = struct.pack("<2sBBB", b"\xa3\x95", 128, number, length)
    return head + struct.pack("4s16s64s", name.encode(), codes.encode(), columns.encode())


class DataflashWriter:
    def __init__(self, clock="TimeUS"):
        self.clock = clock
        self.numbers = {"FMT": 128}
        self.head = fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
        self.messages = []
        self.columns, self.codes = {}, {}

    def add(self, name, times_s, codes, **columns):
        """Add messages; a column is an array (n,), or one value for all."""
        times_s = np.atleast_1d(np.asarray(times_s, dtype=float)) + BOOT_S
        codes = ("Q" if self.clock == "TimeUS" else "I") + codes
        kinds = [KINDS[code] for code in codes]
        row = np.dtype(
            [("head", "S2"), ("type", "u1")] + [(f"f{n}", f"<{kind}") for n, kind in enumerate(kinds)]
        )
        number = self.numbers.get(name)
        if number is None:
            number = self.numbers[name] = 129 + len(self.numbers)
            self.columns[name] = [self.clock, *columns]
            self.codes[name] = codes
            self.head += fmt(number, row.itemsize, name, codes, ",".join(self.columns[name]))
        rows = np.zeros(times_s.size, dtype=row)
        rows["head"], rows["type"] = b"\xa3\x95", number
        ticks = np.round(times_s * (1e6 if self.clock == "TimeUS" else 1e3))
        for n, (code, values) in enumerate(zip(codes, [ticks, *columns.values()], strict=True)):
            scaled = np.round(np.multiply(values, SCALES[code])) if code in SCALES else values
            if np.dtype(KINDS[code]).base.kind in "iu":
                scaled = np.round(scaled)
            rows[f"f{n}"] = scaled
        self.messages += [(time, rows[k].tobytes()) for k, time in enumerate(times_s.tolist())]
        return self

    def parameters(self, **values):
        for name, value in values.items():
            self.add("PARM", 0.0, "Nf", Name=name.encode(), Value=value)
        return self

    def text(self, words):
        return self.add("MSG", 0.0, "Z", Message=words.encode())

    def bytes(self):
        return self.head + b"".join(item for _, item in sorted(self.messages, key=lambda pair: pair[0]))

    def lines(self, *, modes=None, newline="\n"):
        """The same log in text, as ground stations write it; `modes` are names for numbers of modes."""
        written = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
        names = {number: name for name, number in self.numbers.items() if number != 128}
        kinds = {name: [KINDS[code] for code in codes] for name, codes in self.codes.items()}
        rows = {
            name: np.dtype(",".join(["S2", "u1", *(f"<{kind}" for kind in item)]))
            for name, item in kinds.items()
        }
        for number, name in names.items():
            columns = ",".join(self.columns[name])
            written.append(f"FMT, {number}, {rows[name].itemsize}, {name}, {self.codes[name]}, {columns}")
        for _, message in sorted(self.messages, key=lambda pair: pair[0]):
            name = names[message[2]]
            values = np.frombuffer(message, rows[name])[0].tolist()[2:]
            cells = [in_text(code, value) for code, value in zip(self.codes[name], values, strict=True)]
            if name == "MODE" and modes:
                cells[1] = modes[cells[1]]
            written.append(", ".join([name, *cells]))
        return "".join(item + newline for item in written).encode()


def in_text(code, value):
    """A field as ground stations write it."""
    if isinstance(value, bytes):
        return value.decode()
    if code in SCALES:
        return f"{value / SCALES[code]:.7f}" if code == "L" else f"{value / SCALES[code]:.2f}"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def told(recording, name):
    """The sentences of a finding of one name."""
    return " ".join(finding.message for finding in recording.findings if finding.name == name)


FIRMWARES = {
    "3.3": "ArduCopter V3.3.3 (acf4cdf7)",
    "3.4": "APM:Copter V3.4.4 (65ffe9d7)",
    "4.1": "ArduCopter V4.1.5 (8ac4b2a6)",
    "4.6": "ArduCopter V4.6.2 (3fc7011a)",
}
#: Number of the mode from each time on.
MODES = {0.0: 3}
#: Of the motors: thrust is (1 - e) x + e x^2 of the share x of the range in use.
CURVE, SPIN_MIN, SPIN_MAX, LOW, HIGH = 1.0, 0.15, 0.95, 1100.0, 1900.0


def flight_log(flight, dialect="4.6", vehicle="", high=HIGH, modes=MODES, true=1.0, in_force=CURVE, every=10):
    """Write a simulated flight as firmware of a dialect logs it, throttle and accelerations at 100 Hz.

    `true` is the curve of the motors, `in_force` the autopilot's; motor outputs are at 100 Hz over `every`.
    """
    values = {name: channel.values for name, channel in flight.channels.items()}
    values |= commands(values["rotor_command_1"] ** 2, true, in_force)
    t = flight.channels["position_z"].time_s
    writer = DataflashWriter("TimeMS" if dialect == "3.3" else "TimeUS")
    writer.text(vehicle or FIRMWARES[dialect]).text("Frame: QUAD")
    writer.parameters(MOT_PWM_MIN=0.0, MOT_PWM_MAX=0.0, RC3_MIN=LOW, RC3_MAX=HIGH)
    writer.parameters(MOT_SPIN_MIN=SPIN_MIN, MOT_SPIN_MAX=SPIN_MAX, MOT_THST_EXPO=in_force)
    numbers = list(modes.values())
    writer.add("MODE", list(modes), "MBB", Mode=numbers, ModeNum=numbers, Rsn=1)
    writer.add("EV", [0.0, 0.0, t[-1]], "B", Id=[10, 28, 18])
    add_fast(writer, t, values, dialect)
    add_estimates(writer, t[::4], {name: value[::4] for name, value in values.items()}, dialect)
    slow = {name: value[::10] for name, value in values.items()}
    add_control(writer, t[::10], slow, dialect)
    widths = LOW + (SPIN_MIN + values["signal"][::every] * (SPIN_MAX - SPIN_MIN)) * (high - LOW)
    writer.add("RCOU", t[::every], "H" * 4, **{f"C{n}": widths for n in range(1, 5)})
    writer.add("RCIN", t[::10], "H" * 3, C1=1500, C2=1500, C3=1300)
    return writer


def commands(thrust, true, in_force):
    """Motor signals that give shares of thrust, and setpoints of which an autopilot makes those signals."""
    signal = np.sqrt(thrust) if true == 1.0 else thrust
    if 0.0 < true < 1.0:
        signal = (np.sqrt((1.0 - true) ** 2 + 4.0 * true * thrust) - (1.0 - true)) / (2.0 * true)
    return {"signal": signal, "throttle": (1.0 - in_force) * signal + in_force * signal**2}


def add_fast(writer, t, values, dialect):
    """Add rates, throttle, accelerations of one or two sensors, and attitude."""
    throttle = values["throttle"] * (1000.0 if dialect == "3.3" else 1.0)
    rates = dict.fromkeys(("RDes", "R", "ROut", "PDes", "P", "POut", "YDes", "Y", "YOut", "ADes", "A"), 0.0)
    writer.add("RATE", t, "f" * 12, **rates, AOut=throttle)
    inertial = dict.fromkeys(("GyrX", "GyrY", "GyrZ", "AccX", "AccY"), 0.0)
    force = -values["specific_force_z"] / values["cos_tilt"]
    roll = np.degrees(np.arccos(np.clip(values["cos_tilt"], -1.0, 1.0)))
    attitude = {"DesRoll": 0.0, "Roll": roll, "DesPitch": 0.0, "Pitch": 0.0}
    attitude |= {"DesYaw": 350.0, "Yaw": np.mod(350.0 + 20.0 * t / t[-1], 360.0)}
    if dialect in ("3.3", "3.4"):
        writer.add("IMU", t, "f" * 6, **inertial, AccZ=force).add("ATT", t, "ccccCC", **attitude)
        return
    for instance in range(2):
        writer.add("IMU", t, "Bffffff", I=instance, **inertial, AccZ=force + 3.0 * instance)
    writer.add("ATT", t, "ffffffB" if dialect == "4.6" else "ccccCCB", **attitude, AEKF=3)


def add_estimates(writer, t, values, dialect):
    """Add estimators and cores, of which one is right."""
    estimate = {"VN": 0.0, "VE": 0.0, "VD": -values["velocity_z"], "PN": 1.0, "PE": 2.0}
    estimate["PD"] = -values["position_z"]
    wrong = estimate | {"VD": 5.0}
    if dialect == "3.3":
        writer.add("EKF1", t, "ffffff", **estimate)
    elif dialect == "3.4":
        writer.add("NKF1", t, "ffffff", **wrong).add("NKF6", t, "ffffff", **estimate)
        writer.add("NKF4", t, "b", PI=1)
    else:
        for core, item in enumerate((wrong, estimate)):
            writer.add("XKF1", t, "Bffffff", C=core, **item)
            writer.add("NKF1", t, "Bffffff", C=core, **wrong)
        writer.add("XKF4", t, "Bb", C=0, PI=1)


def add_control(writer, t, values, dialect):
    """Add targets and battery."""
    height, speed = values["reference_position_z"], values["reference_velocity_z"]
    throttle = values["throttle"]
    if dialect in ("3.3", "3.4"):
        old = dialect == "3.3"
        tuned = {"ThrOut": throttle * 1000.0} if old else {"ThO": throttle}
        climb = 100.0 * speed + 7.0
        writer.add("CTUN", t, ("h" if old else "f") + "ffh", **tuned, DAlt=height, Alt=height, DCRt=climb)
        writer.add("CURR", t, "h" if old else "f", Volt=1480.0 if old else 14.8)
        return
    writer.add("CTUN", t, "fff", ThO=throttle, ThH=0.25, DAlt=0.0)
    target = {"DPD": -height} if dialect == "4.6" else {}
    target |= {"TPD": -height - 0.5, "PD": -height, "DVD": -speed, "TVD": -speed - 0.07, "VD": 0.0}
    target |= {"DAD": -values["reference_acceleration_z"], "TAD": 0.0, "AD": 0.0}
    writer.add("PSCD", t, "f" * len(target), **target)
    writer.add("BAT", t, "Bf", Inst=0, Volt=14.8).add("BAT", t, "Bf", Inst=1, Volt=5.0)
