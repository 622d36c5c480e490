"""Commands that are refused: the exit code, one sentence, and nothing that is printed or written."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from test_cli_simulate import FLIGHT, FLOWN, LOST, STUDY

import eivor as ev
from eivor.cli.parsing import declared_noise, parse_names, parse_window
from eivor.errors import UsageError
from exports.documents import document, written
from refusal_rows import rows, table

#: What each command finds beside `flight.csv`, a log of 30 s, and `fit.json`, a result.
FILES = {
    "empty.csv": b"",
    "cut.ulg": b"ULog\x01\x12\x35\x01" + bytes(8),  # ends in its head
    "dataflash.log": b"\xa3\x95\x80\x80" * 100,
    "noise.log": bytes(range(256)) * 8,
    "text.csv": b"time,velocity_z\n0,x\n",
    "small.toml": STUDY,
    "hover.toml": FLIGHT,
    "vehicle.toml": "mas = 1\n[rotors]\nlayout = 'quad-x'\nnumbering = 'px4'",
    "logs/a.csv": "one",
}
#: Options that are not passed over when they are empty.
EMPTY = ["--lag", "--lag-from", "--window", "--input", "--input-map", "--map", "--json", "--figure", "--html"]
COMMANDS = (
    ("identify", 2, "one or more logs"),
    ("identify --example flight.csv", 2, "received both"),
    ("identify flight.csv --window 9:2", 2, "START before END"),
    ("identify flight.csv --window 900:950", 2, "spans 0.00 to"),
    ("identify flight.csv@900:950", 2, "spans 0.00 to"),
    ("identify flight.csv blind.csv@500:600", 2, "blind.csv"),
    *((f"identify flight.csv --max-tilt {tilt}", 2, "between 0 and 90") for tilt in (0, "nan")),
    ("identify flight.csv --max-tilt x", 2, "--max-tilt"),
    ("identify flight.csv --method magic", 2, "a method out of"),
    ("identify flight.csv --input-map cube", 2, "an input map"),
    ("identify flight.csv --input nothing", 2, "an input out of"),
    ("identify flight.csv --instruments nothing", 2, "'nothing'"),
    ("identify flight.csv --instruments lags,references", 2, "alone"),
    ("identify --example --map nofile.toml", 2, "--example with --map nofile.toml"),
    ("identify flight.csv --method least_squares --instruments lags", 2, "least_squares uses none"),
    ("identify --example --method total_least_squares --instruments references", 2, "uses none"),
    ("identify flight.csv --figure x.gif", 2, r"\.png, \.svg, \.pdf"),
    ("identify flight.csv --json flight.csv", 2, "would replace"),
    ("identify flight.csv --nonsense", 2, "No such option"),
    ("identify cut.ulg --map nanobench", 2, "channel map"),
    ("identify flight.csv --lag 70:15 --lag-from other.json", 2, "--lag or --lag-from"),
    ("identify flight.csv --lag-from none.json", 1, "none.json"),
    ("identify empty.csv", 1, "empty"),
    *((f"identify {name}", 1, name) for name in ("cut.ulg", "dataflash.log", "noise.log", "none.ulg")),
    ("identify text.csv", 1, "text.csv"),
    ("identify flight.csv cut.ulg", 1, "cut.ulg"),
    ("identify .", 1, "a log"),
    ("identify blind.csv", 1, "looked for: column velocity_z.. Did you mean 'velocty_z'"),
    ("identify flight.csv --term grond", 2, "Did you mean 'ground-effect'"),
    ("identify flight.csv --json none/x.json", 1, "does not exist"),
    ("identify flight.csv --figure none/x.png", 1, "does not exist"),
    ("identify --example --for hover,,lag", 2, ""),
    ("identify --example --for hovr", 2, r"Did you mean 'hover'\?"),
    ("track", 2, "one or more logs"),
    ("validate flight.csv flight.csv", 1, "a document of schema eivor.identify/1"),
    ("validate none.json flight.csv", 1, "none.json"),
    ("report flight.csv", 2, "-o flight.html"),
    ("report cut.ulg -o flight.html", 1, "cut.ulg"),
    ("inspect", 2, "one or more logs"),
    ("inspect flight.csv --example", 2, "received both"),
    ("inspect --example --map nanobench", 2, "canonical channels"),
    ("inspect flight.csv --max-tilt 91", 2, "between 0 and 90"),
    ("inspect none.ulg", 1, "none.ulg"),
    ("inspect flight.csv --json none/x.json", 1, "does not exist"),
    ("plan --json .", 2, "the folder"),
    (f"plan --json {'x' * 300}", 1, "File name too long"),
    ("plan --json dangling", 1, "No such file"),
    (f"plan --json {Path(ev.__file__).parent / 'data' / 'example_flight.parquet'}", 2, "belongs to Eivor"),
    *((f"identify flight.csv --lag={text}", 2, "a lag MS:STD")
        for text in ("70", "70:", ":15", "x:15", "70:0", "-70:15", "nan:15", "70:15:3", "no", "90..70")),
    *((f"identify flight.csv --lag={text}", 2, "a lag MS:STD") for text in ("-5..10", "5..", "..5")),
    ("identify flight.csv --lag 0.065:0.015", 2, "--lag 65:15"),
    *((f"identify flight.csv --lag={text}", 2, "Give 70:15 or 50..90") for text in ("5..nan", "5...7..9")),
    ("identify flight.csv --lag=typical:6in", 2,
        r"nano, 5in, multirotor; received '6in'. Did you mean '5in'\?"),
    *((f"identify --example {option} ''", 2,
        f"Expected a value for {option}; received an empty text. .* or leave it out.$")
        for option in EMPTY),
    ("identfy", 2, "identify"),
    ("export fit.json", 2, "--to TARGET, --draws N or both"),
    ("export fit.json --to px4 --draws 5", 2, "draws out of rotorpy, mujoco, isaaclab"),
    ("export fit.json --draws 5 --vehicle crazyflie-2x -o d.parquet", 2, "no vehicle for draws of a table"),
    ("export fit.json --to px", 2, "a target out of px4"),
    ("export fit.json --draws 5", 2, "-o draws.parquet"),
    ("export fit.json --draws 0 -o d.parquet", 2, "0 draws"),
    ("export fit.json --to statespace --prior delay", 2, "a prior NAME=VALUE:STD"),
    ("export fit.json --to statespace --prior delay=x", 2, "VALUE or VALUE:STD"),
    ("export fit.json --to px4 --mass -1", 2, "a mass above zero"),
    ("plan --qgc a.plan", 2, "--home LAT,LON"),
    ("plan --qgc a.plan --home 1,2 --shape multisine", 2, "--shape steps with --qgc"),
    ("plan --height 3:", 2, "with both ends"),
    ("plan --height high", 2, "--height LOW:HIGH with both ends"),
    ("plan --csv ''", 2, "Expected a value for --csv; received an empty text. Give --csv FILE, or leave"),
    ("plan --hover 2", 2, "hover_input between"),
    ("plan fit.json --hover 0.5", 2, "rough numbers as options"),
    ("plan none.json", 1, "none.json"),
    ("vehicle show vehicle.toml", 1, "Did you mean 'mass'"),
    ("vehicle show hexacopter", 1, "crazyflie-2x"),
    ("vehicle new vehicle.toml", 2, "which would be lost"),
    ("vehicle new mine.txt", 2, "ends in .toml"),
    ("vehicle new none/mine.toml", 1, "does not exist"),
    ("vehicle new .", 2, "the folder"),
    ("example fetch nothing", 2, "ekf_failure"),
    ("simulate none.toml -o a.parquet", 1, "'none.toml', unreadable"),
    ("simulate rihc -o a.parquet", 2, "one of arch, closed-loop, crazyflie, flight, p"),
    ("simulate rich -o a.xlsx", 2, "ends in .parquet"),
    ("simulate rich -o nowhere/a.parquet", 1, "does not exist"),
    ("simulate rich -o a.parquet --seed -1", 2, "a seed of zero or more"),
    ("simulate rich -o a.parquet --truth a.parquet", 2, "different files for --out and --truth"),
    ("simulate hover.toml -o a.parquet --truth hover.toml", 2, "would replace 'hover.toml' of SCENARIO.toml"),
    ("simulate rich -o log.parquet --vehicle known.toml", 2, "'rich', whose rotors are nowhere"),
    ("study small.toml --runs 0", 2, "Expected runs from 1"),
    ("study small.toml --workers 0", 2, "Expected one worker or more; received 0"),
    ("study small.toml --workers 2 --dask tcp://x:1", 2, "Expected --workers or --dask; received both"),
    ("study small.toml --dask x", 2, "the address of a Dask scheduler"),
    ("study small.toml --json absent/x.json", 1, "whose folder 'absent' does not exist"),
    ("study small.toml --out small.toml", 2, "which would replace"),
    ("study small.toml --out small.toml/x", 1, "Not a directory"),
    ("paper --runs 3 --workers 1 --out empty.csv", 1, "a folder for the figures"),
    ("fleet run nowhere -o fleet", 1, "which does not exist"),
    ("fleet run logs -o fleet --workers 1 --dask tcp://a:1", 2, "--workers or --dask"),
    ("fleet run logs -o fleet --workers 0", 2, "one worker or more"),
    ("fleet run logs -o fleet --map *.csv=", 2, "PATTERN=MAP"),
    ("fleet run logs -o fleet --map *.csv=none.toml", 1, "none.toml"),
    ("fleet run logs -o fleet --vehicle-from {tail}", 2, "a pattern with"),
    ("fleet run logs -o fleet --model sideways", 2, "sideways"),
    ("fleet run logs -o fleet --log-time 0", 2, "a limit time_s above zero"),
    ("fleet run logs -o logs/a.csv", 2, "would replace"),
    ("fleet query logs", 1, "eivor fleet run"),
    ("fleet report logs", 1, ""),
    ("fleet compact logs", 1, ""),
    *((f"serve --no-browser --port {port}", 2, "a port of 0 to 65535") for port in (-1, 65536)),
    ("serve --no-browser --workers 0", 2, "at least one worker"),
    ("serve --no-browser --memory 0", 2, "a limit memory_gb above zero"),
    ("serve --no-browser --time nan", 2, "a limit time_s above zero"),
    ("serve --no-browser --largest 0", 2, "a size above zero"),
)  # fmt: skip
#: Words of a file of a flight.
FLIGHTS = (
    (FLOWN.replace("duration", "druation"), r"unknown key 'druation'. Did you mean 'duration'\?"),
    (FLOWN.replace('"multisine"', '"stepz"'), r"received 'stepz'. Did you mean 'steps'\?"),
    (FLOWN.replace('"heavy-tailed"', '"pink"'), "one of white, heavy-tailed, fractional at noise.kind"),
    (FLOWN.replace("0.4", "40.0"), "viscous_friction between 0.001 and 2 at the top of mine.toml"),
    (FLOWN.replace("20.0", f"20.0\n{LOST}"), "one that is lost with the seed"),
    (FLOWN.replace('"flight"', '"fligth"'), "at kind of mine.toml; received 'fligth'. Did you mean"),
)


test_refused = table(
    rows("window", UsageError, parse_window, *((text, "START before END")
        for text in ("", "4", "67:4", "4:4", "a:b", "4:nan", "nan:", "1:2:3", "4-67"))),
    rows("instruments", UsageError, parse_names, *((text, "alone")
        for text in (",", " ", "lags,references", "references,pilot_throttle"))),
    rows("noise", UsageError, declared_noise,
        (["velocity_z"], "NAME=STD"),
        (["velocity_z="], "NAME=STD"),
        (["velocity_z=-1"], "zero or more for velocity_z"),
        (["velocity_z=nan"], "zero or more for velocity_z"),
        (["velocity_z=lots"], "zero or more for velocity_z"),
        (["velocity_z=1 m"], "in m/s, or a unit of that kind"),
        (["velocity_z=1 parsec"], "in m/s, or a unit of that kind"),
        (["velocity_z=1", "velocity_z=2"], "twice"),
        (["velocity_z=densty:1"], "density"),
        (["velocity_z=bandwidth:50"], "sheet of velocity_z; received 'bandwidth:50'. Give --noise"),
        (["velocity_z=density:0,bandwidth:50"], "above zero of the data sheet of velocity_z"),
        (["estimate", "velocity_z=2"], "estimate alone"),
    ),
)  # fmt: skip


def contents(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search", "log")
@pytest.mark.parametrize(
    ("command", "code", "text", "files"),
    [
        *(pytest.param(*row, {}, id=row[0]) for row in COMMANDS),
        *(("simulate mine.toml -o a.parquet", 1, text, {"mine.toml": words}) for words, text in FLIGHTS),
    ],
)
def test_a_command_is_refused(eivor, flight, tmp_path, monkeypatch, command, code, text, files):
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    Path("dangling").symlink_to("no/x.json")
    for name, content in (FILES | files).items():
        Path(name).write_bytes(content.encode() if isinstance(content, str) else content)
    flight.drop("position_z").rename({"velocity_z": "velocty_z"}).write_csv("blind.csv")
    before = contents(written(document(), tmp_path).parent)
    run = eivor(*shlex.split(command))
    assert (run.code, run.out) == (code, "")
    assert re.search(text, " ".join(run.err.split()))
    assert "Traceback" not in run.err
    assert contents(tmp_path) == before
