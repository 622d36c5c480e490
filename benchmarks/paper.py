"""`eivor paper` with everything, and its fits, against solving the paper's (N + n)-square systems densely.

* the whole command: every reading, both examples, 100 runs, six methods, figures (target: 20 s on two cores);
* six fits of one record with moments shared, for each fit (target: 1 ms);
* one dense solve of (10) and of (16) at N = 4000, times as many as the command would need. Only the direct
  forms are N + n square; the instrumental ones are small either way and are not counted.
"""

from __future__ import annotations

import tempfile

import numpy as np
import scipy.linalg
from _shared import EIVOR, arguments, least_seconds, machine, process_seconds
from threadpoolctl import threadpool_limits

from eivor.lab.experiments import stream
from eivor.lab.paper import EXAMPLES, METHODS, READINGS, SEED, estimates, record
from eivor.motions.vertical.model import VerticalMotion

#: Direct fits of each record: least squares and total least squares.
DIRECT = 2


def dense_solve(Phi: np.ndarray, y: np.ndarray, *, total: bool) -> np.ndarray:
    """Theta of (10) or (16), the system in full; the singular values it needs are taken as given."""
    rows, unknowns = Phi.shape
    singular = np.linalg.svd(np.column_stack([Phi, y]) if total else Phi, compute_uv=False)
    scale = singular[-1] / (1.0 if total else np.sqrt(2.0))
    matrix = np.zeros((rows + unknowns, rows + unknowns))
    matrix[:rows, :rows] = scale * np.eye(rows)
    matrix[:rows, rows:] = Phi
    matrix[rows:, :rows] = Phi.T
    if total:
        matrix[rows:, rows:] = scale * np.eye(unknowns)
    right = np.concatenate([y, np.zeros(unknowns)])
    return scipy.linalg.solve(matrix, right, assume_a="sym", overwrite_a=True, check_finite=False)[rows:]


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    reading, runs = READINGS[1], 2 if small else 100
    signals = [record(reading, EXAMPLES[0], stream(SEED, index)).signals for index in range(20)]

    def fits() -> None:
        for signal in signals:
            estimates(reading, signal)

    with threadpool_limits(limits=1):
        fits()
        fit = least_seconds(fits, 1 if small else 5) / len(signals) / len(METHODS)
    print(f"fit, moments shared, N = {signals[0].sample_count}   {1e3 * fit:8.3f} ms (target 1)")

    rows = VerticalMotion(intercept=False).regression(signals[0]).rows()
    count = 400 if small else rows.response.size
    Phi, y = rows.regressors[:count], rows.response[:count]
    dense = {
        name: least_seconds(lambda total=total: dense_solve(Phi, y, total=total), 1 if small else 2)
        for name, total in (("(10)", False), ("(16)", True))
    }
    for name, seconds in dense.items():
        print(f"dense {name}, N = {count}   {seconds:8.3f} s")

    with tempfile.TemporaryDirectory() as folder:
        command = (*EIVOR, "paper", "--runs", str(runs), "--out", folder)
        seconds = process_seconds((*command, "--readings", READINGS[0].name) if small else command)
    trials = (1 if small else len(READINGS)) * len(EXAMPLES) * runs
    wanted = trials * sum(dense.values())
    print(f"eivor paper, {trials} trials of {len(METHODS)} fits   {seconds:6.1f} s (target 20)")
    print(
        f"the same {DIRECT * trials} direct fits, densely   {wanted:8.0f} s by scaling: "
        f"{wanted / seconds:.0f} x the whole command"
    )


if __name__ == "__main__":
    main()
