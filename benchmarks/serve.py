"""`eivor serve`: until it says where it is, what it holds idle, and a drop beside the command line.

Targets: it says where it is within 1 s and holds less than 150 MB, processes that wait included; a verdict
takes no more than 1.5 times what `eivor identify --json` takes.
"""

from __future__ import annotations

import http.client
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from _shared import EIVOR, arguments, example_flight, machine, process_seconds, real_ulogs

TARGET_START_S, TARGET_IDLE_MB, TARGET_RATIO = 1.0, 150.0, 1.5


@dataclass(frozen=True)
class Served:
    """A server that runs."""

    process: int
    port: int
    token: str
    start_s: float
    processor_s: float

    def ask(self, method: str, path: str, body: bytes | None = None, name: str = "") -> bytes:
        """Content of an answer."""
        headers = {"X-Eivor-Token": self.token, "X-Eivor-Name": name}
        with closing(http.client.HTTPConnection("127.0.0.1", self.port)) as line:
            line.request(method, path, body, headers)
            return line.getresponse().read()

    def verdict_seconds(self, log: Path) -> float:
        """From a drop to the verdict's document [s]."""
        start_s = time.perf_counter()
        kept = json.loads(self.ask("POST", "/logs", log.read_bytes(), log.name))["log"]
        job = json.loads(self.ask("POST", "/jobs", json.dumps({"logs": [kept]}).encode()))["job"]
        last = json.loads(self.ask("GET", f"/jobs/{job}/events").splitlines()[-1])
        if "done" not in last:
            raise RuntimeError(str(last))
        self.ask("GET", f"/jobs/{job}/result.json")
        seconds = time.perf_counter() - start_s
        self.ask("GET", f"/jobs/{job}/report.html")
        return seconds

    def held_mb(self) -> tuple[float, float]:
        """Memory of the server, and of the processes below it [MB]."""
        below = [
            int(stat.parent.name)
            for stat in Path("/proc").glob("[0-9]*/stat")
            if int(stat.read_text("utf-8", "replace").rpartition(")")[2].split()[1]) == self.process
        ]
        return _held_mb(self.process), sum(map(_held_mb, below))


def _processor_s(process: int) -> float:
    """Time that a process has had of a processor [s]."""
    ticks = Path(f"/proc/{process}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def _held_mb(process: int) -> float:
    pages = int(Path(f"/proc/{process}/statm").read_text("ascii").split()[1])
    return pages * 4096 / 1e6


@contextmanager
def served() -> Iterator[Served]:
    """A server, while the block lasts."""
    started = time.perf_counter()
    command = (*EIVOR, "serve", "--no-browser", "--workers", "1")
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = urlsplit(process.stdout.readline().strip())
            start_s = time.perf_counter() - started
            assert url.port is not None
            yield Served(
                process.pid, url.port, parse_qs(url.query)["token"][0], start_s, _processor_s(process.pid)
            )
        finally:
            process.terminate()


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    repeats = 1 if small else 5
    with tempfile.TemporaryDirectory() as folder, served() as page:
        print(
            f"start {page.start_s:.2f} s, {page.processor_s:.2f} s of a processor; "
            f"of target {page.start_s / TARGET_START_S:.2f}, {page.processor_s / TARGET_START_S:.2f}"
        )
        page.ask("GET", "/choices")
        current, waiting = page.held_mb()
        print(
            f"idle {current:.0f} MB and {waiting:.0f} MB of the process that waits; "
            f"of target {(current + waiting) / TARGET_IDLE_MB:.2f}"
        )
        for log in [example_flight()] if small else [example_flight(), *real_ulogs()]:
            typed = (*EIVOR, "identify", str(log), "--json", str(Path(folder) / "fit.json"))
            own_s, typed_s = float("inf"), float("inf")
            for _ in range(repeats):
                typed_s = min(typed_s, process_seconds(typed, allowed=(0, 3)))
                own_s = min(own_s, page.verdict_seconds(log))
            ratio = own_s / typed_s
            print(
                f"{log.name}: drop to verdict {own_s:.2f} s, command line {typed_s:.2f} s, "
                f"ratio {ratio:.2f}; of target {ratio / TARGET_RATIO:.2f}"
            )


if __name__ == "__main__":
    main()
