"""Identify simulated drives, in Python and on the command line, and compare with the truth behind them.

python check.py FOLDER

Needs the package installed: pip install --no-deps examples/motions/rover. Everything is made in FOLDER.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import simulate

import eivor as ev
from eivor.estimation.bootstrap import Bootstrap

#: The first seed that there is; others are shown by `simulate.py --seed`.
SEED = 1
#: Rate of the rover's controller [Hz]: the log holds every command.
CONTROLLER_HZ = 100.0
#: Seeds of the drives of each pool.
POOLS = ((1, 2, 3), (4, 5, 6), (7, 8, 9))
#: Pools, at least, in which the interval of a quantity holds the truth: two misses of 5 % each are rare.
FEWEST_HELD = 2
MAP = """name = "rover with its own words"

[time]
column = "stamp"

[channels.forward_speed]
column = "wheels"

[channels.drive_command]
column = "motor"

[channels.reference_forward_speed]
column = "asked"
"""
OWN_WORDS = {
    "time": "stamp",
    "forward_speed": "wheels",
    "drive_command": "motor",
    "reference_forward_speed": "asked",
}


def expect(what: str, *, holds: bool) -> None:
    """Say what holds, and stop at what does not."""
    print(("holds: " if holds else "DOES NOT HOLD: ") + what)
    if not holds:
        raise SystemExit(1)


def covered(fit: ev.FlightEstimate) -> list[str]:
    """Quantities whose interval holds the truth."""
    return [
        name
        for name, true in simulate.TRUTH.items()
        if fit.quantities[name].interval[0] <= true <= fit.quantities[name].interval[1]
    ]


def pooled(seeds: tuple[int, ...], controller_rate_hz: float | None = None) -> ev.FlightEstimate:
    """Identify the pool of several drives."""
    logs = [ev.recording_from_columns(simulate.drive(seed), name=f"drive {seed}") for seed in seeds]
    return ev.identify_flight(logs, model="rover", controller_rate_hz=controller_rate_hz)


def identify(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run ``eivor identify --model rover``."""
    command = [sys.executable, "-c", "from eivor.cli.main import run; run()", "identify", "--model", "rover"]
    return subprocess.run([*command, *map(str, arguments)], capture_output=True, text=True, check=False)


def from_python(folder: Path) -> None:
    """Identify the drive from tables with canonical columns, and from one with columns of its own."""
    ev.motion_by_name("rover")  # its channels are known from here on
    for ending in ("csv", "parquet"):
        simulate.write(simulate.drive(SEED), folder / f"drive.{ending}")
    fit = ev.identify_flight(ev.read_log(folder / "drive.csv"), model="rover")
    expect("the drive is identified", holds=fit.verdict.status.value == "identified")
    expect(f"every interval holds the truth (seed {SEED})", holds=covered(fit) == list(simulate.TRUTH))
    again = ev.identify_flight(ev.read_log(folder / "drive.parquet"), model=ev.motion_by_name("rover"))
    expect("Parquet says the same", holds=again.parameters == fit.parameters)

    columns = simulate.drive(SEED)
    simulate.write({name: columns[item] for item, name in OWN_WORDS.items()}, folder / "words.csv")
    (folder / "words.toml").write_text(MAP, encoding="utf-8")
    mapped = ev.read_log(folder / "words.csv", channel_map=folder / "words.toml")
    without = ev.identify_flight(mapped, model="rover")
    expect(
        "a channel map names the rover's channels; without an accelerometer the gain is found all the same",
        holds="drive_gain" in covered(without)
        and "forward_acceleration" not in mapped.channels
        and "forward_acceleration_rate_hz" not in without.diagnostics,
    )
    pools = [pooled(seeds) for seeds in POOLS]
    pool = pools[0]
    narrower = pool.quantities["dry_friction"].half_width < fit.quantities["dry_friction"].half_width
    expect("a pool of three knows the dry friction better", holds=narrower and len(pool.flights) == 3)
    held = [covered(item) for item in pools]
    times = {name: sum(name in names for names in held) for name in simulate.TRUTH}
    expect(
        f"intervals of pools hold the truth in {FEWEST_HELD} of {len(POOLS)} at least ({times})",
        holds=min(times.values()) >= FEWEST_HELD,
    )
    lags = [item.quantities[name] for item in pools for name in ("actuator_lag", "delay", "effective_lag")]
    expect(
        "no interval of lag or delay ends at the estimate",
        holds=all(lag.interval[0] < lag.value < lag.interval[1] for lag in lags),
    )
    # drives that are drawn again do not show what the log leaves open of its command's clock
    drawn = ev.bootstrap_flights(pooled(POOLS[0], controller_rate_hz=CONTROLLER_HZ), runs=99)
    expect(
        "so do drives that are drawn again; without a word on replicates they are of what was searched for",
        holds=drawn.names == ("rolling_drag", "dry_friction", "drive_gain", "actuator_lag", "delay")
        and all(low <= simulate.TRUTH[name] <= high for name, (low, high) in intervals(drawn).items()),
    )
    print(fit.summary())


def intervals(drawn: Bootstrap) -> dict[str, tuple[float, float]]:
    """Interval of each quantity of a bootstrap."""
    return {name: drawn.interval(name) for name in drawn.names}


def from_the_command_line(folder: Path) -> None:
    """Table, JSON, figure and exit codes, of a drive that tells and of one that cannot."""
    done = identify(folder / "drive.csv", "--json", folder / "fit.json", "--figure", folder / "fit.png")
    print(done.stdout, done.stderr)
    expect("the exit code is 0", holds=done.returncode == 0)
    text = " ".join(done.stdout.split())
    for words in ("drive gain ", "+ drive_gain drive_command + b"):
        expect(f"the table says '{words}'", holds=words in text)
    document = json.loads((folder / "fit.json").read_text(encoding="utf-8"))["motions"]["rover"]
    expect("the model has its name", holds=document["model"]["name"] == "rover")
    expect("the verdict is identified", holds=document["verdict"] == "identified")
    low, high = document["parameters"]["dry_friction"]["interval"]
    expect("the document's interval holds the truth", holds=low <= simulate.TRUTH["dry_friction"] <= high)
    expect("the figure is drawn", holds=(folder / "fit.png").stat().st_size > 10_000)

    simulate.write(simulate.drive(SEED, constant_speed=1.0), folder / "still.csv")
    done = identify(folder / "still.csv", "--json", "-")
    document = json.loads(done.stdout)["motions"]["rover"]
    expect(
        "a drive at constant speed is refused",
        holds=done.returncode == 3 and document["verdict"] == "refused",
    )
    expect("since the reference never moved", holds="The reference never moved" in document["reasons"][0])


def main() -> None:
    """Check everything."""
    folder = Path(sys.argv[1])
    from_python(folder)
    from_the_command_line(folder)


if __name__ == "__main__":
    main()
