"""Damaged DataFlash logs: what is sound is read, the rest is counted, and nothing else happens."""

import numpy as np
import pytest
from dataflash_writer import FIRMWARES, KINDS, DataflashWriter, fmt, survives, told

from eivor.errors import EmptyLogError
from eivor.logs import read_log
from eivor.logs.dataflash import messages


def writer(n=60):
    t = np.arange(n) * 0.02
    wave = np.sin(t)
    parameters = DataflashWriter().text(FIRMWARES["4.6"]).parameters(MOT_PWM_MIN=1000.0, MOT_PWM_MAX=2000.0)
    parameters.add("MODE", 0.0, "MB", Mode=3, ModeNum=3).add("EV", [0.0, 0.1], "B", Id=[10, 28])
    parameters.add("XKF1", t, "Bfff", C=0, VN=wave, VD=wave, PD=wave)
    parameters.add("RATE", t, "ff", R=wave, AOut=0.5 + 0.1 * wave)
    parameters.add("IMU", t, "Bfff", I=0, AccX=0.0, AccY=0.0, AccZ=-9.8 + wave)
    parameters.add("ATT", t, "ccC", Roll=wave, Pitch=wave, Yaw=10.0)
    parameters.add("RCOU", t[::5], "HHHH", C1=1500, C2=1500, C3=1500, C4=1500)
    return parameters.add("PSCD", t[::5], "ff", DPD=wave[::5], DVD=wave[::5]).units()


@pytest.fixture(scope="module")
def sound():
    return writer().bytes()


@pytest.fixture
def read(tmp_path):
    def read(content):
        path = tmp_path / "flight.bin"
        path.write_bytes(content)
        return read_log(path)

    return read


def test_cut_within_a_message(read, sound):
    r = read(sound[:-5])
    assert "ends within a message" in told(r, "truncated")
    assert r.channels["velocity_z"].values.size == 60


@pytest.mark.parametrize("block", [64, 1000, messages.BLOCK_BYTES])
@pytest.mark.parametrize("extra", [b"\0" * 7, b"\xa3\x95", b"\xa3\x95\xfe" * 30, bytes(range(256)) * 4])
def test_bytes_between_messages(read, sound, monkeypatch, block, extra):
    monkeypatch.setattr(messages, "BLOCK_BYTES", block)
    middle = writer()
    middle.messages.insert(200, (middle.messages[200][0], extra))
    pairs = middle.messages
    content = middle.head + b"".join(item for _, item in pairs)
    r = read(content)
    whole = read(middle.head + b"".join(item for _, item in pairs if item is not extra))
    assert "bytes that belong to no message" in told(r, "corrupt_parts")
    lost = [whole.channels[name].values.size - r.channels[name].values.size for name in whole.channels]
    assert set(lost) <= {0, 1}
    assert "corrupt_parts" not in [finding.name for finding in whole.findings]


def test_lost_bytes_cost_one_message(read, sound):
    cut = len(sound) - 1000
    r = read(sound[:cut] + sound[cut + 4 :])
    assert told(r, "corrupt_parts")
    counts = {r.channels[name].values.size for name in ("velocity_z", "input", "attitude_w")}
    assert counts <= {59, 60}


def test_a_stamp_far_ahead_costs_its_message_only(read):
    item = writer()
    position = next(n for n, pair in enumerate(item.messages) if pair[1][2] == item.numbers["XKF1"]) + 20
    time, row = item.messages[position]
    item.messages[position] = (time, row[:9] + b"\x40" + row[10:])  # eight thousand years ahead
    r = read(item.bytes())
    assert r.channels["velocity_z"].values.size == 59
    assert "cannot be: 1" in told(r, "time_stamps")


def test_layouts_that_cannot_be(read, sound):
    index = sound.index(b"XKF1") - 5
    assert "left out: 1" in told(read(sound[: index + 4] + b"\0" + sound[index + 5 :]), "message_formats")
    names = sound.index(b"C,VN,VD")
    r = read(sound[:names] + b"C,VN;VD" + sound[names + 7 :])
    assert "disagree: XKF1" in told(r, "message_formats")
    assert "velocity_z" not in r.channels
    assert r.channels["input"].values.size == 60


def test_bytes_that_look_like_a_layout_by_chance_are_no_damage(read):
    item = writer()
    position = next(n for n, pair in enumerate(item.messages) if pair[1][2] == item.numbers["IMU"]) + 20
    time, row = item.messages[position]
    item.messages[position] = (time, row[:-4] + b"\xa3\x95\x80\x41")
    r = read(item.bytes())
    assert not told(r, "message_formats")
    assert r.channels["specific_force_body_z"].values.size == 60


@pytest.mark.parametrize("before", [b"\0" * 512, b"\x80FMT\0BBnNZ", b""])
def test_a_log_whose_beginning_is_lost(read, sound, before):
    lost = read(before + sound[37:])
    whole = read(sound)
    assert list(lost.channels) == list(whole.channels)
    for name, channel in whole.channels.items():
        np.testing.assert_array_equal(lost.channels[name].values, channel.values, err_msg=name)
    assert f"left out: {len(before) + 52} bytes" in told(lost, "corrupt_parts")


def test_a_log_without_descriptions_says_what_is_missing(read, sound):
    with pytest.raises(EmptyLogError, match="where messages are described"):
        read(sound[sound.index(b"\xa3\x95" + bytes([writer().numbers["XKF1"]])) :])


@pytest.mark.parametrize(
    ("name", "codes", "changed"),
    [
        ("PARM", "QNf", (1, "Zaf", 2, "an")),
        ("IMU", "QBfff", (1, "nZa", 4, "nZa")),
        ("XKF1", "QBfff", (0, "naZ", 1, "naZ", 3, "naZ")),
        ("ATT", "QccC", (0, "na", 1, "na", 3, "na")),
        ("MODE", "QMB", (0, "na", 2, "na")),
        ("RCOU", "QHHHH", (0, "na", 1, "na")),
        ("PSCD", "Qff", (0, "na", 1, "na")),
        ("FMTU", "QBNN", (1, "na", 2, "fa", 3, "fa")),
        ("MSG", "QZ", (0, "na", 1, "fa")),
    ],
)
def test_texts_and_lists_where_numbers_belong(read, name, codes, changed):
    for item, others in zip(changed[::2], changed[1::2], strict=True):
        for code in others:
            if code == codes[item]:
                continue
            entry = writer()
            columns = entry.columns[name]
            made = codes[:item] + code + codes[item + 1 :]
            length = 3 + sum(np.dtype(KINDS[each]).itemsize for each in made)
            number = entry.numbers[name]
            index = entry.head.index(name.encode().ljust(4, b"\0"), 89) - 5
            entry.head = (
                entry.head[:index]
                + fmt(number, length, name, made, ",".join(columns))
                + entry.head[index + 89 :]
            )
            entry.messages = [
                (time, row[:3] + (row[3:] + b"\x31" * length)[: length - 3] if row[2] == number else row)
                for time, row in entry.messages
            ]
            r = read(entry.bytes())
            if not (code == "Z" and name == "PARM"):
                assert f"{name}.{columns[item]}" in told(r, "message_formats"), (name, item, code)


def test_a_few_messages_of_a_lower_instance_are_damage(read):
    item = writer()
    for pair in [pair for pair in item.messages if pair[1][2] == item.numbers["IMU"]][3:]:
        item.messages[item.messages.index(pair)] = (pair[0], pair[1][:11] + b"\x01" + pair[1][12:])
    assert read(item.bytes()).channels["specific_force_body_z"].values.size == 57


def test_a_layout_is_said_again(read):
    item = writer()
    number = item.numbers["XKF1"]
    again = item.head[item.head.index(b"XKF1") - 5 :][:89]
    item.messages.append((100.5, again))
    r = read(item.bytes())
    assert r.channels["velocity_z"].values.size == 60
    assert not told(r, "message_formats")
    item.messages[-1] = (100.5, fmt(number, 20, "XKF1", "QBd", "TimeUS,C,VD"))
    r = read(item.bytes())
    assert r.channels["velocity_z"].values.size == 60
    assert "the first counts: XKF1" in told(r, "message_formats")


def test_many_breaks_end_the_search(read, sound, monkeypatch):
    monkeypatch.setattr(messages, "MAX_BREAKS", 20)
    r = read(sound + b"\xa3\x95\x80" * 2000)
    assert told(r, "corrupt_parts") or told(r, "truncated")


def mutated(content, seed):
    rng = np.random.default_rng(seed)
    data = bytearray(content)
    kind = seed % 4
    for integer in rng.integers(2, len(data), size=rng.integers(1, 30)).tolist():
        if kind == 0:
            data[integer] = int(rng.integers(256))
        elif kind == 1:
            del data[integer : integer + int(rng.integers(1, 200))]
        elif kind == 2:
            data[integer:integer] = rng.bytes(int(rng.integers(1, 100)))
        else:
            data[integer : integer + 89] = data[:89]
        if len(data) < 3:
            break
    return bytes(data)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_mutated_logs(read, sound):
    assert all(survives(read, mutated(sound, seed)) for seed in range(80))


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.filterwarnings("error")
@pytest.mark.thorough
def test_every_length_of_a_head(read, sound):
    assert all(survives(read, sound[:length]) for length in range(1, 2000))


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.long
def test_ten_thousand_mutated_logs(read, sound):
    assert all(survives(read, mutated(sound, seed)) for seed in range(80, 10_080))
