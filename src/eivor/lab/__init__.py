"""Laboratory: Monte Carlo studies, scenarios, the paper, unknown noise and regularised solvers."""
