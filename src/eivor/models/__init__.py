"""Models: equations, and the regressions that are cut from signals by them."""
