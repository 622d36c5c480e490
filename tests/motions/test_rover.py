"""The rover of the examples: a motion of another package, which nothing in Eivor knows."""

from __future__ import annotations

import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from typer.testing import CliRunner

import eivor as ev
from eivor import motions
from eivor.cli.main import app
from eivor.errors import ChannelMapError
from eivor.flights.motion import InstrumentStrength, VerdictInputs
from eivor.flights.quantity import QuantityEstimate
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.verdict import verdict
from eivor.motions import loaded_motion, motion_by_name
from eivor.signals import channels

ROVER = Path(__file__).parents[2] / "examples" / "motions" / "rover"


@pytest.fixture
def simulate(monkeypatch):
    """The simulator of the example, whose package is as if it were installed."""
    monkeypatch.syspath_prepend(str(ROVER))
    monkeypatch.syspath_prepend(str(ROVER / "src"))
    monkeypatch.setattr(channels, "_TABLE", dict(channels.canonical_channels()))
    point = EntryPoint("rover", "eivor_rover:Rover", motions.GROUP)
    monkeypatch.setattr(motions, "entry_points", lambda *, group: [point] if group == motions.GROUP else [])
    loaded_motion.cache_clear()
    import simulate

    yield simulate
    loaded_motion.cache_clear()
    for name in [name for name in sys.modules if name == "simulate" or name.startswith("eivor_rover")]:
        del sys.modules[name]


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_the_rover_is_identified_and_refused(simulate, tmp_path):
    motion_by_name("rover")
    fit = ev.identify_flight(ev.recording_from_columns(simulate.drive(1), name="drive"), model="rover")
    assert fit.verdict.status.value == "identified"
    for name, true in simulate.TRUTH.items():
        low, high = fit.quantities[name].interval
        assert low <= true <= high, name
    # Two quantities make the headline: both are looked at closely, and either refuses.
    assert {"least_squares_drive_gain", "least_squares_dry_friction"} <= set(fit.diagnostics)
    simulate.write(simulate.drive(1, constant_speed=1.0), tmp_path / "still.csv")
    done = CliRunner().invoke(
        app, ["identify", str(tmp_path / "still.csv"), "--model", "rover", "--json", "-"]
    )
    assert done.exit_code == 3
    document = json.loads(done.output)
    assert document["model"]["name"] == "rover"
    assert document["verdict"] == "refused"
    assert list(document["derived"]) == ["effective_lag", "breakaway_command", "time_constant"]


@pytest.mark.long
@pytest.mark.usefixtures("unchecked_shapes")
def test_a_pool_of_drives_is_drawn_again(simulate):
    """The motion says nothing of replicates: they are of its parameters, and of what was searched for."""
    rover = motion_by_name("rover")
    drives = [ev.recording_from_columns(simulate.drive(seed), name=f"drive {seed}") for seed in (1, 2)]
    pool = ev.identify_flight(drives, model=rover)
    bootstrap_flights = ev.bootstrap_flights(pool, runs=39)
    assert bootstrap_flights.names == ("rolling_drag", "dry_friction", "drive_gain", "actuator_lag", "delay")
    assert bootstrap_flights.units == ("1/s", "m/s^2", "m/s^2", "s", "s")
    assert (bootstrap_flights.pieces, bootstrap_flights.failed) == (2, 0)
    for name, value in zip(bootstrap_flights.names, bootstrap_flights.values, strict=True):
        assert value == pytest.approx(pool.quantities[name].value, rel=1e-4)
        if name != "delay":
            # draws of two drives are three, one of them the pool: their range holds it and no more is claimed
            low, high = bootstrap_flights.interval(name)
            assert low <= value <= high
            assert high - low > 0.1 * pool.quantities[name].half_width


def test_other_motions_do_not_know_its_channels(simulate, tmp_path):
    simulate.write(simulate.drive(1), tmp_path / "drive.csv")
    with pytest.raises(ChannelMapError, match="known once it is named"):
        ev.read_log(tmp_path / "drive.csv")


@pytest.mark.usefixtures("simulate")
def test_weak_instruments_refuse_what_has_no_set():
    from eivor_rover.rule import reasons

    names = ("drive_gain", "dry_friction", "rolling_drag", "effective_lag")
    quantities = {name: QuantityEstimate(1.0, "", 0.02, (0.95, 1.05)) for name in names}
    verdict_inputs = VerdictInputs(1, 100.0, 100.0, exogenous=True, direct=False)
    sets = dict.fromkeys(names[:2], ConfidenceSet(((0.95, 1.05),)))
    for F, robust, wanted in ((3.0, sets, "refused"), (3.0, {}, "refused"), (30.0, {}, "identified")):
        result = reasons(quantities, InstrumentStrength({"drive_gain": F}, 0.5, {}, robust), verdict_inputs)
        sentence = {name: verdict(list(reasons)).status.value for name, reasons in result.items()}
        assert sentence["rolling_drag"] == sentence["breakaway_command"] == wanted
        assert sentence["drive_gain"] == ("weak" if robust else wanted)
