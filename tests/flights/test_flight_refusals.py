"""Logs and options of flights that are refused, each with the reason and the remedy."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial

import numpy as np
from flight_logs import changed, flown, prepare_vertical
from flight_logs import channel as logged
from test_grid import channel, empty

import eivor as ev
from eivor.errors import InputError, MissingChannelError, ParameterError, PoolingError, ShapeError, UsageError
from eivor.flights.grid import common_grid
from eivor.flights.options import FlightOptions
from eivor.motions.vertical.select import vertical_row
from refusal_rows import calls, rows, table

still = cache(lambda: flown(seconds=20.0)[0])
fleet = cache(lambda: flown(2, seconds=10.0, seed=14))
EARLY, LATE = channel([0.0, 1.0], [0.0, 0.0]), channel([2.0, 3.0], [0.0, 0.0], name="input")
HOURS = channel(np.arange(0.0, 7 * 3600.0, 1.0), np.zeros(7 * 3600))
NONE_OF_BOTH = r"velocity_z, input are all logged; received none \(the last begins at 2"
MICROSECONDS = r"at most 6 hours; received stamps that cover 16666\.7 hours.*unit"
GRIDS = rows("grid", InputError, lambda *parts: common_grid(parts, []),
    (EARLY, LATE, NONE_OF_BOTH),
    (EARLY, channel([1.0, 3.0], [0.0, 0.0]), "Expected a stretch of time"),
    (HOURS, HOURS, r"7\.0 hours"),
    (channel([0.0, 6e7], [0.0, 0.0]), MICROSECONDS),
)  # fmt: skip
OPTIONS = rows("option", UsageError, lambda options: FlightOptions(**options),
    ({"window": (5.0, 5.0)}, "a window START:END with START before END; received 5:5"),
    ({"window": (float("nan"), 5.0)}, "a window START:END"),
    ({"max_tilt_deg": 0.0}, "a largest tilt between 0 and 90 degrees; received 0"),
    *(({"max_tilt_deg": tilt}, "a largest tilt") for tilt in (math.nan, 90.0)),
    ({"pool_friction": "seperate"}, "pool_friction out of auto, common, separate"),
)  # fmt: skip
LAGS = calls("lag", None,
    (lambda: FlightOptions(lag=ev.Prior(-0.02, 0.01)), UsageError, "a lag above zero"),
    (lambda: FlightOptions(lag=ev.Bounds(50.0, 90.0)), UsageError, "between 0 and 1 s"),
    (lambda: FlightOptions(lag=ev.Bounds(-0.01, 0.05)), UsageError, "between 0 and 1 s"),
    (lambda: ev.Bounds(0.09, 0.05), ParameterError, "the lower one first"),
    *((partial(FlightOptions, accelerometer_bias=bias), UsageError, "bias above zero")
        for bias in (0.0, -0.1, math.nan)),
    (lambda: FlightOptions(input_map="fit", accelerometer_bias=math.inf), UsageError, "a finite"),
)  # fmt: skip


def prepared(change, options):
    prepare_vertical(changed(still(), *change), FlightOptions(**options))


CHANNELS = rows("channel", None, prepared,
    (("velocity_z", "position_z"), {}, MissingChannelError, "the channel 'velocity_z' in flight 0"),
    (("rotor_command_1",), {}, MissingChannelError, "an input in flight 0: rotor_command_1"),
    ((), {"input": "throttle"}, UsageError, r"an input out of the channels .*; received 'throttle'"),
    ((), {"input": "attitude"}, UsageError, "an input out of the channels"),
    ((), {"instruments": ("pilot_throttle",)}, MissingChannelError, "'pilot_throttle'"),
)  # fmt: skip
WINDOW = r"a window START:END inside the log, .* 0\.00 to 19\.99 s"
WINDOWS = rows("window", UsageError, lambda *window: prepared((), {"window": window}),
    (30.0, 40.0, WINDOW),
    (-5.0, 0.0, WINDOW),
)  # fmt: skip
NOISES = rows("noise", UsageError, lambda noise: prepared((), {"noise": noise}),
    ({"speed_z": 0.1}, "'speed_z'"),
    ({"velocity_z": -0.1}, "zero or more"),
    ({"velocity_z": float("nan")}, "zero or more"),
    ("guess", "estimate"),
)  # fmt: skip
EMPTY = rows("empty channel", MissingChannelError,
    lambda name, kept: prepare_vertical(changed(still(), **{name: empty(name, kept)}), FlightOptions()),
    *(
        (name, kept, rf"values in the channel '{name}' of flight 0; received \d samples")
        for name in ("velocity_z", "rotor_command_1")
        for kept in ("nothing", "one sample", "NaN")
    ),
)  # fmt: skip


def shifted():
    command = still().channels["rotor_command_1"]
    late = changed(still(), rotor_command_1=replace(command, time_s=command.time_s + 100.0))
    prepare_vertical(late, FlightOptions())


def attitude_on_two_clocks():
    stamps = np.arange(3.0)
    vertical_row([logged(f"attitude_{axis}", stamps + (axis == "y"), np.ones(3)) for axis in "wxyz"])


def of_measured_speed():
    speed = replace(still().channels["rotor_command_1"], name="rotor_speed_1", held=False)
    log = changed(still(), "rotor_command_1", rotor_speed_1=speed)
    ev.identify_flight(log, lag=ev.Prior(0.05, 0.01))


LOGS = calls("log", None,
    (shifted, InputError, "Expected a stretch of time in which"),
    (lambda: prepare_vertical(replace(still(), vehicle="fixed wing"), FlightOptions()), InputError,
        r"which says that it is of a fixed wing.*multirotors"),
    (attitude_on_two_clocks, ShapeError, "the four parts of an attitude on one clock; received 3 stamps"),
    (of_measured_speed, UsageError, "whose actuators' lag is searched for"),
    (lambda: ev.identify_flight([]), UsageError, "Expected at least one recording"),
)  # fmt: skip
A_PRIOR = r"ev\.Prior\(0\.070, 0\.015\) or ev\.Bounds"
CALLS = rows("call", UsageError, lambda options: ev.identify_flight([still()], **options),
    *(({"lag": lag}, A_PRIOR) for lag in (70, "70:15", (0.07, 0.015))),
    ({"windows": []}, "Expected 1 windows, one for each log"),
    ({"windows": [None, None]}, "Expected 1 windows"),
    ({"method": "magic"}, "Expected"),
    ({"input_map": "cubic"}, "Expected"),
)  # fmt: skip


def of_two_vehicles(change):
    first, second = fleet()
    ev.identify_flight([replace(first, parameters={"THR_MDL_FAC": 0.2}), change(second)])


def with_command(log, name, gain=1.0):
    values = gain * log.channels["rotor_command_1"].values
    return changed(log, *([] if name == "rotor_command_2" else ["rotor_command_1"]), **{name: values})


ALIKE = "Expected flights of one vehicle: flight 0 and flight 1 alike; received "
POOLS = rows("pool", PoolingError, of_two_vehicles,
    (lambda log: replace(log, input_map="linear"), ALIKE + "input maps square and linear"),
    (lambda log: replace(log, parameters={"THR_MDL_FAC": 0.3}), ALIKE + r"THR_MDL_FAC = 0\.2 and 0\.3"),
    (partial(with_command, name="rotor_command_2"), ALIKE + "1 and 2 rotors"),
    (partial(with_command, name="rotor_command_1", gain=1e-3),
        ALIKE + r"inputs of .* which are not on one scale"),
    (partial(with_command, name="rotor_speed_1"), ALIKE + "inputs rotor_command and rotor_speed"),
)  # fmt: skip


test_refused = table(
    GRIDS, OPTIONS, LAGS, CHANNELS, WINDOWS, NOISES, EMPTY, LOGS, CALLS, POOLS, fixtures=("coarse_search",)
)
