"""Search for the reading of the paper that gives its printed tables."""
