"""The mutation check: chosen lines are swapped one at a time, and the tests must notice."""
