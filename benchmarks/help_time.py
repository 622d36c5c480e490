"""`eivor --help`, as a whole process, against a process that does nothing and one that imports Typer.

Target: half a second.
"""

from __future__ import annotations

import sys

from _shared import EIVOR, alternating, arguments, machine


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    seconds = alternating(
        {
            "nothing": (sys.executable, "-c", "pass"),
            "import typer": (sys.executable, "-c", "import typer"),
            "eivor --help": (*EIVOR, "--help"),
            "eivor identify --help": (*EIVOR, "identify", "--help"),
        },
        1 if small else 10,
    )
    for name, taken in seconds.items():
        print(
            f"{name:<24}{taken:5.2f} s   ratio to import typer {taken / seconds['import typer']:5.2f}   "
            f"of target {taken / 0.5:5.2f}"
        )


if __name__ == "__main__":
    main()
