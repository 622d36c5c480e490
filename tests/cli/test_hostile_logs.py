"""Logs that tell nothing: short, gappy, constant, without channels. There is a sentence, never a crash."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import polars
import pytest

from logs.damage import damaged

pytestmark = pytest.mark.usefixtures("coarse_search")

#: What is said of matrices and of Python to those who wrote them.
INTERNAL = re.compile(
    r"reshape|unexpected \w+Error|column \d|rows for \d+ unknowns|unknowns; received"
    r"|equations for \d+ unknowns|zero-size|broadcast|out of bounds|singular value|Traceback|mistake in Eivor"
    r"|Not enough memory"
)
RATES_HZ = (0.3, 1.0, 2.0, 5.0, 10.0, 10.0, 25.0, 50.0, 100.0, 250.0)
GRAVITY = 9.80665


def flown(rng):
    """Channels of a flight by name: stamps, as a logger may write them, and values."""
    seconds = float(rng.choice([0.02, 0.5, 1.2, 3.2, 5.0, 9.0, 20.0, 45.0]))
    time = np.arange(0.0, seconds + 0.004, 0.004)
    speed = sum(
        rng.uniform(0.0, 0.6) * np.sin(2.0 * np.pi * rng.choice([0.05, 0.2, 0.7, 2.0]) * time + phase)
        for phase in rng.uniform(0.0, 6.0, int(rng.integers(0, 4)))
    ) + np.zeros(time.size)
    force = GRAVITY + np.gradient(speed, time) + 0.4 * speed
    throttle = force / 40.0
    noise = rng.choice([0.0, 1e-9, 1.0])
    motion = {"velocity_z": speed + 0.02 * noise * rng.standard_normal(time.size)}
    motion["position_z"] = 5.0 + np.cumsum(speed) * 0.004
    force = force + 0.2 * noise * rng.standard_normal(time.size)
    reference = {"reference_position_z": np.round(motion["position_z"]), "reference_velocity_z": speed}
    if rng.random() < 0.5:  # as ArduPilot logs: climb rate and throttle at 10 Hz, the stick, modes
        body = {"specific_force_body_x": 0.0 * time, "specific_force_body_y": 0.0 * time}
        body["specific_force_body_z"] = force
        attitude = {f"attitude_{part}": np.full(time.size, float(part == "w")) for part in "wxyz"}
        modes = dict.fromkeys(("pilot_in_control", "input_open_loop"), np.full(time.size, rng.integers(0, 2)))
        scale = rng.choice([1.0, 1000.0])
        control = {"input": scale * throttle, "pilot_throttle": np.round(20.0 * throttle) / 20.0}
        values = motion | body | attitude | control | modes | reference
        usual = dict.fromkeys(values, 10.0) | dict.fromkeys(body, float(rng.choice([10.0, 25.0, 50.0])))
    else:
        command = {f"rotor_command_{n}": 2500.0 * np.sqrt(np.abs(throttle)) for n in range(1, 5)}
        command = {"input": throttle} if rng.random() < 0.5 else command
        values = motion | {"specific_force_z": force, "cos_tilt": np.ones(time.size)} | command | reference
        usual = dict.fromkeys(values, float(rng.choice([50.0, 100.0, 250.0])))
    if rng.random() < 0.5:
        values["landed"] = (time < 0.1 * seconds).astype(float)
    if rng.random() < 0.4:  # in two parts: what moves in one is still in the other, and silence between them
        parts = time < rng.uniform(0.2, 0.8) * seconds
        for name in rng.choice(list(values), int(rng.integers(1, 6))):
            still = parts if rng.random() < 0.5 else ~parts
            values[name] = np.where(still, rng.choice([0.0, values[name][0]]), values[name])
        silence = rng.choice([0.0, 0.3, 1.5, 12.0]) * ~parts
    else:
        silence = np.zeros(time.size)
    dropped = rng.choice(list(values), int(rng.choice([0, 0, 1, 3])))
    return {
        name: _logged(rng, time + silence, np.asarray(value, dtype=np.float64), usual.get(name, 2.0))
        for name, value in values.items()
        if name not in dropped
    }


def _logged(rng, time, values, rate_hz):
    """One channel, with a clock and values that are spoilt now and then."""
    if rng.random() < 0.15:
        rate_hz = float(rng.choice(RATES_HZ))
    positions = np.unique(np.arange(0, time.size, max(250.0 / rate_hz, 1.0)).astype(np.int64))
    stamps, values = time[positions], values[positions].copy()
    jitter = rng.choice([0.0, 0.0, 1e-4, 0.4 / rate_hz])
    stamps = stamps + jitter * rng.standard_normal(stamps.size)
    kind = int(rng.integers(0, 16))
    if kind < 4:
        stamps = _spoilt_clock(rng, stamps, kind)
    elif kind < 5:
        first, last = np.sort(rng.integers(0, stamps.size, 2))
        stamps, values = np.delete(stamps, slice(first, last)), np.delete(values, slice(first, last))
    elif kind < 11:
        values = _spoilt_values(rng, values, kind)
    return stamps, values


def _spoilt_clock(rng, stamps, kind):
    """Stamps that stand there twice, or jump."""
    if kind < 2:
        return np.repeat(stamps[::2], 2)[: stamps.size]
    return stamps + rng.choice([0.5, 20.0, 1e6]) * (np.arange(stamps.size) > 0.5 * stamps.size)


def _spoilt_values(rng, values, kind):
    """Values that rest, are missing, have another unit, or none of this world."""
    wrong = {
        5: np.full(values.size, values[0]),
        6: np.zeros(values.size),
        7: np.where(rng.random(values.size) < rng.choice([0.05, 0.5, 1.0]), np.nan, values),
        8: values * rng.choice([-1.0, 1e-9, 1e6, 1e30]),
        9: np.where(np.arange(values.size) == values.size // 2, rng.choice([np.inf, 1e200]), values),
        10: np.round(values, 1),
    }
    return wrong[kind]


def recording_of(columns, name="hostile"):
    """The channels as a log that was read."""
    from eivor.signals.channels import canonical_channel
    from eivor.signals.recording import Recording, clean_channel

    channels = {}
    for item, (stamps, values) in columns.items():
        known = canonical_channel(item)
        channels[item] = clean_channel(item, stamps, values, known.unit, held=known.held)
    return Recording(name, "csv", channels)


def write_csv(columns, path):
    """The channels in one table, in the order of their stamps, with empty cells between them."""
    tables = [
        polars.DataFrame({"time": stamps, name: values}).unique("time", keep="first", maintain_order=True)
        for name, (stamps, values) in columns.items()
    ]
    whole = tables[0]
    for table in tables[1:]:
        whole = whole.join(table, on="time", how="full", coalesce=True)
    whole.sort("time").fill_nan(None).write_csv(path)


def use_library(log, fit, choices):
    """What each function says of a log: a result, or one of Eivor's own errors."""
    import eivor as ev
    from eivor.errors import EivorError
    from eivor.flights.options import FlightOptions
    from eivor.flights.track import track
    from eivor.motions.table import motion_by_name
    from eivor.report.flight_page import flight_page
    from eivor.report.inspection import inspection

    sentence = []

    def called(action):
        try:
            sentence.append(str(action()))
        except EivorError as error:
            sentence.append(str(error))

    def identified():
        result = ev.identify_flight(log, **choices)
        called(lambda: track(result))
        called(lambda: ev.validate(result, log).to_json())
        return result.summary() + result.to_json() + flight_page(result)[:0]

    vertical = motion_by_name("vertical")
    called(identified)
    called(lambda: inspection(log, FlightOptions(), vertical).reasons)
    called(lambda: ev.validate(fit, log).to_json())
    return "\n".join(sentence)


CHOICES: tuple[dict[str, Any], ...] = (
    {},
    {"method": "least_squares"},
    {"method": "total_least_squares"},
    {"method": "extended_iv"},
    {"method": "generalized_iv"},
    {"method": "spectral_giv", "noise": "estimate"},
    {"method": "whittle_ml", "noise": "estimate"},
    {"align": True},
    {"terms": ("quadratic-drag",)},
    {"model": "rates"},
)

#: Larger recordings take too long to read fifty times [bytes].
LARGEST_DAMAGED = 700_000
COMMANDS = {
    "identify": {0, 1, 3},
    "inspect": {0, 1},
    "track": {0, 1, 3},
    "report": {0, 1, 3},
    "validate": {0, 1, 2, 3},
}


def still_in_turns():
    """Climb rate that is zero while the reference moves, silence, and a reference that rests afterwards."""
    time = np.arange(0.0, 40.0, 0.01)
    time = time[(time < 20.0) | (time > 23.0)]
    late = time > 21.0
    speed = np.where(late, 0.5 * np.sin(4.0 * time) + 0.3 * np.sin(1.1 * time), 0.0)
    pushed = 2.0 * np.cos(4.0 * time) + 0.33 * np.cos(1.1 * time) + 0.2 * speed
    force = GRAVITY + np.where(late, pushed, 0.0)
    reference = np.where(late, 0.0, np.round(2.0 * np.sin(0.7 * time) + np.sin(2.0 * time)))
    noise = 0.2 * np.random.default_rng(0).standard_normal(time.size)
    values = {"velocity_z": speed, "specific_force_z": force + noise, "reference_position_z": reference}
    values["input"] = force / 40.0 + 0.02 * reference
    return {name: (time, value) for name, value in values.items()}


@pytest.fixture(scope="module")
def good_fit(tmp_path_factory):
    """A result that `validate` takes."""
    import eivor as ev
    from coarse_search import coarse
    from flights.flight_logs import flown as good_flights

    path = tmp_path_factory.mktemp("fit") / "fit.json"
    with coarse():
        path.write_text(ev.identify_flight(good_flights(1, seconds=30.0)[0]).to_json(), encoding="utf-8")
    return path


def use_commands(eivor, columns, fit, folder, commands=tuple(COMMANDS)):
    """What each command prints of a log, with a documented exit code."""
    log, sentence = folder / "log.csv", {}
    write_csv(columns, log)
    given = {"report": ["-o", folder / "page.html"]}
    for command in commands:
        run = eivor(command, *([fit] if command == "validate" else []), log, *given.get(command, []))
        sentence[command] = f"{run.out}\n{run.err}"
        assert run.code in COMMANDS[command], sentence[command]
        assert not INTERNAL.search(" ".join(sentence[command].split())), sentence[command]
    return sentence


def test_what_tells_nothing_is_refused_in_a_sentence(eivor, good_fit, tmp_path):
    sentence = "The instruments carry too little information about the viscous friction"
    commands = use_commands(eivor, still_in_turns(), good_fit, tmp_path, ("identify", "inspect"))
    assert re.search(r"viscous friction +K .* not identified", commands["identify"])
    assert sentence in " ".join(commands["identify"].split())
    assert sentence in " ".join(commands["inspect"].split())


@pytest.mark.parametrize(
    "seed", [*range(6), *(pytest.param(n, marks=pytest.mark.thorough) for n in range(6, 20))]
)
def test_calls_end_in_a_result_or_a_sentence(good_fit, seed):
    rng = np.random.default_rng(seed)
    columns = flown(rng)
    library = use_library(recording_of(columns), good_fit, CHOICES[int(rng.integers(0, len(CHOICES)))])
    assert not INTERNAL.search(library), library


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_commands_end_in_a_documented_code(eivor, good_fit, tmp_path, seed):
    use_commands(eivor, flown(np.random.default_rng(seed)), good_fit, tmp_path)


def cut_short(log, rng):
    """A random part of a recording, without some of its channels."""
    from dataclasses import replace

    start, end = log.span_s
    first = rng.uniform(start, end)
    last = first + float(rng.choice([0.5, 2.0, 4.0, 8.0, 20.0, 60.0]))
    channels = {}
    for name, channel in log.channels.items():
        inside = (channel.time_s >= first) & (channel.time_s < last)
        if rng.random() > 0.05:
            channels[name] = replace(channel, time_s=channel.time_s[inside], values=channel.values[inside])
    return replace(log, channels=channels)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "seed", [*range(8), *(pytest.param(n, marks=pytest.mark.long) for n in range(8, 200))]
)
def test_parts_of_real_flights_end_so(recordings, good_fit, seed):
    import eivor as ev

    rng = np.random.default_rng(seed)
    files = sorted(
        (*recordings.glob("px4*/*.ulg"), *recordings.glob("ardupilot/*.bin"), *recordings.glob("nano*/*.csv"))
    )
    log = cut_short(ev.read_log(files[int(rng.integers(0, len(files)))]), rng)
    library = use_library(log, good_fit, CHOICES[int(rng.integers(0, len(CHOICES)))])
    assert not INTERNAL.search(library), library


@pytest.mark.thorough
def test_damaged_recordings_end_so(eivor, recordings, tmp_path):
    """Fifty random cuts and corruptions are read; two are inspected as well."""
    import eivor as ev
    from eivor.errors import EivorError

    rng = np.random.default_rng(0)
    files = sorted((*recordings.glob("px4*/*.ulg"), *recordings.glob("nano*/*.csv")))
    small = [file for file in files if file.stat().st_size < LARGEST_DAMAGED]
    for number in range(50):
        file = small[int(rng.integers(len(small)))]
        log = tmp_path / f"{number}{file.suffix}"
        log.write_bytes(damaged(file.read_bytes(), rng))
        try:
            said = str(ev.read_log(log).findings)
        except EivorError as error:
            said = str(error)
            assert re.fullmatch(r"Expected .*; received .*[.?]", said, re.DOTALL), (number, said)
        if number % 25 == 0:
            run = eivor("inspect", log)
            assert run.code in COMMANDS["inspect"], (number, run.err)
            said = " ".join(f"{said} {run.out} {run.err}".split())
        assert not INTERNAL.search(said), (number, said)
