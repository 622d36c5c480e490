"""DataFlash logs in text: what the binary log of the same flight holds."""

import numpy as np
import pytest
from dataflash_writer import DataflashWriter, flight_log, simulated, survives, told

from eivor.errors import EmptyLogError
from eivor.logs import read_log
from eivor.logs.dataflash import messages


@pytest.fixture(scope="module")
def flight():
    return simulated(seed=3, duration=2.0)


@pytest.fixture
def read(tmp_path):
    def read(content):
        path = tmp_path / "flight.log"
        path.write_bytes(content)
        return read_log(path)

    return read


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("dialect", "block"),
    [
        ("3.3", messages.TEXT_BLOCK_BYTES),
        ("3.4", messages.TEXT_BLOCK_BYTES),
        ("4.1", 3000),
        ("4.6", messages.TEXT_BLOCK_BYTES),
    ],
)
def test_the_channels_and_numbers_of_the_binary_log(read, flight, monkeypatch, dialect, block):
    monkeypatch.setattr(messages, "TEXT_BLOCK_BYTES", block)
    writer = flight_log(flight, dialect)
    written, binary = read(writer.lines()), read(writer.bytes())
    assert list(written.channels) == list(binary.channels)
    for name, channel in binary.channels.items():
        np.testing.assert_array_equal(written.channels[name].time_s, channel.time_s, err_msg=name)
        np.testing.assert_array_equal(written.channels[name].values, channel.values, err_msg=name)
        assert written.channels[name].source == channel.source
    assert (written.format, written.frame, written.vehicle) == ("dataflash", binary.frame, "rotary wing")
    assert written.parameters == binary.parameters
    assert written.findings == binary.findings


@pytest.mark.parametrize("names", [{"3": "Auto", "0": "STABILIZE"}, {"3": "Auto", "0": "0"}])
def test_modes_by_name_and_lines_of_windows(read, flight, names):
    writer = flight_log(flight, "3.4", modes={0.0: 3, 1.0: 0})
    for column in ("ModeNum", "Other"):
        writer.columns["MODE"] = [writer.clock, "Mode", column, "Rsn"]
        log = read(b"Ready to drive.\r\n\r\n" + writer.lines(modes=names, newline="\r\n"))
        assert log.channels["input_open_loop"].values.tolist() == [0.0, 1.0]


@pytest.mark.parametrize("how", ["mark", "tabs", "indented", "empty lines"])
def test_spaces_and_marks_around_names(read, flight, how):
    plain = flight_log(flight, "4.6").lines()
    written = {
        "mark": b"\xef\xbb\xbf" + plain,
        "tabs": plain.replace(b", ", b" ,\t"),
        "indented": b" \t" + plain.replace(b"\n", b"\n \t")[:-2],
        "empty lines": b"\r\n\n" + plain.replace(b"\n", b"\n\n"),
    }[how]
    assert written != plain
    log, expected = read(written), read(plain)
    assert log.findings == expected.findings
    assert list(log.channels) == list(expected.channels)
    np.testing.assert_array_equal(log.channels["input"].values, expected.channels["input"].values)


def test_a_text_with_commas(read):
    writer = DataflashWriter().text("ArduCopter V4.6.2, with a comma").add("RATE", [0.0, 0.1], "f", AOut=0.4)
    assert read(writer.lines()).vehicle == "rotary wing"


def test_damaged_lines_are_left_out_and_counted(read, flight):
    writer = flight_log(flight, "4.6")
    lines = writer.lines().split(b"\n")
    index = next(n for n, line in enumerate(lines) if line.startswith(b"XKF1"))
    lines[index] = lines[index].replace(b"XKF1", b"XK@1")
    lines[index + 20 :] = [
        line.replace(b"1", b"?") if n < 3 else line for n, line in enumerate(lines[index + 20 :])
    ]
    lines[5:5] = [b"FMT, 900, 20, ABC, Qf, TimeUS,X", b"FMT, 1", b"FMT, 77, 20, ABC, Q" + b"f" * 40 + b", X"]
    lines = [b"BAT, 1" if line.startswith(b"BAT") else line for line in lines]
    lines[-1:] = [b"RATE, " + b"9" * 5000, b"RATE, 1"]
    log = read(b"\n".join(lines))
    assert "battery_voltage" not in log.channels
    assert "lines that are no message" in told(log, "corrupt_parts")
    assert "left out: 3" in told(log, "message_formats")
    assert "ends within a line (7 bytes" in told(log, "truncated")
    assert abs(log.channels["velocity_z"].values.size - 50) <= 3


def test_a_log_without_flight_data(read):
    with pytest.raises(EmptyLogError, match="LOG_BITMASK"):
        read(b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format\n")


def mutated(content, seed):
    rng = np.random.default_rng(seed)
    data = bytearray(content)
    for integer in rng.integers(70, len(data), size=rng.integers(1, 30)).tolist():
        if seed % 2:
            data[integer] = int(rng.integers(256))
        else:
            del data[integer : integer + int(rng.integers(1, 200))]
    return bytes(data)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("dialect", ["3.3", "4.6"])
def test_mutated_logs(read, dialect):
    content = flight_log(simulated(seed=3, duration=2.0), dialect).lines()
    assert all(survives(read, mutated(content, seed)) for seed in range(12))
