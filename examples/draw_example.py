"""Draw the figure of the example flight that the README and the documentation show.

    python examples/draw_example.py [FOLDER]

A test compares the picture with what the code draws: run this again when it says that they differ.
"""

from __future__ import annotations

import sys
from pathlib import Path

import eivor as ev
from eivor.logs.read import example_flight
from eivor.report.figures import save_figure
from eivor.report.flight_figures import flight_figure

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "images"


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "example.png"
    save_figure(flight_figure(ev.identify_flight(example_flight())), path)
    print(path)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURES)
