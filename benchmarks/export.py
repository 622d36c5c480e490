"""`eivor export`, as a whole process, against a process that imports what it counts with.

Target: a second, whatever is written.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from _shared import EIVOR, alternating, arguments, machine

import eivor as ev

VEHICLE = """
[rotors]
layout = "quad-x"
numbering = "crazyflie"
arm = 0.043
torque_ratio = 0.034
"""
#: What no vertical flight tells.
GIVEN = {"inertia_xx": 1.4e-5, "inertia_yy": 1.4e-5, "inertia_zz": 2.6e-5, "largest_command": 2500.0}


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
        (folder / "fit.json").write_text(ev.identify_flight(ev.example_flight()).to_json(), encoding="utf-8")
        command = (*EIVOR, "export", str(folder / "fit.json"), "--mass", "0.03:0.0004")
        body = ("--vehicle", str(folder / "vehicle.toml"))
        given = tuple(word for name, value in GIVEN.items() for word in ("--prior", f"{name}={value}"))
        out = ("-o", str(folder / "out"))
        seconds = alternating(
            {
                "import scipy.linalg": (sys.executable, "-c", "import scipy.linalg"),
                "--to gazebo": (*command, "--to", "gazebo", *body, *given, *out),
                "--draws 1000": (*command, "--draws", "1000", *out),
                "--to rotorpy --draws 1000": (
                    *(*command, "--to", "rotorpy", "--draws", "1000"),
                    *(*body, *given, *out),
                ),
            },
            1 if small else 10,
        )
    for name, taken in seconds.items():
        print(
            f"{name:<28}{taken:5.2f} s   ratio to import {taken / seconds['import scipy.linalg']:5.2f}   "
            f"of target {taken / 1.0:5.2f}"
        )


if __name__ == "__main__":
    main()
