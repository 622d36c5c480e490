"""Record what a checkout of Eivor answers for flights, array problems and studies.

    python -m validation.parity.record NEW.json.xz [--checkout FOLDER] [--part NAME]

Everything goes through public doors: the names of `eivor`, and the command line `python -m eivor`. The same
code gives the same file, byte by byte. README.md says what is in it, and how two records are compared.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import lzma
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SCHEMA = "eivor.parity/2"
ROOT = Path(__file__).resolve().parents[2]
#: Significant digits that the file keeps; the hashes are those of all digits.
DIGITS = 11
#: Keys whose values are sentences or printed text: they may be reworded.
SENTENCES = frozenset(
    {"reasons", "message", "sentence", "summary", "equation", "words", "left_out", "printed", "page", "text"}
)
#: Keys that change from one version or day to the next.
OF_THE_DAY = frozenset({"version", "seconds"})
#: Matrices are small: one thread, so that sums are always taken in one order.
ENVIRONMENT = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "RAYON")
} | {
    "POLARS_MAX_THREADS": "1",
    "PYTHONHASHSEED": "0",
    "PYTHONUTF8": "1",
    "LC_ALL": "C.UTF-8",
    "TZ": "UTC",
    "COLUMNS": "200",
    "NO_COLOR": "1",
    "TERM": "dumb",
}
#: Runs of each Monte Carlo study, and of each reading of the paper.
RUNS = 20
STUDIES = ("white-input", "dynamic-errors-in-variables", "altitude-control")
READINGS = "ratios-of-variances,row-of-h-as-printed,count-left-out,central-2-lags"
#: Flights of NanoBench without faults, which are also pooled.
CLEAN = (
    *("B2_circle_fast_rep1", "B3_figure8_medium_rep1", "B5_helix_fast_rep1"),
    *("B9_trefoil_fast_rep14", "B9_trefoil_slow_rep13"),
)
#: Recordings whose rotors the rigid body takes, and their vehicle.
RIGID_BODY = {
    "nanobench/B2_circle_fast_rep1.csv": "crazyflie-2x",
    "nanobench/B9_trefoil_fast_rep14.csv": "crazyflie-2x",
    "nanobench-repeats/B8_star_fast_rep1.csv": "crazyflie-2x",
    "arpl-crazyflie/log15": "crazyflie-2x",
    "arpl-crazyflie/log16": "crazyflie-2x",
    "px4/ekf_failure.ulg": "quadrotor-x",
    "px4/sample_px4_events.ulg": "quadrotor-x",
    "px4-flights/esc_status_log.ulg": "quadrotor-x",
    "px4/battery_brownout.ulg": "quadrotor-x",  # logs no rotors
}
VERTICAL_SEEDS, WHOLE_VEHICLE_SEEDS = range(1, 5), range(1, 3)


@dataclass
class Folder:
    """A folder in which commands run, with the recordings at `data` and the studies at `studies`."""

    path: Path
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ | ENVIRONMENT)

    def eivor(self, *arguments: object, files: Mapping[str, str] | None = None) -> dict[str, Any]:
        """Run a command; its exit code, its document, and hashes of what it printed and wrote."""
        document = self.path / "document.json"
        document.unlink(missing_ok=True)
        done = subprocess.run(
            [sys.executable, "-m", "eivor", *map(str, arguments)],
            capture_output=True,
            check=False,
            cwd=self.path,
            env=self.environment,
        )
        results: dict[str, Any] = {"exit_code": done.returncode, "printed": digest(done.stdout + done.stderr)}
        if done.returncode not in {0, 3}:
            results["message"] = done.stderr.decode()
        if document.exists():
            results["document"] = timeless(json.loads(document.read_text(encoding="utf-8")))
        for key, name in (files or {}).items():
            path = self.path / name
            results[key] = digest(path.read_bytes()) if path.exists() else None
        return results

    def identify(self, *arguments: object, files: Mapping[str, str] | None = None) -> dict[str, Any]:
        return self.eivor("identify", *arguments, "--json", "document.json", files=files)

    def recordings(self, pattern: str = "*") -> list[str]:
        return sorted(
            str(path.relative_to(self.path))
            for path in (self.path / "data").glob(f"*/{pattern}")
            if path.suffix in {".csv", ".ulg", ".bin", ""} and path.name != "LICENSE"
        )


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def timeless(document: Any) -> Any:
    """A document without what changes from one version or day to the next."""
    if isinstance(document, dict):
        return {key: timeless(value) for key, value in document.items() if key not in OF_THE_DAY}
    return [timeless(value) for value in document] if isinstance(document, list) else document


def flights(folder: Folder) -> Iterator[tuple[str, Any]]:
    """The example in several ways, every recording, and pools: the vertical motion."""
    page = ("--html", "page.html")
    yield "example", folder.identify("--example", *page, files={"page": "page.html"})
    for name, arguments in {
        "example-compare": ("--compare",),
        "example-lags": ("--instruments", "lags"),
        "example-linear-map": ("--input-map", "linear"),
        "example-map-fit": ("--input-map", "fit"),
        "example-window": ("--window", "10:50", "--max-tilt", "15"),
        "example-lag": ("--lag", "70:15"),
        "example-drag": ("--term", "quadratic-drag"),
        "example-noise": ("--noise", "estimate", "--method", "generalized_iv"),
    }.items():
        yield name, folder.identify("--example", *arguments)
    for path in folder.recordings():
        yield path.removeprefix("data/"), folder.identify(path, "--model", "vertical")
    window = "data/px4/ekf_failure.ulg@4:67"
    yield "ekf_failure-4-67", folder.identify(window, "--compare")
    yield "nanobench-pool", folder.identify(*(f"data/nanobench/{name}.csv" for name in CLEAN))
    repeats = folder.recordings("B9_trefoil_slow_rep[1-6].csv")
    yield "repeats-pool", folder.identify(*repeats, "--pool-friction", "separate")


def rates(folder: Folder) -> Iterator[tuple[str, Any]]:
    """Turning, of every recording that logs setpoints of it; of NanoBench, which does not, one."""
    logs = [*folder.recordings("*.ulg"), *folder.recordings("*.bin")]
    for path in [*logs, f"data/nanobench/{CLEAN[0]}.csv"]:
        yield path.removeprefix("data/"), folder.identify(path, "--model", "rates")


def rigid_body(folder: Folder) -> Iterator[tuple[str, Any]]:
    for path, vehicle in RIGID_BODY.items():
        yield path, folder.identify(f"data/{path}", "--model", "rigid-body", "--vehicle", vehicle)


def simulated(folder: Folder) -> Iterator[tuple[str, Any]]:
    """Studies of simulated flights: vertical ones, and of whole vehicles as rates and as rigid bodies."""
    for seed in VERTICAL_SEEDS:
        folder.eivor("simulate", "flight", "--seed", seed, "--out", "log.parquet")
        yield f"vertical-{seed}", folder.identify("log.parquet")
    for vehicle in ("crazyflie", "quadrotor"):
        for seed in WHOLE_VEHICLE_SEEDS:
            written = ("--out", "log.parquet", "--truth", "document.json", "--vehicle", "vehicle.toml")
            yield (
                f"{vehicle}-{seed}",
                folder.eivor("simulate", vehicle, "--seed", seed, *written, files={"text": "vehicle.toml"}),
            )
            page = {"page": "page.html"} if seed == 1 else {}
            drawn = ("--html", "page.html") if page else ()
            yield (
                f"{vehicle}-rates-{seed}",
                folder.identify("log.parquet", "--model", "rates", *drawn, files=page),
            )
            known = ("--model", "rigid-body", "--vehicle", "vehicle.toml")
            yield f"{vehicle}-rigid-body-{seed}", folder.identify("log.parquet", *known, *drawn, files=page)


def commands(folder: Folder) -> Iterator[tuple[str, Any]]:
    to_document = ("--json", "document.json")
    few = ("px4/ekf_failure.ulg", "ardupilot/log_0036_mechanical_failure.bin", "arpl-crazyflie/log10")
    logs = [f"data/{path}" for path in (*few, f"nanobench/{CLEAN[0]}.csv")]
    yield "inspect", folder.eivor("inspect", *logs, *to_document)
    yield "track", folder.eivor("track", "--example", *to_document)
    yield "track-ekf_failure", folder.eivor("track", "data/px4/ekf_failure.ulg", *to_document)
    for seed in (1, 2):
        folder.eivor("simulate", "flight", "--seed", seed, "--out", f"flight-{seed}.parquet")
    folder.eivor("identify", "flight-1.parquet", "--json", "fit.json")
    yield "validate", folder.eivor("validate", "fit.json", "flight-2.parquet", *to_document)
    yield "plan", folder.eivor("plan", "fit.json", "--seed", 1, *to_document)
    for target in ("px4", "ardupilot", "statespace"):
        yield f"export-{target}", folder.eivor("export", "fit.json", "--to", target)
    folder.eivor("simulate", "crazyflie", "--out", "log.parquet", "--vehicle", "vehicle.toml")
    known = ("--model", "rigid-body", "--vehicle", "vehicle.toml")
    folder.eivor("identify", "log.parquet", *known, "--json", "fit.json")
    for target in ("sih", "rotorpy", "mujoco", "pybullet", "gazebo", "drone-models"):
        of = ("--mass", "0.03:0.001", "--vehicle", "crazyflie-2x")
        yield f"export-{target}", folder.eivor("export", "fit.json", "--to", target, *of)
    yield "fleet-run", folder.eivor("fleet", "run", "data/px4", "--out", "fleet", "--workers", 1)
    yield "fleet-report", folder.eivor("fleet", "report", "fleet", *to_document)
    for name in ("vehicle", "example", "fleet"):
        yield f"help-{name}", folder.eivor(name, "--help")


def studies(folder: Folder) -> Iterator[tuple[str, Any]]:
    """Monte Carlo studies of arrays, and the paper's tables under some readings."""
    few = ("--runs", RUNS, "--workers", 1, "--json", "document.json")
    for name in STUDIES:
        yield name, folder.eivor("study", f"studies/{name}.toml", "--out", f"study-{name}", *few)
    yield "paper", folder.eivor("paper", "--readings", READINGS, *few)


def arrays(folder: Folder) -> dict[str, Callable[[], Iterator[tuple[str, Any]]]]:
    from validation.parity import arrays as of_arrays

    cases = of_arrays.array_problems(folder)
    pool = [folder.path / f"data/nanobench/{name}.csv" for name in CLEAN]
    return {
        "problems": lambda: ((name, of_arrays.problem_record(case)) for name, case in cases.items()),
        "inference": lambda: of_arrays.inference(cases),
        "python": lambda: of_arrays.from_python(pool),
    }


COMMANDS: Mapping[str, Callable[[Folder], Iterator[tuple[str, Any]]]] = {
    part.__name__: part for part in (flights, rates, rigid_body, simulated, commands, studies)
}
PARTS = (*COMMANDS, "problems", "inference", "python")


def entry(content: Any) -> dict[str, Any]:
    """Content with its hashes: of all, and of all but its sentences."""
    return {
        "sha256": digest(_compact(content).encode()),
        "sha256_without_sentences": digest(_compact(_without_sentences(content)).encode()),
        "content": rounded(content),
    }


def _without_sentences(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _without_sentences(value) for key, value in content.items() if key not in SENTENCES}
    return [_without_sentences(value) for value in content] if isinstance(content, list) else content


def rounded(content: Any) -> Any:
    """Content with its numbers at the digits that the file keeps."""
    if isinstance(content, dict):
        return {key: rounded(value) for key, value in content.items()}
    if isinstance(content, list):
        return [rounded(value) for value in content]
    return float(f"{content:.{DIGITS}g}") if isinstance(content, float) else content


def make_record(parts: Sequence[str], data: Path) -> dict[str, Any]:
    """The record of the Eivor that this process imports: an entry for each case, as PART/NAME."""
    with tempfile.TemporaryDirectory() as name:
        folder = Folder(Path(name))
        (folder.path / "data").symlink_to(data.resolve())
        (folder.path / "studies").symlink_to(ROOT / "examples" / "studies")
        (folder.path / "scenarios").symlink_to(Path(__file__).with_name("scenarios"))
        from_arrays = arrays(folder) if set(parts) - set(COMMANDS) else {}
        entries = {}
        for part in parts:
            start_s = time.perf_counter()
            made = COMMANDS[part](folder) if part in COMMANDS else from_arrays[part]()
            entries |= {f"{part}/{case}": entry(content) for case, content in made}
            sys.stderr.write(f"{part}: {time.perf_counter() - start_s:.1f} s\n")
    return {"schema": SCHEMA, "entries": entries}


def write_record(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record with a line for each entry, compressed where the name ends in .xz."""
    entries = [f"{json.dumps(name)}:{_compact(value)}" for name, value in record["entries"].items()]
    schema = json.dumps(record["schema"])
    text = f'{{"schema":{schema},"entries":{{\n' + ",\n".join(entries) + "\n}}\n"
    content = text.encode()
    path.write_bytes(
        lzma.compress(content, preset=9 | lzma.PRESET_EXTREME) if path.suffix == ".xz" else content
    )


def read_record(path: Path) -> dict[str, Any]:
    content = path.read_bytes()
    record = json.loads(lzma.decompress(content) if path.suffix == ".xz" else content)
    if record.get("schema") != SCHEMA:
        raise SystemExit(f"Expected a record of schema {SCHEMA} in {path}; received {record.get('schema')}.")
    return record


def _compact(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False, sort_keys=True)


def recordings_folder() -> Path:
    """Folder of the real recordings: EIVOR_DATA, or ../shared/data beside the project."""
    folder = Path(os.environ.get("EIVOR_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        raise SystemExit(f"Expected real recordings in {folder}; received none. Set EIVOR_DATA.")
    return folder


def record_of_checkout(checkout: Path, file: Path, parts: Sequence[str] = ()) -> None:
    """Make the record of a checkout, in a new process that imports its `src`."""
    command = [sys.executable, "-m", "validation.parity.record", str(file.resolve()), "--here"]
    for part in parts:
        command += ["--part", part]
    paths = os.pathsep.join([str(checkout.resolve() / "src"), str(ROOT)])
    environment = os.environ | ENVIRONMENT | {"PYTHONPATH": paths, "EIVOR_DATA": str(recordings_folder())}
    subprocess.run(command, check=True, cwd=ROOT, env=environment)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m validation.parity.record",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", type=Path, metavar="NEW.json.xz")
    parser.add_argument("--checkout", type=Path, default=ROOT, metavar="FOLDER", help="default: this one")
    parser.add_argument("--part", action="append", choices=PARTS, help="only this part; may be repeated")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)  # in the new process
    chosen = parser.parse_args(arguments)
    parts = chosen.part or PARTS
    if chosen.here:
        write_record(chosen.file, make_record(parts, recordings_folder()))
    else:
        record_of_checkout(chosen.checkout, chosen.file, parts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
