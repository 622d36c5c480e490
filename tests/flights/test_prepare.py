"""Preparation: which samples are used, which channels serve, and the sentences of refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_logs import STEP_S, changed, channel, flown, prepare_vertical

from eivor.errors import InputError, MissingChannelError, UsageError
from eivor.flights.grid import Grid, curve_between, line_between
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import triangle_mean
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.model import GRAVITY
from eivor.motions.vertical.motion import vertical_flight
from eivor.signals.recording import Channel, Recording
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights


@pytest.fixture(scope="module")
def log():
    return flown(seconds=20.0)[0]


def bounds(prepared):
    """First and last second of each run."""
    return [
        (prepared.signals.start_s + run.start * STEP_S, prepared.signals.start_s + (run.stop - 1) * STEP_S)
        for run in prepared.runs
    ]


def with_command_gap(log, start, end):
    command = log.channels["rotor_command_1"]
    keep = (command.time_s < start) | (command.time_s >= end)
    return changed(
        log, rotor_command_1=replace(command, time_s=command.time_s[keep], values=command.values[keep])
    )


def test_window_cuts_the_run(log):
    prepared = prepare_vertical(log, FlightOptions(window=(4.0, 12.5)))
    assert bounds(prepared) == [pytest.approx((4.0, 12.5 - 0.01))]  # 850 of 851 samples, which is 23 * 37
    # A window that reaches beyond the log ends with it.
    assert bounds(prepare_vertical(log, FlightOptions(window=(15.0, 99.0)))) == [pytest.approx((15.0, 19.99))]


@pytest.mark.parametrize("window", [(30.0, 40.0), (-5.0, 0.0)])
def test_windows_outside_the_log_are_refused(log, window):
    with pytest.raises(
        UsageError, match=r"Expected a window START:END inside the log, which spans 0\.00 to 19\.99 s"
    ):
        prepare_vertical(log, FlightOptions(window=window))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"window": (5.0, 5.0)}, "a window START:END with START before END; received 5:5"),
        ({"window": (float("nan"), 5.0)}, "a window START:END"),
        ({"max_tilt_deg": 0.0}, "a largest tilt between 0 and 90 degrees; received 0"),
        ({"max_tilt_deg": float("nan")}, "a largest tilt"),
        ({"max_tilt_deg": 90.0}, "a largest tilt"),
    ],
)
def test_impossible_options_are_refused(options, said):
    with pytest.raises(UsageError, match=said):
        FlightOptions(**options)


def test_tilt_beyond_the_limit_is_left_out(log):
    tilt = np.ones(2000)
    tilt[800:900] = np.cos(np.deg2rad(20.0))
    tilt[1300:1400] = np.cos(np.deg2rad(30.0))
    leaning = changed(log, cos_tilt=tilt)
    assert len(prepare_vertical(leaning, FlightOptions()).runs) == 1
    assert prepare_vertical(leaning, FlightOptions()).used.sum() == 1900
    assert prepare_vertical(leaning, FlightOptions(max_tilt_deg=10.0)).used.sum() == 1800
    assert prepare_vertical(leaning, FlightOptions(max_tilt_deg=40.0)).used.sum() == 2000


def test_a_gap_of_the_command_breaks_the_run_and_is_waited_for(log):
    prepared = prepare_vertical(with_command_gap(log, 8.0, 9.0), FlightOptions())
    first, second = bounds(prepared)
    assert first == pytest.approx((0.0, 7.99), abs=0.011)
    assert second[0] == pytest.approx(9.3, abs=0.021)


def test_acceleration_may_be_logged_without_gravity(log):
    force = log.channels["specific_force_z"].values
    coordinate = changed(log, "specific_force_z", acceleration_z=force - GRAVITY)
    vertical, other = prepare_vertical(log, FlightOptions()), prepare_vertical(coordinate, FlightOptions())
    np.testing.assert_allclose(
        other.signals.channel("specific_force_z"), vertical.signals.channel("specific_force_z")
    )


@pytest.mark.parametrize(
    ("missing", "finding"), [("specific_force_z", "no_accelerometer"), ("cos_tilt", "no_attitude")]
)
def test_what_is_not_logged_becomes_a_finding(log, missing, finding):
    prepared = prepare_vertical(changed(log, missing), FlightOptions())
    assert finding in [item.name for item in prepared.findings]
    np.testing.assert_array_equal(prepared.signals.channel("cos_tilt"), 1.0)
    assert prepared.rates_hz["acceleration"] == (
        0.0 if missing == "specific_force_z" else pytest.approx(100.0)
    )


def test_commands_come_before_measured_speeds_before_inputs(log):
    steady = np.full(2000, 0.5)
    everything = changed(log, rotor_speed_1=steady, input=steady)
    for drop, family, measured, name in (
        ((), "rotor_command", False, "square"),
        (("rotor_command_1",), "rotor_speed", True, "square"),
        (("rotor_command_1", "rotor_speed_1"), "input", False, "linear"),
    ):
        prepared = prepare_vertical(replace(changed(everything, *drop), input_map=""), FlightOptions())
        assert (prepared.input.name, prepared.input.measured, prepared.input_map) == (family, measured, name)


def test_map_is_the_users_then_the_logs(log):
    assert prepare_vertical(replace(log, input_map="mixed:0.3"), FlightOptions()).input_map == "mixed:0.3"
    options = FlightOptions(input_map="power:1.5")
    assert prepare_vertical(replace(log, input_map="mixed:0.3"), options).input_map == "power:1.5"


@pytest.mark.parametrize(
    ("change", "options", "error", "said"),
    [
        (("velocity_z",), {}, MissingChannelError, "the channel 'velocity_z' in flight 0"),
        (("rotor_command_1",), {}, MissingChannelError, "an input in flight 0: rotor_command_1"),
        ((), {"input": "throttle"}, UsageError, r"an input out of the channels .*; received 'throttle'"),
        ((), {"input": "attitude"}, UsageError, "an input out of the channels"),
        ((), {"instruments": ("pilot_throttle",)}, MissingChannelError, "'pilot_throttle'"),
    ],
)
def test_missing_channels_are_named(log, change, options, error, said):
    with pytest.raises(error, match=said):
        prepare_vertical(changed(log, *change), FlightOptions(**options))


def empty(name, kept):
    """A channel that is there and says nothing."""
    return {
        "nothing": channel(name, [], []),
        "one sample": channel(name, [1.0], [1.0]),
        "NaN": channel(name, np.arange(3.0), np.full(3, np.nan)),
    }[kept]


@pytest.mark.parametrize("kept", ["nothing", "one sample", "NaN"])
def test_an_empty_accelerometer_is_done_without(log, kept):
    prepared = prepare_vertical(
        changed(log, specific_force_z=empty("specific_force_z", kept)), FlightOptions()
    )
    assert "empty_channel" in [finding.name for finding in prepared.findings]
    assert vertical_flight(prepared).acceleration is None
    assert prepared.runs


@pytest.mark.parametrize("name", ["velocity_z", "rotor_command_1"])
@pytest.mark.parametrize("kept", ["nothing", "one sample", "NaN"])
def test_channels_without_values_are_named(log, name, kept):
    broken = empty(name, kept)
    with pytest.raises(
        MissingChannelError, match=rf"values in the channel '{name}' of flight 0; received \d samples"
    ):
        prepare_vertical(changed(log, **{name: broken}), FlightOptions())


def test_clocks_without_overlap_are_refused(log):
    command = log.channels["rotor_command_1"]
    shifted = changed(log, rotor_command_1=replace(command, time_s=command.time_s + 100.0))
    with pytest.raises(InputError, match="Expected a stretch of time in which"):
        prepare_vertical(shifted, FlightOptions())


def remarks(log, **options):
    return {r.name: r.remark for r in prepare_vertical(log, FlightOptions(**options)).references}


def test_pilots_stick_counts_while_a_pilot_flies(log):
    stick = changed(log, pilot_throttle=np.sin(STEP_S * np.arange(2000)))
    assert "pilot_throttle" in prepare_vertical(stick, FlightOptions()).usable_references
    for share, serves in ((0.4, False), (0.6, True)):
        flies = channel("pilot_in_control", [0.0, 20.0 * share], [1.0, 0.0])
        flies = replace(flies, held=True)
        judged = changed(stick, pilot_in_control=flies)
        assert ("pilot_throttle" in prepare_vertical(judged, FlightOptions()).usable_references) is serves
        if not serves:
            assert remarks(judged)["pilot_throttle"] == "no pilot flies"


def test_a_reference_that_is_set_to_the_measured_height_stands_still_there():
    """Landings begin at the measured height, and so do height holds: such a jump answers the vehicle."""
    (log,) = flown(1, seconds=20.0, seed=3)
    height, wanted = log.channel("position_z"), log.channel("reference_position_z")
    measured = np.interp(wanted.time_s, height.time_s, height.values)
    flying = wanted.time_s < 12.0  # with a standing error, and then a landing from where the vehicle is
    landing = replace(wanted, values=np.where(flying, wanted.values + 0.3, measured[1200]))
    between = (wanted.time_s > 5.0) & (wanted.time_s < 9.0)
    held = replace(wanted, values=np.where(between, measured, wanted.values - 0.3))
    for other, times in ((landing, "11.9"), (held, "4.9")):
        flight = prepare_vertical(changed(log, reference_position_z=other), FlightOptions())
        (reference,) = [item for item in flight.references if item.name == "reference_position_z"]
        assert f"set to the measured position_z at {times}" in reference.remark
        assert any(finding.name == "reference_reset" for finding in flight.findings)
        np.testing.assert_array_equal(flight.reference_on_grid(reference.name), reference.logged)
        moved = np.abs(np.diff(reference.values))
        assert moved.max() < 0.05 < np.abs(np.diff(reference.logged)).max()
    echo = changed(log, reference_position_z=replace(wanted, values=measured))
    assert remarks(echo)["reference_position_z"] == "it is the measured position_z"
    steps = replace(wanted, values=np.where(wanted.time_s % 4.0 < 2.0, 0.5, -0.5))
    kinks = replace(wanted, values=np.abs(wanted.time_s % 4.0 - 2.0))
    for clean in (wanted, steps, kinks):
        flight = prepare_vertical(changed(log, reference_position_z=clean), FlightOptions())
        assert all(reference.logged is None for reference in flight.references)


def test_references_must_be_in_force_for_half_of_the_flight(log):
    position = log.channels["reference_position_z"].values.copy()
    position[900:] = np.nan
    assert remarks(changed(log, reference_position_z=position))["reference_position_z"] == (
        "in force for 45% of the flight only"
    )
    # Within a window in which it is in force it serves.
    windowed = prepare_vertical(changed(log, reference_position_z=position), FlightOptions(window=(0.0, 8.0)))
    assert "reference_position_z" in windowed.usable_references


def test_feedback_serves_only_when_nothing_else_does(log):
    velocity = changed(log, feedback_reference_velocity_z=np.sin(STEP_S * np.arange(2000)))
    assert remarks(velocity)["feedback_reference_velocity_z"] == "contains feedback; others serve"
    alone = changed(velocity, "reference_position_z", "reference_velocity_z")
    assert prepare_vertical(alone, FlightOptions()).usable_references == ("feedback_reference_velocity_z",)
    still = changed(velocity, "reference_velocity_z", reference_position_z=np.zeros(2000))
    assert prepare_vertical(still, FlightOptions()).usable_references == ("feedback_reference_velocity_z",)


def test_instruments_may_be_named(log):
    prepared = prepare_vertical(log, FlightOptions(instruments=("reference_velocity_z", "velocity_z")))
    assert prepared.usable_references == ("reference_velocity_z", "velocity_z")
    np.testing.assert_array_equal(
        prepared.signals.channel("reference_velocity_z"), log.channels["reference_velocity_z"].values
    )


def test_named_channels_of_the_vehicle_itself_answer_it(log):
    extra = changed(log, battery_voltage=np.ones(2000), pilot_in_control=np.ones(2000))
    names = ("velocity_z", "rotor_command_1", "battery_voltage", "pilot_in_control", "reference_velocity_z")
    references = prepare_vertical(extra, FlightOptions(instruments=names)).references
    assert {r.name: r.exogenous for r in references} == dict(
        zip(names, (False, False, False, True, True), strict=True)
    )


def test_no_usable_sample_leaves_no_reference(log):
    grounded = changed(log, landed=channel("landed", [0.0, 19.0], [1.0, 1.0]))
    prepared = prepare_vertical(grounded, FlightOptions())
    assert prepared.runs == ()
    assert set(remarks(grounded).values()) == {"no usable sample of flight"}
    assert not prepared.constant_input


def test_a_log_of_a_plane_is_refused_as_one(log):
    with pytest.raises(InputError, match=r"which says that it is of a fixed wing.*multirotors"):
        prepare_vertical(replace(log, vehicle="fixed wing"), FlightOptions())


SEEDS = range(50, 58)


@pytest.mark.thorough
def test_gains_are_not_small():
    specs = [VerticalFlightSpec(seed=seed, duration=60.0) for seed in SEEDS]
    errors = []
    for spec, flight in zip(specs, simulate_vertical_flights(specs), strict=True):
        channels = dict(flight.recording.channels)
        for name in ("velocity_z", "position_z"):
            channel = channels[name]
            channels[name] = Channel(name, channel.time_s[::10], channel.values[::10], channel.unit)
        fit = identify_flight(Recording("slow", "simulated", channels))
        gain = fit.quantities["input_gain"]
        errors.append((gain.value / spec.input_gain - 1.0, gain.std_error / spec.input_gain))
    error, scatter = np.array(errors).T
    # lines between the stamps make it 0.55 % too small, twice what chance does to eight flights
    assert abs(error.mean()) < 2.0 * np.sqrt(np.mean(scatter**2) / error.size)
    assert abs(error.mean()) < 0.003


GRID = Grid(0.0, 0.005, (range(4000),))


@pytest.mark.parametrize("frequency_hz", [1.0, 4.0, 8.0])
def test_amplitudes_shrink_as_those_of_a_line_between_stamps(frequency_hz):
    time, width_s = GRID.time_s, 0.02
    series = np.sin(2.0 * np.pi * frequency_hz * time)
    # the line between samples that are as far apart, with every phase of the samples
    lines = np.mean(
        [
            np.interp(time, stamps, np.sin(2.0 * np.pi * frequency_hz * stamps))
            for stamps in (np.arange(-0.1, 20.1, width_s) + shift for shift in np.arange(0.0, width_s, 0.001))
        ],
        axis=0,
    )
    inside = slice(100, -100)
    spread = triangle_mean(series, GRID, width_s)
    gains = [
        float(item[inside] @ series[inside] / (series[inside] @ series[inside])) for item in (spread, lines)
    ]
    assert gains[0] == pytest.approx(gains[1], abs=6e-3)
    assert gains[0] < 1.0


STAMPS = np.arange(0.0, 20.0, 0.1)
AT = np.arange(1.0, 19.0, 0.01)


def test_numbers_near_the_largest_give_numbers():
    values = 1e308 * (-1.0) ** np.arange(STAMPS.size)
    with np.errstate(all="ignore"):
        between, line = curve_between(STAMPS, values, AT), line_between(STAMPS, values, AT)
    assert np.array_equal(np.isfinite(between), np.isfinite(line))
