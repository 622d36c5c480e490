"""`eivor identify --model vertical` on a ULog against pyulog reading all of it, as whole processes.

Target: at most three times pyulog's time. The imports of the libraries that `identify` calls are timed as
well: no command of one process can be quicker.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from _shared import EIVOR, alternating, arguments, machine, real_ulogs, synthetic_ulog

READ = "import sys; from pyulog import ULog; ULog(sys.argv[1])"
IMPORTS = "import numpy, scipy.linalg, scipy.optimize, scipy.interpolate, msgspec, typer, rich.console"
#: Times that of pyulog.
TARGET = 3.0


def measure(log: Path, repeats: int) -> str:
    """Row of the table."""
    seconds = alternating(
        {
            "pyulog": (sys.executable, "-c", READ, str(log)),
            "imports": (sys.executable, "-c", IMPORTS),
            "eivor": (*EIVOR, "identify", str(log), "--model", "vertical"),
        },
        repeats,
        allowed=(0, 3),
    )
    ratio = seconds["eivor"] / seconds["pyulog"]
    return (
        f"{log.name:<24}{log.stat().st_size / 1e6:6.2f} MB   pyulog {seconds['pyulog']:5.2f} s   "
        f"eivor identify {seconds['eivor']:5.2f} s   ratio {ratio:5.2f}   of target {ratio / TARGET:5.2f}   "
        f"imports alone {seconds['imports']:5.2f} s, {seconds['imports'] / seconds['pyulog']:5.2f} times"
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
