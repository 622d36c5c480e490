"""Parts of readers: kept channels, delays, expressions of maps, messages beside a peer's, written files."""

from __future__ import annotations

import mmap
import tracemalloc
from dataclasses import replace
from datetime import UTC, datetime
from itertools import zip_longest

import numpy as np
import pytest
from bag_writer import mavros_messages, px4_messages, stores, write_ros1, write_ros2
from dataflash_writer import KINDS, DataflashWriter, flight_log, simulated
from hypothesis import given, settings
from hypothesis import strategies as st

import eivor as ev
from eivor.errors import EivorError, InputError
from eivor.flights.grid import upward
from eivor.logs import common, log_format
from eivor.logs.channel_map import parse_expression
from eivor.logs.common import KeptChannels
from eivor.logs.crazyflie import SOURCES, TO_LOG
from eivor.logs.dataflash import channels, messages, sources
from eivor.logs.dataflash.messages import Messages, find_offsets, read_layouts
from eivor.logs.rosbag.messages import decode, message_layout, parsed_types
from eivor.logs.table.columnar import write_recording
from eivor.logs.ulog.channels import ulog_origin
from eivor.motions.vertical.select import INPUTS
from eivor.signals.channels import CurveSide, canonical_channel, held_by_default, unit_of
from eivor.signals.recording import Channel, LogOrigin, utc_time
from logs.test_table import COLUMNS


def channel(name, count=100, clock=None):
    time = np.arange(float(count)) if clock is None else clock
    return Channel(name, time, np.ones(count), "")


def test_as_many_as_fit_are_kept():
    channels, made = KeptChannels(2500), []
    clock = np.arange(100.0)
    for name in ("velocity_z", "position_z", "input"):  # 1600 bytes, and 800 for each that shares the clock
        channels.put(channel(name, clock=clock), lambda name=name: made.append(name) or channel(name))
    assert list(channels) == ["velocity_z", "position_z", "input"]
    assert channels["velocity_z"] is channels["velocity_z"]
    assert made == []
    assert channels["input"] is not channels["input"]
    assert made == ["input", "input"]
    assert channels.finished() is channels
    channels.put(channel("input", count=1), lambda: channel("input"))
    assert isinstance(channels.finished(), dict)
    assert list(channels.finished()) == ["velocity_z", "position_z", "input"]
    with pytest.raises(KeyError):
        channels["landed"]


def test_what_is_not_kept_is_made_only_when_it_is_asked_for():
    channels, made = KeptChannels(0), []
    for name in ("position_z", "velocity_z"):
        channels.put(channel(name), lambda name=name: made.append(name) or channel(name))
    log = ev.Recording("long", "dataflash", channels.finished(), ev.Frame.NED)
    risen = upward(log)
    assert "velocity_z" in log.channels
    assert "velocity_z" in risen.channels
    assert "landed" not in risen.channels
    assert list(risen.channels) == list(log.channels)
    assert len(risen.channels) == 2
    assert "velocity_z" not in made  # the checks of annotations look at the first of a mapping
    np.testing.assert_array_equal(risen.channels["velocity_z"].values, -log.channels["velocity_z"].values)
    assert made.count("velocity_z") == 2


@pytest.mark.parametrize("dialect", ["3.4", "4.6"])
def test_a_log_that_does_not_fit_is_the_same(tmp_path, monkeypatch, dialect):
    path = tmp_path / "flight.bin"
    path.write_bytes(flight_log(simulated(seed=3, duration=2.0), dialect).bytes())
    whole = ev.read_log(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 2000))
    made = ev.read_log(path)
    assert isinstance(whole.channels, dict)
    assert isinstance(made.channels, KeptChannels)
    assert made.findings == whole.findings
    assert list(made.channels) == list(whole.channels)
    for name, item in whole.channels.items():
        np.testing.assert_array_equal(made.channels[name].time_s, item.time_s)
        np.testing.assert_array_equal(made.channels[name].values, item.values)
        assert made.channels[name].quality == item.quality


def long_log(tmp_path, monkeypatch, **spec):
    """A log of a flight of half a minute, read whole and as one that does not fit into memory."""
    path = tmp_path / "flight.bin"
    path.write_bytes(flight_log(simulated(seed=3, duration=30.0, **spec), "4.6").bytes())
    whole = ev.read_log(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 2000))
    return whole, ev.read_log(path)


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_part_of_a_long_log_is_its_samples_and_what_is_in_force(tmp_path, monkeypatch):
    whole, made = long_log(tmp_path, monkeypatch)
    part = made.part(10.0, 12.0)
    assert whole.part(10.0, 12.0) is whole
    assert part.span_s == made.span_s == whole.span_s
    assert list(part.channels) == list(whole.channels)
    for name, item in whole.channels.items():
        cut = part.channels[name]
        inside = (item.time_s >= 10.0) & (item.time_s <= 12.0)
        if name in ("landed", "pilot_in_control", "input_open_loop", "pilot_sets_attitude"):
            np.testing.assert_array_equal(cut.values, item.values)
            continue
        taken = (cut.time_s >= 10.0) & (cut.time_s <= 12.0)
        np.testing.assert_array_equal(cut.time_s[taken], item.time_s[inside])
        assert 9.8 < cut.time_s[0] < 10.0
        assert 12.0 < cut.time_s[-1] < 13.2
        if not name.startswith(("attitude", "feedback_reference_yaw")):  # turns are counted from the first
            np.testing.assert_array_equal(cut.values[taken], item.values[inside])
    thin = made.part(*made.span_s, 0.05)
    assert 20.0 <= thin.channels["input"].rate_hz < 30.0
    assert thin.channels["reference_position_z"].rate_hz == pytest.approx(10.0, rel=0.05)


def limited(begin, limit):
    """The beginning of channels of which less is kept."""
    return lambda self: begin(self, limit)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.thorough
def test_memory_of_a_long_log(tmp_path, monkeypatch):
    """What is kept, and some arrays of one channel: less than a third of a log that is all needed."""
    path, writer = tmp_path / "flight.bin", flight_log(simulated(seed=3, duration=60.0), "4.6")
    once = np.frombuffer(b"".join(message for _, message in writer.messages), dtype=np.uint8)
    positions = 3 + np.cumsum([0, *(len(message) for _, message in writer.messages)])[:-1]
    ticks = once[positions[:, None] + np.arange(8)].copy().view("<u8")[:, 0]
    with path.open("wb") as log:
        log.write(writer.head)
        for copy in range(5):
            again = once.copy()
            again[positions[:, None] + np.arange(8)] = (ticks + copy * 70_000_000)[:, None].view(np.uint8)
            log.write(again.tobytes())
    whole = peak_of(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 0))
    monkeypatch.setattr(messages, "LONG_FILE_BYTES", 0)
    monkeypatch.setattr(messages, "COPIED_ROWS", 1000)
    monkeypatch.setattr(channels, "PASSED_ROWS", 1000)
    monkeypatch.setattr(common, "ENOUGH", 1000)
    monkeypatch.setattr(sources, "LONG_BYTES", 0)
    monkeypatch.setattr(messages, "BLOCK_BYTES", 1 << 16)
    assert peak_of(path) < path.stat().st_size / 3 < whole


def peak_of(path):
    """Most memory that reading takes [bytes]."""
    tracemalloc.start()
    ev.read_log(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def test_every_source_and_every_advice_names_a_channel():
    names = {rule.name for source in SOURCES for rule in source.rules}
    assert all(canonical_channel(name) is not None for name in names | (set(TO_LOG)))
    assert set(TO_LOG) <= names
    assert log_format("crazyflie").takes_map
    assert log_format("crazyflie").advice("battery_voltage") == ("Add pm.vbat to config.txt on the card.",)
    assert "stateEstimate.z, .vz" in log_format("crazyflie").advice("")[0]


def all_messages(path):
    """All messages of a log, by name."""
    with path.open("rb") as stream:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    layouts, _ = read_layouts(content)
    data = np.frombuffer(content, dtype=np.uint8)
    offsets, _ = find_offsets(data, layouts, layouts)
    return {layout.name: Messages(layout, data, offsets[number]) for number, layout in layouts.items()}


def peers_messages(path):
    """All messages of a log as pymavlink reads them, by name."""
    from pymavlink.DFReader import DFReader_binary

    log = DFReader_binary(str(path))
    results = {}
    while (message := log.recv_msg()) is not None:
        results.setdefault(message.get_type(), []).append(message)
    log.filehandle.close()
    return results


def assert_alike(path):
    """Compare all messages; return how many there are."""
    ours, theirs = all_messages(path), peers_messages(path)
    assert {name: our.count for name, our in ours.items() if our.count} == {
        name: len(sent) for name, sent in theirs.items()
    }
    for name, sent in theirs.items():
        for column, field in ours[name].layout.fields.items():
            selected = [getattr(message, column) for message in sent]
            if field.kind.kind == "S":
                assert ours[name].texts(column) == selected, (name, column)
            else:
                values = ours[name].stored(column) if field.kind.subdtype else ours[name].values(column)
                np.testing.assert_allclose(values, selected, rtol=1e-15, err_msg=f"{name}.{column}")
    return sum(map(len, theirs.values()))


def test_every_code_of_a_field(tmp_path):
    rng = np.random.default_rng(0)
    writer = DataflashWriter()
    numbers = {code: rng.integers(-100, 100, size=20) for code in "bhiqcefdgL"}
    numbers |= {code: rng.integers(0, 100, size=20) for code in "BHIQCEM"}
    assert {*numbers, *"nNZa"} == {*KINDS}
    for n, (code, values) in enumerate(numbers.items()):
        writer.add(f"T{n}", np.arange(20.0), code, X=values)
    for code in "nNZ":
        writer.add(f"S{code}", np.arange(20.0), code, X=b"abc")
    writer.add("SA", np.arange(20.0), "a", X=rng.integers(-30000, 30000, size=(20, 32)))
    path = tmp_path / "flight.bin"
    path.write_bytes(writer.bytes())
    assert assert_alike(path) == 20 * 21 + 22


@pytest.mark.thorough
def test_a_real_log(recordings):
    assert assert_alike(recordings / "ardupilot" / "log_0036_mechanical_failure.bin") > 46_000


def test_shares_of_outputs_are_the_last_choice_of_an_input():
    assert (INPUTS[-1].name, INPUTS[-1].measured) == ("actuator_output", False)


def same(first, other):
    for name in ("frame", "input_map", "parameters"):
        assert getattr(first, name) == getattr(other, name)
    assert list(first.channels) == list(other.channels)
    for name, channel in first.channels.items():
        twin = other.channels[name]
        np.testing.assert_array_equal(channel.time_s, twin.time_s)
        np.testing.assert_array_equal(channel.values, twin.values)
        for part in ("unit", "held", "source", "quality", "estimated"):
            assert getattr(channel, part) == getattr(twin, part)


def test_parquet_reads_back_the_same(whole, tmp_path):
    r = ev.recording_from_columns(
        COLUMNS, frame=ev.Frame.NED, input_map="square", parameters={"a": 0.1}, estimated=("velocity_z",)
    )
    assert [name for name, channel in r.channels.items() if channel.estimated] == ["velocity_z"]
    write_recording(r, tmp_path / "r.parquet")
    back = ev.read_log(tmp_path / "r.parquet")
    assert back.name == "r.parquet"
    same(r, back)
    write_recording(back, tmp_path / "again.parquet")
    assert ev.read_log(tmp_path / "again.parquet").sha256 == back.sha256


def test_delays_and_sides_of_the_thrust_curve_are_kept(whole, tmp_path):
    r = ev.recording_from_columns(COLUMNS)
    late = {name: replace(channel, delay_s=0.004) for name, channel in r.channels.items()}
    behind = {"input": replace(r.channels["input"], curve_side=CurveSide.BEHIND)}
    for changed, field in ((late, "delay_s"), (behind, "curve_side")):
        log = replace(r, channels={**r.channels, **changed})
        write_recording(log, tmp_path / "r.parquet")
        same(log, ev.read_log(tmp_path / "r.parquet"))
        back = ev.read_log(tmp_path / "r.parquet").channels
        assert all(getattr(back[name], field) == getattr(item, field) for name, item in changed.items())


def test_channels_of_several_clocks_read_back_the_same(whole, tmp_path):
    quick, slow = np.arange(0.0, 2.0, 0.01), np.arange(0.003, 2.0, 0.02)
    channels = {
        name: Channel(name, time, np.sin(time), unit_of(name), source="x", held=held_by_default(name))
        for name, time in (("velocity_z", quick), ("input", slow), ("position_z", quick))
    }
    r = ev.Recording(name="r", format="simulation", channels=channels)
    write_recording(r, tmp_path / "r.parquet")
    same(r, ev.read_log(tmp_path / "r.parquet"))


START = datetime(2026, 5, 1, 12, tzinfo=UTC)


def test_versions_of_px4():
    versions = {0x010F01FF: "1.15.1", 0x010F0080: "1.15.0 beta", 0x01100000: "1.16.0 development"}
    for number, text in versions.items():
        about = {"sys_name": b"PX4", "ver_sw_release": number.to_bytes(4, "little")}
        assert ulog_origin(about, {}, np.uint64(0), {}).firmware == f"PX4 {text}"


def test_clocks_that_were_never_set_tell_no_time():
    assert utc_time(START.timestamp()) == START
    assert [utc_time(seconds) for seconds in (0.0, 12.5, 1e12, 1e30, float("nan"))] == [None] * 5


@pytest.mark.thorough
def test_a_written_recording_keeps_its_origin(tmp_path):
    log = ev.recording_from_columns({"time": np.arange(5.0), "velocity_z": np.ones(5)})
    for origin in (LogOrigin("N1", "quad", "PX4 1.15.0", START), LogOrigin()):
        write_recording(replace(log, origin=origin), tmp_path / "log.parquet")
        assert ev.read_log(tmp_path / "log.parquet").origin == origin


def test_advice():
    assert "LOG_BITMASK" in log_format("dataflash").advice("")[0]
    assert "IMU_FAST" in log_format("dataflash").advice("specific_force_body_z")[0]
    assert any("SDLOG_PROFILE" in sentence for sentence in log_format("ulog").advice(""))
    assert "bit 4 (high rate)" in log_format("ulog").advice("input")[0]
    assert "10 Hz." in log_format("ulog").advice("velocity_z")[0]
    assert log_format("ulog").advice("nonsense") == ()
    assert "'input'" in log_format("parquet").advice("input")[0]
    assert "vehicle_thrust_setpoint" in log_format("mcap").advice("input")[0]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.text(alphabet="ab12.+-*/(), \"'eE_;\n", max_size=60))
def test_any_text_as_an_expression(text):
    try:
        expression = parse_expression(text, "here")
    except InputError:
        return
    values = {column: np.array([1.0, np.nan, -2.0]) for column in expression.columns}
    assert expression.evaluate(values).shape == (3,)


def layout(message, text):
    return message_layout(message, "a/B", parsed_types(text, "a/B"), ros1=False)


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


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.filterwarnings("error")
@pytest.mark.thorough
@pytest.mark.parametrize("how", ["text", "nan", "inf", "least", "most", "nothing"])
@pytest.mark.parametrize("kind", ["mavros", "px4"])
def test_definitions_with_fields_of_another_kind(tmp_path, monkeypatch, kind, how):
    (ros1, ros2), flight, known = stores(), simulated(seed=3, duration=2.0), []
    if kind == "mavros":
        bag = write_ros1(tmp_path / "m.bag", mavros_messages(ros1, flight), ros1)
    else:
        bag = write_ros2(tmp_path / "p", px4_messages(ros2, flight), ros2)
        (bag / "metadata.yaml").unlink()  # takes half of the time, and is not what changes

    def changed(payloads, layout_of):
        """As decoded, but one field of one topic is of another kind."""
        key = (payloads[0], len(payloads))
        if key not in cache:
            cache[key] = decode(payloads, layout_of)
            known.extend((key, name) for name in cache[key][0])
        fields = dict(cache[key][0])
        for name in [name for item, name in wanted if item == key]:
            other = of_another_kind(how, fields.pop(name))
            fields |= {} if other is None else {name: other}
        return fields, *cache[key][1:]

    cache, wanted = {}, []
    monkeypatch.setattr("eivor.logs.rosbag.messages.decode", changed)
    whole = ev.read_log(bag)
    assert len(known) > 50
    of_topics = [
        [entry for entry in known if entry[0] == key] for key in dict.fromkeys(key for key, _ in known)
    ]
    together = [[entry for entry in row if entry] for row in zip_longest(*of_topics)]  # one of each topic
    for wanted[:] in together:
        try:
            result = ev.read_log(bag)
        except EivorError:
            together.extend([entry] for entry in wanted if len(wanted) > 1)
            continue
        assert set(result.channels) <= {*whole.channels, *whole.looked_for}
