"""Quantiles of the supremum of `eivor.inference.diagnostics.constancy` when the parameters are constant.

From 100,000 draws of `simulated_suprema` for each number of parameters. Their standard error is below 1 %
of the value at the tail .05, and about 3 % at .001.
"""

from __future__ import annotations

#: Probability to exceed the quantiles.
TAILS = (0.5, 0.25, 0.1, 0.05, 0.025, 0.01, 0.005, 0.0025, 0.001)

#: For each number of parameters that are tested together.
QUANTILES: dict[int, tuple[float, ...]] = {
    1: (3.486, 5.883, 9.504, 12.6, 16.14, 21.38, 25.69, 30.83, 38.69),
    2: (3.18, 5.044, 7.727, 9.985, 12.48, 16.5, 19.81, 24.31, 29.82),
    3: (3.114, 4.842, 7.308, 9.404, 11.86, 15.45, 18.58, 22.47, 29.16),
    4: (3.166, 4.904, 7.441, 9.712, 12.25, 16.16, 19.9, 24.46, 30.85),
    5: (3.352, 5.24, 8.009, 10.56, 13.46, 17.96, 22.07, 27.66, 35.76),
    6: (3.644, 5.846, 9.261, 12.34, 15.96, 22.17, 28.04, 35.37, 46.25),
}
