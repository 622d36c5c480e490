"""Every message of a DataFlash log, and every number in it, as pymavlink has it."""

import mmap

import numpy as np
import pytest
from dataflash_writer import KINDS, DataflashWriter, flight_log, simulated

from eivor.logs.dataflash.messages import Messages, find_offsets, read_layouts


def all_messages(path):
    """All messages of a log, by name."""
    with path.open("rb") as stream:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    layouts, _ = read_layouts(content)
    data = np.frombuffer(content, dtype=np.uint8)
    positions = find_offsets(data, layouts, layouts)
    return {layout.name: Messages(layout, data, positions.of(number)) for number, layout in layouts.items()}


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
        name: len(messages) for name, messages in theirs.items()
    }
    for name, messages in theirs.items():
        for column, field in ours[name].layout.fields.items():
            selected = [getattr(message, column) for message in messages]
            if field.kind.kind == "S":
                assert ours[name].texts(column) == selected, (name, column)
            else:
                values = ours[name].stored(column) if field.kind.subdtype else ours[name].values(column)
                np.testing.assert_allclose(values, selected, rtol=1e-15, err_msg=f"{name}.{column}")
    return sum(map(len, theirs.values()))


@pytest.mark.parametrize("dialect", ["3.3", "3.4", "4.1", "4.6"])
def test_the_messages_of_a_dialect(tmp_path, dialect):
    path = tmp_path / "flight.bin"
    path.write_bytes(flight_log(simulated(seed=3, duration=2.0), dialect).bytes())
    assert assert_alike(path) > 700


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


@pytest.mark.recordings
@pytest.mark.thorough
def test_a_real_log(recordings):
    assert assert_alike(recordings / "ardupilot" / "log_0036_mechanical_failure.bin") > 46_000
