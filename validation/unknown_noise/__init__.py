"""Parameters and noises estimated together, and whether intervals hold both."""
