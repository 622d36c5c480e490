"""Total least squares through the reduced augmented system, against the full (N + n)-square one.

Target: 1000 times faster at N = 4000, n = 2. The peer is the system as the paper prints it, solved densely
(`scipy.linalg.solve`, symmetric).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from _shared import arguments, least_seconds, machine

from eivor.linalg.system import LinearSystem
from eivor.linalg.total_least_squares import AugmentedTotalLeastSquares


def full_system(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Theta of the paper's (16)."""
    rows, unknowns = A.shape
    s = np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1]
    matrix = s * np.eye(rows + unknowns)
    matrix[:rows, rows:] = A
    matrix[rows:, :rows] = A.T
    right = np.concatenate([b, np.zeros(unknowns)])
    return scipy.linalg.solve(matrix, right, assume_a="sym")[rows:]


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    rng = np.random.default_rng(0)
    rows = 500 if small else 4000
    A = rng.standard_normal((rows, 2))
    b = A @ [0.293, 0.021] + 0.1 * rng.standard_normal(rows)
    system, solver = LinearSystem(A, b), AugmentedTotalLeastSquares()
    difference = np.max(np.abs(solver.solve(system).theta - full_system(A, b)))
    reduced = least_seconds(lambda: solver.solve(system), 5 if small else 200)
    full = least_seconds(lambda: full_system(A, b), 1 if small else 3)
    print(
        f"N = {rows}, n = 2   reduced {1e3 * reduced:8.3f} ms   full {1e3 * full:9.1f} ms   "
        f"{full / reduced:7.0f} x faster (target 1000 at N = 4000)   difference {difference:.1e}"
    )


if __name__ == "__main__":
    main()
