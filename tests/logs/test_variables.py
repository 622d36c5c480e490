"""MATLAB and HDF5 files: vectors, matrices, structures; damaged ones are refused with a sentence."""

import sys

import h5py
import numpy as np
import pytest
from dataflash_writer import simulated
from scipy.io import savemat

from eivor.errors import ChannelMapError, EivorError, EmptyLogError, LogTooLargeError, MissingReaderError
from eivor.inference.verdict import Status
from eivor.logs import read_log
from eivor.logs.table import columnar
from eivor.motions.identify import identify_flight

MAP = """
name = "rig"
frame = "ned"
input_map = "square"
[time]
column = "log.t"
[channels.velocity_z]
column = "log.v"
index = 2
[channels.rotor_command_1]
column = "log.u"
[channels.specific_force_z]
column = "log.f"
[channels.cos_tilt]
column = "log.tilt"
[channels.reference_position_z]
column = "log.r"
"""


@pytest.fixture
def whole(monkeypatch):
    """The files are whole: no child need decode them first."""
    for module in (columnar, columnar):
        monkeypatch.setattr(module, "decode_in_child", lambda *_, **__: None)


def columns(flight):
    values = {name: channel.values for name, channel in flight.channels.items()}
    return {"time": flight.channels["position_z"].time_s, **values}


def nested(flight):
    """The same, z down, in a structure with a matrix."""
    table = columns(flight)
    down = np.stack([0.0 * table["time"], 0.0 * table["time"], -table["velocity_z"]], 1)
    return {
        "t": table["time"][:, None],
        "v": down,
        "u": table["rotor_command_1"],
        "f": -table["specific_force_z"],
        "tilt": table["cos_tilt"],
        "r": -table["reference_position_z"],
        "note": "a flight",
    }


def matlab_73(path, tree):
    """Write as MATLAB 7.3 does: HDF5 after 512 bytes of text, vectors as rows, letters as numbers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, value in tree.items():
            if isinstance(value, str):
                create_dataset = group.create_dataset(
                    name, data=np.frombuffer(value.encode("utf-16-le"), "<u2")[:, None]
                )
                create_dataset.attrs["MATLAB_class"] = np.bytes_("char")
            else:
                create_dataset = group.create_dataset(
                    name, data=np.atleast_2d(value).T if value.ndim == 1 else value.T
                )
                create_dataset.attrs["MATLAB_class"] = np.bytes_("double")
        file["#refs#/a"] = np.zeros(3)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(508) + b"\0\0\x02IM"[:4])
    return path


def write(path, kind, flight, *, tree):
    content = nested(flight) if tree else columns(flight)
    if kind == "matlab":
        savemat(path, {"log": content} if tree else content, do_compression=tree)
    elif tree:
        matlab_73(path, content)
    else:
        with h5py.File(path, "w") as file:
            for name, value in content.items():
                file.create_dataset(name, data=value, compression="gzip")
    return path


@pytest.mark.parametrize("kind", ["matlab", "hdf5"])
def test_channels_by_their_names_and_by_a_map(whole, tmp_path, kind):
    flight = simulated(seed=3, duration=2.0)
    plain = read_log(write(tmp_path / "a.dat", kind, flight, tree=False))
    assert plain.format == kind
    for name, channel in flight.channels.items():
        np.testing.assert_array_equal(plain.channels[name].values, channel.values, err_msg=name)
    (tmp_path / "rig.toml").write_text(MAP)
    mapped = read_log(write(tmp_path / "b.dat", kind, flight, tree=True), channel_map=tmp_path / "rig.toml")
    assert len(mapped.channels) == 5
    for name, channel in mapped.channels.items():
        sign = -1.0 if name.endswith("_z") else 1.0
        np.testing.assert_array_equal(sign * channel.values, flight.channels[name].values, err_msg=name)


@pytest.mark.thorough
def test_the_truth_is_in_the_intervals(whole, tmp_path):
    flight = simulated(seed=3, duration=40.0)
    (tmp_path / "rig.toml").write_text(MAP)
    path = write(tmp_path / "b.mat", "hdf5", flight, tree=True)
    fit = identify_flight(read_log(path, channel_map=tmp_path / "rig.toml"))
    assert fit.verdict.status is Status.IDENTIFIED
    for name, value in {"viscous_friction": 0.4, "effective_lag": 0.04, "hover_input": 0.5}.items():
        low, high = fit.quantities[name].interval
        assert low <= value <= high, name


def test_variables_of_several_lengths_are_told(whole, tmp_path):
    savemat(tmp_path / "a.mat", {"time": np.arange(50.0), "velocity_z": np.arange(60.0)})
    with pytest.raises(ChannelMapError, match=r"'velocity_z' 60|'time' 50.*'velocity_z' 60"):
        read_log(tmp_path / "a.mat")


def test_files_of_nothing_that_is_read(whole, tmp_path):
    savemat(tmp_path / "a.mat", {"name": "flight", "cells": np.array([[1], "a"], dtype=object)})
    with pytest.raises(EmptyLogError, match=r"objects \(timeseries, tables\) are not read"):
        read_log(tmp_path / "a.mat")


def test_what_lies_elsewhere_is_left_alone(whole, tmp_path):
    """Links, views and storage outside the file: another file's content is never read."""
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.arange(50.0)
    layout = h5py.VirtualLayout(shape=(50,), dtype="f8")
    layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "secret", shape=(50,))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = file["velocity_z"] = np.arange(50.0)
        file.create_virtual_dataset("position_z", layout)
        file["input"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "secret")
        file.create_dataset("cos_tilt", (50,), "f8", external=[(str(tmp_path / "raw"), 0, 400)])
    assert set(read_log(tmp_path / "a.h5").channels) == {"velocity_z"}


def test_variables_without_a_space_are_left_out(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = file["velocity_z"] = np.arange(50.0)
        file["input"] = h5py.Empty("f8")
        file.create_dataset("rows", (50,), dtype=h5py.vlen_dtype("f8"))
    assert set(read_log(tmp_path / "a.h5").channels) == {"velocity_z"}


def test_a_variable_that_says_far_more_than_the_file_holds(whole, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("time", (1 << 36,), "f8", chunks=(1 << 20,))
        file["velocity_z"] = np.arange(50.0)
    with pytest.raises(LogTooLargeError, match="repeats itself"):
        read_log(tmp_path / "a.h5")


def test_without_h5py_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingReaderError, match=r"pip install 'eivor\[hdf5\]'"):
        read_log(tmp_path / "a.h5")


@pytest.mark.parametrize("kind", ["hdf5", pytest.param("matlab", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("count", [1, pytest.param(100, marks=pytest.mark.long)])
def test_damaged_files(tmp_path, kind, count):
    content = write(tmp_path / "a.dat", kind, simulated(seed=3, duration=2.0), tree=True).read_bytes()
    refused = 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        data = bytearray(content)
        for integer in rng.integers(128, len(data), size=40).tolist():
            data[integer] = int(rng.integers(256))
        (tmp_path / "b.dat").write_bytes(data[: len(data) // 2] if seed % 2 == 0 else data)
        try:
            read_log(tmp_path / "b.dat")
        except EivorError:
            refused += 1
    assert refused >= count // 2
