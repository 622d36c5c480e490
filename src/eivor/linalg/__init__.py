"""Linear systems and their solvers; arrays only."""
