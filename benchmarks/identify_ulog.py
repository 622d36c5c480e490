"""`eivor identify` on a ULog against pyulog reading all of it, both as whole processes.

Target: at most six times pyulog's time.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from _shared import EIVOR, alternating, arguments, machine, real_ulogs, synthetic_ulog

READ = "import sys; from pyulog import ULog; ULog(sys.argv[1])"
#: Times that of pyulog.
TARGET = 6.0


def measure(log: Path, repeats: int) -> str:
    """Row of the table."""
    seconds = alternating(
        {
            "pyulog": (sys.executable, "-c", READ, str(log)),
            "eivor": (*EIVOR, "identify", str(log)),
        },
        repeats,
        allowed=(0, 3),
    )
    ratio = seconds["eivor"] / seconds["pyulog"]
    return (
        f"{log.name:<24}{log.stat().st_size / 1e6:6.2f} MB   pyulog {seconds['pyulog']:5.2f} s   "
        f"eivor identify {seconds['eivor']:5.2f} s   ratio {ratio:5.2f}   of target {ratio / TARGET:5.2f}"
    )


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    with tempfile.TemporaryDirectory() as folder:
        size = 300_000 if small else 2_400_000
        synthetic = synthetic_ulog(Path(folder) / "synthetic.ulg", flight_s=60.0, filler_bytes=size)
        for log in [synthetic] if small else [*real_ulogs(), synthetic]:
            print(measure(log, 1 if small else 5))


if __name__ == "__main__":
    main()
