"""Published numbers; their sources are in README.md beside this file."""

from __future__ import annotations

import numpy as np

FILIP = np.array(
    [
        *(-1467.48961422980, -2772.17959193342, -2316.37108160893, -1127.97394098372, -354.478233703349),
        *(-75.1242017393757, -10.8753180355343, -1.06221498588947, -0.0670191154593408),
        *(-0.00246781078275479, -0.0000402962525080404),
    ]
)
NORRIS = np.array([-0.262323073774029, 1.00211681802045])
PEARSON_X = np.array([0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
PEARSON_Y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
YORK_WEIGHTS_X = np.array([1000, 1000, 500, 800, 200, 80, 60, 20, 1.8, 1])
YORK_WEIGHTS_Y = np.array([1, 1.8, 4, 8, 20, 20, 70, 70, 100, 500])
YORK_LINE = (5.47991, -0.480533)
STATA_2SLS = {"hsngval": 0.00223983298, "pcturban": 0.08151596819, "const": 120.70651454}
#: Stata's manual, ivregress: limited information, digits as printed.
STATA_LIML = {"hsngval": 0.0026686, "pcturban": -0.1827391, "const": 117.6087}
STATA_GMM = {"hsngval": 0.00146432787, "pcturban": 0.76154815601, "const": 112.12271295}
STATA_GMM_J = 6.8364006463
#: Of two-stage least squares: classical with N - n degrees of freedom, and robust; hsngval, pcturban, const.
STATA_CLASSICAL = (
    (1.147578e-07, -0.00007072299, -0.00082907429),
    (-0.00007072299, 0.09495812823, -2.9284304557),
    (-0.00082907429, -2.9284304557, 246.70620175),
)
STATA_ROBUST = (
    (4.515882e-07, -0.00025510597, -0.00353769212),
    (-0.00025510597, 0.19766368737, -1.2789145411),
    (-0.00353769212, -1.2789145411, 232.72902037),
)
