"""A writer of blackbox logs: intra and inter frames with every encoding and predictor that firmware uses."""

import struct

import numpy as np

FIELDS = (  # name, signed, predictors of intra and inter frames, their encodings
    ("loopIteration", 0, 0, 6, 1, 9),
    ("time", 0, 0, 2, 1, 0),
    *((f"axisP[{n}]", 1, 0, 1, 0, 0) for n in range(3)),
    *((f"axisI[{n}]", 1, 0, 1, 0, 7) for n in range(3)),
    *((f"axisD[{n}]", 1, 0, 1, 0, 0) for n in range(2)),
    *((f"axisF[{n}]", 1, 0, 1, 0, 10) for n in range(3)),
    *((f"rcCommand[{n}]", 1, 0, 1, 0, 8) for n in range(3)),
    ("rcCommand[3]", 0, 4, 1, 1, 8),
    *((f"setpoint[{n}]", 1, 0, 1, 0, 8) for n in range(4)),
    ("vbatLatest", 0, 9, 1, 3, 6),
    ("rssi", 0, 0, 1, 1, 6),
    *((f"gyroADC[{n}]", 1, 0, 3, 0, 0) for n in range(3)),
    *((f"accSmooth[{n}]", 1, 0, 3, 0, 0) for n in range(3)),
    ("motor[0]", 0, 11, 3, 1, 0),
    *((f"motor[{n}]", 0, 5, 3, 0, 0) for n in (1, 2, 3)),
    *((f"eRPM[{n}]", 0, 0, 1, 1, 0) for n in range(4)),
)
HEAD = {
    "Data version": "2",
    "I interval": "32",
    "P interval": "1",
    "Firmware type": "Cleanflight",
    "Firmware revision": "Betaflight 4.5.0 (77d01ba3b) STM32F7X2",
    "Craft name": "five inch",
    "Log start datetime": "2025-03-01T10:00:00.000+00:00",
    "minthrottle": "1070",
    "vbatref": "1622",
    "motorOutput": "158,2047",
    "motor_poles": "14",
    "acc_1G": "2048",
    "gyro_scale": "0x3f800000",
    "gyro_lpf1_static_hz": "250",
}
CONSTANTS = {4: 1070, 9: 1622, 11: 158}


def unsigned(value):
    value &= 0xFFFFFFFF
    result = b""
    while value > 127:
        result += bytes([value & 127 | 128])
        value >>= 7
    return result + bytes([value])


def signed(value):
    value = (value + 2**31) % 2**32 - 2**31
    return unsigned((value << 1) ^ (value >> 31))


def tag8_8(values):
    if len(values) == 1:
        return signed(values[0])
    head = sum(1 << n for n, value in enumerate(values) if value)
    return bytes([head]) + b"".join(signed(value) for value in values if value)


def fits(value, bits):
    return -(1 << (bits - 1)) <= value < 1 << (bits - 1)


def in_bytes(values):
    lengths = [next(n for n in (1, 2, 3, 4) if fits(value, 8 * n)) for value in values]
    head = 0xC0 | sum((length - 1) << (2 * n) for n, length in enumerate(lengths))
    pairs = zip(values, lengths, strict=True)
    return bytes([head]) + b"".join(value.to_bytes(length, "little", signed=True) for value, length in pairs)


def packed(values, *packings):
    """The first packing whose fields hold the values: length in bytes, shift and bits of each field."""
    for number, (length, places) in enumerate(packings):
        if all(fits(value, bits) for value, (_, bits) in zip(values, places, strict=True)):
            word = number << (8 * length - 2)
            for value, (shift, bits) in zip(values, places, strict=True):
                word |= (value & (1 << bits) - 1) << shift
            return word.to_bytes(length, "big")
    return in_bytes(values)


def tag2_3(values):
    small, medium = (1, ((4, 2), (2, 2), (0, 2))), (2, ((8, 4), (4, 4), (0, 4)))
    return packed(values, small, medium, (3, ((16, 6), (8, 6), (0, 6))))


def tag2_3_variable(values):
    small, medium = (1, ((4, 2), (2, 2), (0, 2))), (2, ((9, 5), (4, 5), (0, 4)))
    return packed(values, small, medium, (3, ((14, 8), (7, 7), (0, 7))))


def tag8_4(values):
    head, nibbles = 0, []
    for number, value in enumerate(values):
        code = 0 if value == 0 else 1 if fits(value, 4) else 2 if fits(value, 8) else 3
        head |= code << (2 * number)
        width = (0, 1, 2, 4)[code]
        nibbles += [value >> (4 * place) & 15 for place in reversed(range(width))]
    nibbles += [0] * (len(nibbles) % 2)
    pairs = zip(nibbles[::2], nibbles[1::2], strict=True)
    return bytes([head]) + bytes(high << 4 | low for high, low in pairs)


GROUPED = {6: (8, tag8_8), 7: (3, tag2_3), 8: (4, tag8_4), 10: (3, tag2_3_variable)}


def frame(marker, values, encodings):
    result, at = bytes([marker]), 0
    while at < len(values):
        encoding = encodings[at]
        if encoding in GROUPED:
            most, write = GROUPED[encoding]
            end = at + 1
            while end < min(at + most, len(values)) and encodings[end] == encoding:
                end += 1
            result += write(values[at:end])
            at = end
            continue
        if encoding == 3:
            result += unsigned(-values[at] & 0x3FFF)
        elif encoding != 9:
            result += (unsigned if encoding == 1 else signed)(values[at])
        at += 1
    return result


def blackbox_log(columns, head=(), interval=32, fields=FIELDS):
    """A log of integer columns by field; those of `fields` that are missing are left out."""
    fields = [field for field in fields if field[0] in columns]
    names = [field[0] for field in fields]
    rows = np.column_stack([np.asarray(columns[name], dtype=np.int64) for name in names]).tolist()
    lines = ["H Product:Blackbox flight data recorder by Nicholas Sherlock"]
    lines += [f"H {key}:{value}" for key, value in {**HEAD, **dict(head)}.items()]
    for place, key in enumerate(
        ("I name", "I signed", "I predictor", "P predictor", "I encoding", "P encoding")
    ):
        lines.append(f"H Field {key}:" + ",".join(str(field[place]) for field in fields))
    content = [("\n".join(lines) + "\n").encode()]
    motor = names.index("motor[0]") if "motor[0]" in names else 0
    before = earlier = rows[0]
    for number, row in enumerate(rows):
        intra = number % interval == 0
        left = []
        for field, value in enumerate(row):
            predictor = fields[field][2 if intra else 3]
            b, e = before[field], earlier[field]
            guess = {0: 0, 1: b, 2: 2 * b - e, 3: int((b + e) / 2), 5: row[motor], 6: value}
            left.append(value - (guess | CONSTANTS)[predictor])
        encodings = [field[4 if intra else 5] for field in fields]
        content.append(frame(ord("I") if intra else ord("P"), left, encodings))
        earlier, before = (row if intra else before), row
    return b"".join([*content, b"E\xffEnd of log\0"])


def gyro_scale(value):
    return f"0x{struct.unpack('<I', struct.pack('<f', value))[0]:08x}"
