"""Thrust and inertias of a Crazyflie by the recipe of those who published them, and what each step does.

    python -m validation.crazyflie.study ../shared/data/arpl-crazyflie

prints the tables of `docs/crazyflie.md`. Some seconds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from validation.crazyflie.recipe import PUBLISHED, PUBLISHED_LAG_S, Logs, Numbers, Steps, best_lag, numbers

#: Exit code for an input that cannot be used.
WRONG = 2
HEAD = (
    "| | $c_0$, $c_1$, $c_2$ [N] | residual [m/s²] | $I_{xx}$ | $I_{yy}$ | $I_{zz}$ [1e-5 kg m²] |",
    "|---|---|---|---|---|---|",
)


def variants(logs: Logs) -> dict[str, Steps]:
    """Steps by what is told of them, the published ones first."""
    result = best_lag(logs.thrust)
    return {
        f"found again, lag {1e3 * PUBLISHED_LAG_S:.1f} ms as published": Steps(),
        f"lag {1e3 * result:.1f} ms, at which the residual is smallest": Steps(lag_s=result),
        "g along z is 9.81 in place of 9.18 m/s²": Steps(gravity=9.81),
        "full power is 65535 in place of 65536": Steps(full_power=65535.0),
        "even stamps in place of the logged ones": Steps(corrected_stamps=True),
        "thrust of the roll and pitch log itself": Steps(own_thrust=True),
        "rates' differences on torque in place of torque on them": Steps(torque_has_the_noise=True),
    }


def line(words: str, result: Numbers) -> str:
    """A row of the table."""
    curve = ", ".join(f"{item:.4f}" for item in result.thrust)
    residual = "" if result.residual != result.residual else f"{result.residual:.4f}"
    inertias = " | ".join(f"{1e5 * item:.3f}" for item in result.inertia)
    return f"| {words} | {curve} | {residual} | {inertias} |"


def table(folder: Path) -> list[str]:
    """Rows of the table: what was published, what was found again, and what each step does."""
    logs = Logs.of_folder(folder)
    rows = [line(words, numbers(logs, steps)) for words, steps in variants(logs).items()]
    return [*HEAD, line("published", PUBLISHED), *rows]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m validation.crazyflie.study", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with log10 and log15")
    folder = parser.parse_args(arguments).folder
    try:
        print("\n".join(table(folder)))
    except OSError as error:
        print(f"Expected a folder with log10 and log15, received '{folder}': {error}", file=sys.stderr)
        return WRONG
    return 0


if __name__ == "__main__":
    sys.exit(main())
