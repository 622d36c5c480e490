"""Data with known truth: sources of signals, records of a loop, flights, and the files that describe them."""
