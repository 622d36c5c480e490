"""Reader of blackbox logs of Betaflight and INAV: frames of delta-encoded fields, decoded in blocks."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from eivor.errors import CorruptLogError, EmptyLogError
from eivor.logs.channel_map import ChannelMap, ChannelRule, Expression, load_channel_map
from eivor.logs.common import (
    LOG_TABLES,
    Columns,
    LogFormat,
    ReadOptions,
    advised,
    begins_with,
    believable,
    noted,
)
from eivor.logs.mapping import fitted_rules, mapped_recording
from eivor.signals.recording import Finding, LogOrigin, Recording

MAGIC = b"H Product:Blackbox"
SIGNED, UNSIGNED, NEGATIVE_14, TAG8_8, TAG2_3, TAG8_4, NOTHING, TAG2_3_VARIABLE = 0, 1, 3, 6, 7, 8, 9, 10
#: How many fields share an encoding's tag.
GROUPS = {TAG2_3: 3, TAG8_4: 4, TAG2_3_VARIABLE: 3}
#: Bytes of each packing of three fields, and shift and bits of each field in them, the highest byte first.
_TWO_BITS = (1, ((4, 2), (2, 2), (0, 2)))
PACKINGS = {
    TAG2_3: (_TWO_BITS, (2, ((8, 4), (4, 4), (0, 4))), (3, ((16, 6), (8, 6), (0, 6)))),
    TAG2_3_VARIABLE: (_TWO_BITS, (2, ((9, 5), (4, 5), (0, 4))), (3, ((14, 8), (7, 7), (0, 7)))),
}
#: Predictors of fields: by frames before theirs, by the first motor of the same frame, by counting frames.
PREVIOUS, STRAIGHT, AVERAGE, MOTOR_0, INCREMENT = 1, 2, 3, 5, 6
#: Predictors that add a number of the head: its key, and what it is where the head has none.
CONSTANTS = {4: ("minthrottle", 1150), 8: ("", 1500), 9: ("vbatref", 4095), 11: ("motorOutput", 1150)}
#: Kinds of frames: intra, inter, GPS, GPS home, slow, event.
MARKERS = b"IPGHSE"
INTRA, INTER, EVENT = b"IPE"
#: Frames are no longer than this [bytes], lines of the head, and fields of a frame no more than this.
FRAME_BYTES, LINE_BYTES, MOST_FIELDS = 256, 4096, 128
#: Numbers that are decoded for each byte of the log, at most.
NUMBERS_PER_BYTE = 8
#: Frames that are decoded at a time.
BLOCK = 1 << 17
#: Events: how many numbers of variable length follow, and the words of the last event.
EVENTS = {0: 1, 14: 2, 15: 1, 30: 2}
ADJUSTMENT, LAST_EVENT = 13, b"\xffEnd of log\0"
#: The clock, as `blackbox_decode` names it.
CLOCK = "time (us)"
#: Counts of the accelerometer to a g in the shipped maps.
COUNTS = 2048.0
_TABLE = LOG_TABLES["blackbox"]

Block = np.ndarray  # (n,) numbers of frames


# -- Head --


@dataclass(frozen=True, slots=True)
class FrameFields:
    """What frames of a kind hold, by field."""

    names: tuple[str, ...]
    signed: tuple[int, ...]
    predictors: tuple[int, ...]
    encodings: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Head:
    """The head of a log: its keys, and the fields of each kind of frame."""

    values: Mapping[str, str]
    frames: Mapping[int, FrameFields]
    end: int  # Where the frames begin

    @property
    def firmware(self) -> str:
        """Name and version."""
        return self.values.get("Firmware revision", "")

    def numbers(self, key: str, default: float = math.nan) -> tuple[float, ...]:
        """Numbers of a key; the default where it has none, or none of 32 bits."""
        try:
            result = tuple(float(item) for item in self.values[key].split(","))
        except (KeyError, ValueError):
            return (default,)
        return result if all(abs(item) < 1 << 32 for item in result) else (default,)

    def constant(self, predictor: int) -> int:
        """Constant that a predictor adds to a field of every frame."""
        key, default = CONSTANTS.get(predictor, ("", 0))
        return int(self.numbers(key, default)[0])


def _parse_head(data: bytes, begins: int, end: int, name: str) -> Head:
    values: dict[str, str] = {}
    offset = begins
    while data.startswith(b"H ", offset):
        line_end = data.find(b"\n", offset, min(offset + LINE_BYTES, end))
        if line_end < 0:
            break
        key, _, value = data[offset + 2 : line_end].decode("utf-8", "replace").partition(":")
        values[key] = value.strip()
        offset = line_end + 1
    frames = {kind: _parse_fields(values, chr(kind), name) for kind in MARKERS if kind != EVENT}
    return Head(values, {kind: fields for kind, fields in frames.items() if fields.names}, offset)


def _parse_fields(values: Mapping[str, str], kind: str, name: str) -> FrameFields:
    source = "I" if kind == "P" else kind
    names = tuple(values.get(f"Field {source} name", "").split(","))
    if names == ("",):
        return FrameFields((), (), (), ())
    rows = []
    for key in (f"{source} signed", f"{kind} predictor", f"{kind} encoding"):
        text = values.get(f"Field {key}", "")
        row = tuple(int(word) for word in text.split(",") if word.strip().isdecimal())
        if len(row) != len(names) or len(names) > MOST_FIELDS:
            problem = f"whose head has {len(row)} numbers for 'Field {key}', of {len(names)} fields"
            raise _corrupt(name, problem)
        rows.append(row)
    fields = FrameFields(names, *rows)
    encodings = {SIGNED, UNSIGNED, NEGATIVE_14, TAG8_8, NOTHING, *GROUPS}
    inter_only = {PREVIOUS, STRAIGHT, AVERAGE, INCREMENT} if kind == "I" else set()
    predictors = {*range(12), 256} - inter_only
    sound = encodings.issuperset(fields.encodings) and predictors.issuperset(fields.predictors)
    motors = [name for name, p in zip(names, fields.predictors, strict=True) if p == MOTOR_0]
    sound &= not motors or ("motor[0]" in names and "motor[0]" not in motors)
    if not sound or any(end > len(names) for _, _, end in _groups(fields)):
        raise _corrupt(name, f"whose fields of frames {kind} have an encoding or predictor that is not known")
    return fields


def _groups(fields: FrameFields) -> Iterator[tuple[int, int, int]]:
    """Encoding, first field and end of each group of fields that are decoded together."""
    first = 0
    while first < len(fields.names):
        encoding, end = fields.encodings[first], first + 1
        if fields.predictors[first] == INCREMENT:
            encoding = NOTHING
        elif encoding in GROUPS:
            end = first + GROUPS[encoding]
        elif encoding == TAG8_8:
            while end < min(first + 8, len(fields.names)) and fields.encodings[end] == TAG8_8:
                end += 1
        yield encoding, first, end
        first = end


def _corrupt(name: str, problem: str) -> CorruptLogError:
    remedy = "Copy the log from the flight controller again, or convert it with `blackbox_decode` to CSV."
    return CorruptLogError("a blackbox log of Betaflight or INAV", f"'{name}', {problem}", remedy)


# -- Encodings --


def _extended(value: Block, bits: int) -> Block:
    """Numbers of so many bits with their sign."""
    half = 1 << (bits - 1)
    return (value & (2 * half - 1) ^ half) - half


def _unsigned(data: Block, offset: Block) -> tuple[Block, Block]:
    """Seven bits a byte, the lowest first; the eighth says that more follow."""
    value, unfinished = np.zeros_like(offset), np.ones(offset.shape, dtype=np.bool_)
    for number in range(5):
        byte = data[offset].astype(np.int64)
        value |= np.where(unfinished, (byte & 127) << (7 * number), 0)
        offset = offset + unfinished
        unfinished = unfinished & (byte >= 128)
        if not unfinished.any():
            break
    return value & 0xFFFFFFFF, offset


def _signed(data: Block, offset: Block) -> tuple[Block, Block]:
    value, offset = _unsigned(data, offset)
    return (value >> 1) ^ -(value & 1), offset


def _tagged_8(data: Block, offset: Block, count: int) -> tuple[list[Block], Block]:
    """One bit for each field that is not zero; without a tag for a single field."""
    if count == 1:
        value, offset = _signed(data, offset)
        return [value], offset
    tag, offset, values = data[offset].astype(np.int64), offset + 1, []
    for number in range(count):
        value, logged = np.zeros_like(offset), (tag >> number & 1).astype(np.bool_)
        value[logged], offset[logged] = _signed(data, offset[logged])
        values.append(value)
    return values, offset


def _nibbles(data: Block, offset: Block) -> tuple[list[Block], Block]:
    """Two bits for each of four fields: they have 0, 1, 2 or 4 nibbles, the highest first."""
    tag, nibble, values = data[offset].astype(np.int64), 2 * (offset + 1), []
    for number in range(4):
        width = np.array([0, 1, 2, 4])[tag >> (2 * number) & 3]
        value = np.zeros_like(offset)
        for index in range(4):
            present = index < width
            half = data[nibble >> 1].astype(np.int64) >> (4 * (1 - (nibble & 1))) & 15
            value = np.where(present, value << 4 | half, value)
            nibble = nibble + present
        half = 1 << np.maximum(4 * width - 1, 0)
        values.append(np.where(width > 0, (value ^ half) - half, 0))
    return values, (nibble + 1) >> 1


def _tagged_2(data: Block, offset: Block, encoding: int) -> tuple[list[Block], Block]:
    """Two bits for three fields: packed in one to three bytes, or one to four bytes each."""
    values = [np.zeros_like(offset) for _ in range(3)]
    tag = data[offset].astype(np.int64)
    end = offset + 1
    for number, (length, places) in enumerate(PACKINGS[encoding]):
        chosen = np.flatnonzero(tag >> 6 == number)
        word = np.zeros_like(chosen)
        for byte in range(length):
            word = word << 8 | data[offset[chosen] + byte].astype(np.int64)
        end[chosen] = offset[chosen] + length
        for value, (shift, bits) in zip(values, places, strict=True):
            value[chosen] = _extended(word >> shift, bits)
    return _in_bytes(data, end, tag, values)


def _in_bytes(data: Block, start: Block, tag: Block, values: list[Block]) -> tuple[list[Block], Block]:
    """The fourth packing: two bits for the bytes of each field, the lowest byte first."""
    chosen = np.flatnonzero(tag >> 6 == 3)
    offset, lengths = start[chosen], tag[chosen]
    for number, value in enumerate(values):
        length = (lengths >> (2 * number) & 3) + 1
        word = np.zeros_like(offset)
        for byte in range(4):
            word |= np.where(byte < length, data[offset + byte].astype(np.int64) << (8 * byte), 0)
        half = 1 << (8 * length - 1)
        value[chosen] = (word ^ half) - half
        offset = offset + length
    start[chosen] = offset
    return values, start


# -- Frames --


def _decode(data: Block, offset: Block, fields: FrameFields) -> tuple[dict[int, Block], Block]:
    """Raw values of frames at offsets in a log, by field, and the end of each frame."""
    values: dict[int, Block] = {}
    last = data.size - FRAME_BYTES
    for encoding, first, end in _groups(fields):
        offset = np.minimum(offset, last)
        if encoding == NOTHING:
            group = [np.zeros_like(offset)]
        elif encoding == TAG8_8:
            group, offset = _tagged_8(data, offset, end - first)
        elif encoding == TAG8_4:
            group, offset = _nibbles(data, offset)
        elif encoding in PACKINGS:
            group, offset = _tagged_2(data, offset, encoding)
        elif encoding == SIGNED:
            value, offset = _signed(data, offset)
            group = [value]
        else:
            value, offset = _unsigned(data, offset)
            group = [-_extended(value, 14) if encoding == NEGATIVE_14 else value]
        values |= dict(zip(range(first, end), group, strict=True))
    return values, offset


def _lengths(data: Block, begins: int, end: int, frames: Mapping[int, FrameFields]) -> np.ndarray:
    """Length of the frame that each byte would begin; zero where none can [bytes]."""
    result = np.zeros(end + 1, dtype=np.uint16)
    for kind, fields in frames.items():
        starts = begins + np.flatnonzero(data[begins:end] == kind)
        for block in np.array_split(starts, range(BLOCK, starts.size, BLOCK)):
            _, ends = _decode(data, block + 1, fields)
            length = ends - block
            result[block] = np.where((length <= FRAME_BYTES) & (ends <= end), length, 0)
    return result


def _event_length(data: bytes, start: int) -> int:
    """Length of the event that a byte begins; zero where it is of no known kind [bytes]."""
    kind = data[start + 1]
    if data.startswith(LAST_EVENT, start + 1):
        return 1 + len(LAST_EVENT)
    offset, numbers = start + 2, EVENTS.get(kind, 0)
    if kind == ADJUSTMENT:
        offset, numbers = (offset + 5, 0) if data[offset] > 127 else (offset + 1, 1)
    elif not numbers:
        return 0
    for _ in range(numbers):
        offset = next((byte + 1 for byte in range(offset, offset + 5) if data[byte] < 128), offset + 5)
    return offset - start


def _chain(data: bytes, begins: int, end: int, lengths: np.ndarray) -> tuple[list[int], list[int], int]:
    """Starts of frames, indices of frames after damage, and the number of bytes outside frames.

    After damage frames go on from the next byte that begins two of them.
    """
    starts, broken, lost = list[int](), list[int](), 0
    sizes, pos = memoryview(lengths.data), begins

    def frame_size(start: int) -> int:
        size = _event_length(data, start) if data[start] == EVENT else sizes[start]
        stop = start + size
        return size if size and (stop == end or (stop < end and data[stop] in MARKERS)) else 0

    while pos < end:
        size = frame_size(pos)
        if not size:
            damaged, candidates = pos, (start for start in range(pos + 1, end) if data[start] in MARKERS)
            pos = next(filter(frame_size, candidates), end)
            lost += pos - damaged
            broken.append(len(starts))
            continue
        if data[pos] in (INTRA, INTER):
            starts.append(pos)
        elif data.startswith(LAST_EVENT, pos + 1):
            break
        pos += size
    return starts, broken, lost


# -- Prediction --


def _main_columns(
    data: Block, starts: np.ndarray, broken: Sequence[int], head: Head, selected: Sequence[int]
) -> dict[str, np.ndarray]:
    """Fields of intra and inter frames; after damage none before the next intra frame."""
    inter = data[starts] == INTER
    segment = np.cumsum(~inter)
    usable = segment > 0
    for number in broken:
        if number < starts.size and inter[number]:
            usable[number : np.searchsorted(segment, segment[number], side="right")] = False
    starts, inter = starts[usable], inter[usable]
    raw = {field: np.zeros(starts.size, dtype=np.int64) for field in selected}
    intra_fields, inter_fields = head.frames[INTRA], head.frames[INTER]
    for fields, frames in ((intra_fields, ~inter), (inter_fields, inter)):
        rows = np.flatnonzero(frames)
        for block in np.array_split(rows, range(BLOCK, rows.size, BLOCK)):
            values, _ = _decode(data, starts[block] + 1, fields)
            for field in selected:
                raw[field][block] = values[field] + head.constant(fields.predictors[field])
    names, columns = intra_fields.names, dict[str, np.ndarray]()
    for field in sorted(selected, key=lambda item: names[item] != "motor[0]"):
        value, predictor = raw[field], inter_fields.predictors[field]
        by_motor = np.where(inter, predictor == MOTOR_0, intra_fields.predictors[field] == MOTOR_0)
        if by_motor.any():
            value[by_motor] += columns["motor[0]"][by_motor]
        value = _integrate_predictions(value, inter, predictor)
        columns[names[field]] = value.astype(np.int32 if intra_fields.signed[field] else np.uint32)
    return columns


def _integrate_predictions(value: Block, inter: np.ndarray, predictor: int) -> Block:
    """Add the predictions of inter frames from earlier frames, since the last intra frame."""
    if predictor == AVERAGE:
        values, previous, earlier = value.tolist(), 0, 0
        for number, is_inter in enumerate(inter.tolist()):
            if is_inter:
                earlier, previous = previous, values[number] + int((previous + earlier) / 2)
            else:
                earlier = previous = values[number]
            values[number] = previous
        return np.array(values, dtype=np.int64)
    if predictor not in (PREVIOUS, STRAIGHT):
        return value
    begin = np.maximum.accumulate(np.where(inter, 0, np.arange(value.size)))
    start, steps = value[begin], np.where(inter, value, 0)
    for _ in range(predictor):
        total = np.cumsum(steps)
        steps = total - total[begin]
    return start + steps


# -- Reader --


def read_blackbox(file: Path, options: ReadOptions) -> Recording:
    """Read the longest log of a file: one is added each time that the vehicle is armed."""
    data = file.read_bytes()
    begins = [match.start() for match in re.finditer(MAGIC, data)]
    first, end = max(pairwise([*begins, len(data)]), key=lambda log: log[1] - log[0])
    findings = noted("several_logs", len(begins) if len(begins) > 1 else 0)
    head = _parse_head(data, first, end, file.name)
    if INTRA not in head.frames or INTER not in head.frames or "time" not in head.frames[INTRA].names:
        raise _corrupt(file.name, "whose head does not say what its frames hold")
    padded = data[first:end] + bytes(2 * FRAME_BYTES)
    columns, lost = _read_columns(padded, head, head.end - first, end - first, file.name)
    findings += noted("frame_bytes", lost)
    findings += _filter_findings(head)
    chosen = _chosen_map(columns, options, head.firmware)
    rules = fitted_rules(chosen, list(columns), file.name)
    recording = mapped_recording(
        chosen, rules, Columns(columns), name=file.name, log_format="blackbox", findings=findings
    )
    origin = LogOrigin(firmware=head.firmware, airframe=head.values.get("Craft name", ""), start=_start(head))
    return replace(recording, origin=origin)


def _read_columns(
    padded: bytes, head: Head, begins: int, end: int, name: str
) -> tuple[dict[str, np.ndarray], int]:
    """Columns with the names and units of `blackbox_decode`, and the number of bytes outside frames."""
    data = np.frombuffer(padded, dtype=np.uint8)
    firsts, broken, lost = _chain(padded, begins, end, _lengths(data, begins, end, head.frames))
    selected = [field for field, label in enumerate(head.frames[INTRA].names) if label != "loopIteration"]
    starts = np.array(firsts, dtype=np.int64)
    if starts.size * len(selected) > NUMBERS_PER_BYTE * end + 1_000_000:
        raise _corrupt(name, f"whose {starts.size} frames hold more than {NUMBERS_PER_BYTE} numbers a byte")
    raw = _main_columns(data, starts, broken, head, selected) if starts.size else {}
    clock = raw.pop("time", np.empty(0, dtype=np.int64)).astype(np.int64)
    if not clock.size:
        received = f"'{name}', without a whole frame after its head"
        remedy = "Arm the vehicle, and copy the log again."
        raise EmptyLogError("a blackbox log with frames", received, remedy)
    steps = np.diff(clock, prepend=clock[0]).astype(np.int32)
    stamps = clock[0] + np.cumsum(steps, dtype=np.float64)
    sound = believable(1e-6 * (stamps - stamps[0]))
    sound &= stamps >= np.maximum.accumulate(np.where(sound, stamps, -np.inf))
    columns = {CLOCK: stamps[sound] - stamps[0]}
    for field, values in raw.items():
        words, factor, offset = _scale(field, head)
        columns[words] = factor * (values[sound] - offset)
    for axis in range(3):
        if f"axisP[{axis}]" in columns:
            for part in "IDF":
                columns.setdefault(f"axis{part}[{axis}]", np.zeros(columns[CLOCK].size))
    return columns, lost


def _scale(field: str, head: Head) -> tuple[str, float, float]:
    """Name of a column, and factor and offset that make its unit of what is logged."""
    stem, factor, offset = field.partition("[")[0], 1.0, 0.0
    fine = 10.0 if head.numbers("blackbox_high_resolution", 0.0)[0] == 1.0 else 1.0
    low, high = (*head.numbers("motorOutput"), math.nan)[:2]
    if stem == "gyroADC":
        factor = _gyro_scale(head) / fine
    elif stem in ("setpoint", "rcCommand") and not field.endswith("[3]"):
        factor = 1.0 / fine
    elif stem == "accSmooth":
        factor = COUNTS / max(head.numbers("acc_1G", COUNTS)[0], 1.0)
    elif stem == "motor" and high > low and not head.firmware.startswith("INAV"):
        factor, offset = 1.0 / (high - low), low
    elif stem == "eRPM":
        pole_pairs = max(head.numbers("motor_poles", 14.0)[0], 2.0) / 2.0
        factor = 100.0 / pole_pairs * 2.0 * np.pi / 60.0
    elif field == "vbatLatest":
        field, factor = "vbatLatest (V)", 0.01
    return field, factor, offset


def _gyro_scale(head: Head) -> float:
    """Degrees a second of a count: the bits of a number of four bytes."""
    text = head.values.get("gyro_scale", head.values.get("gyro.scale", ""))
    try:
        (scale,) = struct.unpack("<f", struct.pack("<I", int(text, 16)))
    except (ValueError, struct.error):
        return 1.0
    return float(scale) if math.isfinite(scale) and scale > 0.0 else 1.0


def _chosen_map(columns: Mapping[str, np.ndarray], options: ReadOptions, firmware: str) -> ChannelMap:
    """The given map, or the shipped map of the firmware, with the speeds of rotors that are logged."""
    if options.channel_map is not None:
        return load_channel_map(options.channel_map)
    navigates = firmware.startswith("INAV") and "navPos[2]" in columns
    chosen = load_channel_map("inav_csv" if navigates else "betaflight_csv")
    speeds = [
        ChannelRule(f"rotor_speed_{number + 1}", Expression.of_column(f"eRPM[{number}]"))
        for number in range(8)
        if f"eRPM[{number}]" in columns
    ]
    return replace(chosen, rules=(*chosen.rules, *speeds), origin=firmware or "the firmware")


def _filter_findings(head: Head) -> list[Finding]:
    """Low-pass filters of the gyroscope, whose delay is a part of the lag."""
    cut_offs = [f"{hz:g}" for key in _TABLE["low_passes"] if (hz := head.numbers(key, 0.0)[0]) > 0.0]
    return noted("gyro_filters", " and ".join(cut_offs))


def _start(head: Head) -> datetime | None:
    try:
        start = datetime.fromisoformat(head.values.get("Log start datetime", ""))
    except ValueError:
        return None
    return start if start.tzinfo is not None and start.year > 2000 else None


FORMATS = (
    LogFormat(
        "blackbox",
        "Betaflight and INAV blackbox",
        begins_with(MAGIC),
        read_blackbox,
        takes_map=True,
        endings=(".bbl", ".bfl"),
        **advised(_TABLE["advice"], lambda _channel: tuple(_TABLE["advice"]["all"])),
    ),
)
