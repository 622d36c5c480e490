"""The study of the flight recipe: its grid, trials, metrics and page."""
