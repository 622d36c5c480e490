"""Damaged inputs of every format: what is read, refused or raised, time, memory and silent loss.

`python -m validation.fuzzing --inputs 20000 [FORMAT ...]` prints a line for each format. Inputs are
damaged by bytes and by structure (records, lines, cells, keys), in one process with limits. What is raised
or killed is kept in the folder of `--keep`. Sound inputs are those of `tests/logs/damage.py`.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev
from eivor.errors import EivorError
from eivor.exports.simulators import TARGETS
from eivor.logs.channel_map import load_channel_map
from eivor.motions.declaration import load_machine
from eivor.motions.rigid_body.vehicle import load_vehicle
from eivor.planning.vehicle import vehicle_of_result
from eivor.process_pool import LimitError, Limits, WorkerProcess
from eivor.report.saved_fit import load_fits

#: More time of the processor than this is a hang [s], and what a process may take [GB].
HANG_S, LIMITS = 10.0, Limits(60.0, 4.0)
#: Formats that say how many messages there are, or that messages belong together.
COUNTED = ("bag", "db3", "mcap", "zstd.mcap", "ulg")
#: Formats whose decoders have a process of their own, but not within a process that works for another.
DECODED = ("mat", "h5", "parquet")


def used(path: Path) -> dict[str, int]:
    """Read an input as its user does; of a log, the number of values of each channel."""
    if path.name == "f.fit.json":
        for fit in load_fits(path).values():
            steps: list[Callable[[], object]] = [partial(fit.sample, 5), fit._repr_html_, fit.to_statespace]
            steps += [partial(fit.interval, name) for name in fit.quantities]
            steps += [partial(fit.export, target, accept="provisional") for target in TARGETS]
            told, prediction = fit.document.model, fit.document.prediction
            record = prediction and prediction.flight_record
            steps += [partial(vehicle_of_result, told.name, told.input_map, fit.quantities, record)]
            for step in steps:
                try:
                    step()
                except EivorError:
                    continue
        return {}
    if path.suffix == ".toml":
        {"vehicle": load_vehicle, "machine": load_machine, "map": load_channel_map}[path.name[2:-5]](path)
        return {}
    recording = ev.read_log(path)
    sizes = {name: channel.values.size for name, channel in recording.channels.items()}
    return sizes | {f"finding {item.name}": 0 for item in recording.findings}


def outcome(item: tuple[str, bytes]) -> tuple[str, float, float, dict[str, int]]:
    """What an input does: a word and where it was raised, time [s], memory [MB], what was read."""
    name, blob = item
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"f.{name}"
        path.write_bytes(blob)
        before, began, read = _largest_mb(), time.process_time(), dict[str, int]()
        try:
            read, word = used(path), "read"
        except EivorError as error:
            word = "refused" if len(str(error)) < 20_000 else "endless sentence"
        except BaseException as error:  # noqa: BLE001 - what is raised is what is counted
            calls = traceback.extract_tb(error.__traceback__)
            place = ([row for row in calls if "/eivor/" in row.filename] or calls)[-1]
            word = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {str(error)[:100]}"
        return word, time.process_time() - began, _largest_mb() - before, read


def _largest_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000.0


def damage() -> Any:
    """Sound inputs of each format, and ways to damage them."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "logs"))
    return import_module("damage")


def fuzzed(name: str, inputs: int, keep: Path | None = None) -> dict[str, Any]:
    """Counts of a format."""
    blob, rng = damage().seeds()[name], np.random.default_rng([0, zlib.crc32(name.encode())])
    # by the name of this module, which is another when it is run as a command
    process = WorkerProcess(import_module("validation.fuzzing").outcome, LIMITS)
    whole = process((name, blob))[3]
    of, counts, longest, largest, silent = damage(), Counter[str](), 0.0, 0.0, 0
    for number in range(inputs):
        damaged = of.damaged(blob, rng) if number % 2 else of.by_structure(name, blob, rng)
        try:
            word, seconds, megabytes, read = process((name, damaged))
        except LimitError as error:
            dies = name in DECODED and "signal" in str(error)  # which users read as a refusal
            word, seconds, megabytes, read = "refused" if dies else f"died: {error}"[:200], 0.0, 0.0, {}
        word = "hang" if seconds > HANG_S else word
        lost = any(read.get(key, 0) < 0.99 * size for key, size in whole.items())
        noticed = word != "read" or not read.keys() <= whole.keys()
        silent += name in COUNTED and number % 2 == 1 and lost and not noticed
        counts[word] += 1
        longest, largest = max(longest, seconds), max(largest, megabytes)
        if keep is not None and word not in ("read", "refused"):
            (keep / f"{zlib.crc32(damaged):08x}.{name}").write_bytes(damaged)
    process.close()
    usual = {word: counts.pop(word, 0) for word in ("read", "refused", "hang")}
    sizes = {"longest_s": round(longest, 2), "largest_MB": round(largest), "silent": silent}
    return {"format": name, "inputs": inputs, **usual, **sizes, "raised": dict(counts)}


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help="the ending of a name; default: all")
    parser.add_argument("--inputs", type=int, default=20_000, help="of each format")
    parser.add_argument("--keep", type=Path, help="folder for what is raised")
    given = parser.parse_args()
    for name in given.formats or damage().seeds():
        print(json.dumps(fuzzed(name, given.inputs, given.keep)), flush=True)


if __name__ == "__main__":
    main()
