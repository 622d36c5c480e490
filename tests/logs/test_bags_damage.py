"""Damaged and hostile bags: what is sound is read, or one sentence says what is wrong, and nothing else
happens."""

import sqlite3
import struct
import tracemalloc
from io import BytesIO

import numpy as np
import pytest
from backports import zstd
from bag_writer import (
    EPOCH_S,
    blank,
    header,
    mavros_messages,
    px4_messages,
    stores,
    vector,
    write_ros1,
    write_ros2,
)
from dataflash_writer import simulated
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from eivor.errors import CorruptLogError, EivorError, InputError, MissingReaderError
from eivor.logs.read import read_log
from eivor.logs.rosbag import topics
from eivor.logs.rosbag.messages import (
    Decoded,
    UnsoundMessageError,
    decoded,
    message_layout,
    parsed_definition,
)

pytestmark = pytest.mark.usefixtures("unchecked_shapes")


@pytest.fixture(scope="module")
def store():
    return dict(zip(("ros1", "ros2"), stores(), strict=True))


def inertial(store, n=60):
    kind = "sensor_msgs/msg/Imu"
    for row in range(n):
        selected = {"header": header(store, 0.01 * row)}
        selected["linear_acceleration"] = vector(store, 0.0, 0.1 * row, 9.8)
        yield "/imu", kind, 0.01 * row, store.types[kind](**(blank(store, kind) | selected))


@pytest.fixture(scope="module")
def sound(store, tmp_path_factory):
    """The bytes of a small bag of each kind."""
    folder = tmp_path_factory.mktemp("bags")
    lz4 = Writer1.CompressionFormat.LZ4
    ros1 = write_ros1(folder / "one.bag", inertial(store["ros1"]), store["ros1"], lz4)
    plain = write_ros2(folder / "two", inertial(store["ros2"]), store["ros2"])
    mcap = write_ros2(
        folder / "three", inertial(store["ros2"]), store["ros2"], StoragePlugin.MCAP, CompressionMode.STORAGE
    )
    return {
        "bag": ros1.read_bytes(),
        "db3": (plain / "two.db3").read_bytes(),
        "mcap": (mcap / "three.mcap").read_bytes(),
    }


@pytest.fixture
def read(tmp_path):
    def read(content, ending="bag"):
        path = tmp_path / f"flight.{ending}"
        path.write_bytes(content)
        return read_log(path)

    return read


def told(recording, name):
    return " ".join(finding.message for finding in recording.findings if finding.name == name)


def survives(read, content, ending):
    """Whether a bag is read, or refused with a sentence."""
    try:
        read(content, ending)
    except EivorError:
        return True
    return True


def mutated(content, seed):
    rng = np.random.default_rng(seed)
    data = bytearray(content)
    for integer in rng.integers(16, len(data), size=rng.integers(1, 30)).tolist():
        if seed % 3 == 0:
            data[integer] = int(rng.integers(256))
        elif seed % 3 == 1:
            del data[integer : integer + int(rng.integers(1, 200))]
        else:
            data[integer:integer] = rng.bytes(int(rng.integers(1, 100)))
    return bytes(data)


@pytest.mark.parametrize(
    ("ending", "remedy"), [("bag", "rosbag reindex"), ("mcap", "mcap recover"), ("db3", "-wal")]
)
def test_a_bag_that_is_cut_says_how_it_is_mended(read, sound, ending, remedy):
    assert read(sound[ending], ending).channels["specific_force_body_y"].values.size == 60
    with pytest.raises(CorruptLogError, match=remedy):
        read(sound[ending][: len(sound[ending]) // 2], ending)


@pytest.mark.parametrize("ending", ["bag", "mcap", "db3"])
@pytest.mark.parametrize("seeds", [range(15), pytest.param(range(15, 1000), marks=pytest.mark.long)])
def test_mutated_bags(read, sound, ending, seeds):
    assert all(survives(read, mutated(sound[ending], seed), ending) for seed in seeds)


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ["bag", "mcap", "db3"])
def test_bags_cut_anywhere(read, sound, ending):
    step = len(sound[ending]) // 80
    assert all(survives(read, sound[ending][:size], ending) for size in range(1, len(sound[ending]), step))


def test_a_part_that_is_damaged_is_left_out(tmp_path, store, sound):
    folder = write_ros2(tmp_path / "flight", inertial(store["ros2"]), store["ros2"])
    (folder / "flight.db3").rename(folder / "flight_0.db3")
    (folder / "flight_1.db3").write_bytes(b"SQLite format 3\0 and nothing")
    r = read_log(folder)
    assert r.channels["specific_force_body_y"].values.size == 60
    assert "'flight_1.db3'" in told(r, "corrupt_parts")
    (folder / "other.mcap").write_bytes(sound["mcap"])
    with pytest.raises(InputError, match="the files of one bag"):
        read_log(folder)


def test_one_large_chunk_that_says_nothing_is_refused(read, sound):
    """A chunk of zeros in a thousandth of its size: neither read nor kept in memory."""
    index = sound["mcap"].index(b"\x04\0\0\0zstd") + 8
    bomb = zstd.compress(bytes(1 << 27))
    start = index - 8 - 28 - 9
    record = (
        struct.pack("<QQQI", 0, 1 << 62, 1 << 27, 0) + b"\x04\0\0\0zstd" + struct.pack("<Q", len(bomb)) + bomb
    )
    content = BytesIO()
    content.write(sound["mcap"][:start] + b"\x06" + struct.pack("<Q", len(record)) + record)
    content.write(b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + b"\x89MCAP0\r\n")
    tracemalloc.start()
    with pytest.raises(CorruptLogError, match="repeats itself"):
        read(content.getvalue(), "mcap")
    assert tracemalloc.get_traced_memory()[1] < 200 << 20
    tracemalloc.stop()


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW schema AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x FROM c) SELECT x FROM c",
        "CREATE TRIGGER t AFTER INSERT ON messages BEGIN SELECT 1; END",
        "CREATE TABLE more(a INTEGER, b BLOB GENERATED ALWAYS AS (zeroblob(1000000000)))",
    ],
)
def test_a_database_that_computes_is_refused(tmp_path, sound, statement):
    path = tmp_path / "flight.db3"
    path.write_bytes(sound["db3"])
    database = sqlite3.connect(path)
    database.execute("DROP TABLE schema")
    database.execute(statement)
    database.commit()
    database.close()
    with pytest.raises(CorruptLogError, match="more than plain tables"):
        read_log(path)


def test_names_of_files_that_mean_something_in_addresses(tmp_path, sound):
    path = tmp_path / "flight #1?mode=rwc%20.db3"
    path.write_bytes(sound["db3"])
    assert read_log(path).channels["specific_force_body_z"].values.size == 60


def layout(message, text):
    return message_layout(message, "a/B", parsed_definition(text, "a/B"), ros1=False)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("uint8[1000000000] many", "goes on after them"),
        ("string words", "goes on after them"),
        ("B again", "nested too deep"),
        ("C other", "type a/C is not known"),
        ("C[] other\n" + "=" * 80 + "\nMSG: a/C\nuint8[0] nothing\n", "more than 4096 fields"),
        ("uint8 one", "where its type takes 5"),
    ],
)
def test_definitions_that_do_not_fit(text, words):
    with pytest.raises(UnsoundMessageError, match=words):
        layout(b"\0\1\0\0" + struct.pack("<IIII", 1 << 31, 0, 0, 0), text)


def test_code_in_a_definition_is_never_run(tmp_path, store):
    folder = write_ros2(tmp_path / "flight", inertial(store["ros2"]), store["ros2"])
    database = sqlite3.connect(folder / "flight.db3")
    evil = "float64 x\n__import__('os').abort() y\n"
    database.execute("UPDATE message_definitions SET encoded_message_definition = ?", (evil,))
    database.commit()
    database.close()
    with pytest.raises(EivorError, match="where its type takes 12"):
        read_log(folder)


def of_another_kind(how, values):
    """What another definition could have in the place of a column; None without one."""
    kinds = {
        "text": np.full(len(values), b"ab"),
        "nan": np.full(len(values), np.nan),
        "inf": np.full(len(values), np.inf, dtype=np.float32),
        "least": np.full(len(values), -(2**63)),
        "most": np.full(len(values), 2**64 - 1, dtype=np.uint64),
    }
    return kinds.get(how)


@pytest.mark.filterwarnings("error")
@pytest.mark.thorough
@pytest.mark.parametrize("how", ["text", "nan", "inf", "least", "most", "nothing"])
@pytest.mark.parametrize("kind", ["mavros", "px4"])
def test_definitions_with_fields_of_another_kind(tmp_path, store, monkeypatch, kind, how):
    flight = simulated(seed=3, duration=2.0)
    if kind == "mavros":
        bag = write_ros1(tmp_path / "m.bag", mavros_messages(store["ros1"], flight), store["ros1"])
    else:
        bag = write_ros2(tmp_path / "p", px4_messages(store["ros2"], flight), store["ros2"])
    known = []

    def changed(payloads, layout_of):
        """As decoded, but one field of one topic is of another kind."""
        key = (payloads[0], len(payloads))
        if key not in cache:
            cache[key] = decoded(payloads, layout_of)
            known.extend((key, name) for name in cache[key].fields)
        fields = dict(cache[key].fields)
        for name in [name for item, name in wanted if item == key]:
            other = of_another_kind(how, fields.pop(name))
            fields |= {} if other is None else {name: other}
        return Decoded(fields, cache[key].indices, cache[key].reason)

    cache, wanted = {}, []
    monkeypatch.setattr(topics, "decoded", changed)
    whole = read_log(bag)
    assert len(known) > 50
    for entry in known:
        wanted[:] = [entry]
        try:
            result = read_log(bag)
        except EivorError:
            continue
        assert set(result.channels) <= {*whole.channels, *whole.looked_for}


def test_messages_of_other_lengths_stand_beside_each_other():
    """Texts of several lengths, one message that is none: the others keep their order."""
    types = parsed_definition("string words\nfloat64 x", "a/B")

    def message(words, value):
        head = b"\0\1\0\0" + struct.pack("<I", len(words) + 1) + words + b"\0"
        return head + bytes(-(len(head) - 4) % 8) + struct.pack("<d", value)

    made = [message(b"abc" * (row % 3), float(row)) for row in range(20)]
    made.insert(7, b"\0\1\0\0junk")
    result = decoded(made, lambda item: message_layout(item, "a/B", types, ros1=False))
    assert result.fields["x"].tolist() == [float(row) for row in range(20)]
    assert result.indices.tolist() == [*range(7), *range(8, 21)]
    assert "goes on after" in result.reason


def test_stamps_that_cannot_be(tmp_path, store):
    messages = list(inertial(store["ros2"]))
    messages[10][3].header.stamp.sec = 0
    messages[10][3].header.stamp.nanosec = 0
    messages[20][3].header.stamp.sec = EPOCH_S + 10_000_000
    r = read_log(write_ros2(tmp_path / "flight", messages, store["ros2"], StoragePlugin.MCAP))
    channel = r.channels["specific_force_body_y"]
    assert channel.values.size == 58
    assert channel.time_s[-1] == pytest.approx(0.59)
    assert "left out: 2" in told(r, "time_stamps")


def test_an_mcap_of_others_is_refused_with_its_schemas(read, sound):
    other = sound["mcap"].replace(b"ros2msg", b"jsonsch")
    with pytest.raises(MissingReaderError, match=r"sensor_msgs/msg/Imu \(jsonsch\).*mcap cat"):
        read(other, "mcap")
