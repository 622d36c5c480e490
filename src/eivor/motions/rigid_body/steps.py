"""What happens over each step of a grid: the mean of what is known at both its ends, and what it changes by.

A rate's increment over a step is the integral of its derivative, exactly, and so an equation of a rate's
derivative holds of increments and means over steps without any error of a numerical derivative. Commands
jump at samples: of what follows them quickly a derivative by differences knows too little.
"""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float


def before(values: Float[np.ndarray, "*parts n"]) -> Float[np.ndarray, "*parts n"]:
    """Values at the sample before; the first one stays."""
    return np.concatenate([values[..., :1], values[..., :-1]], axis=-1)


def mean_over_step(values: Float[np.ndarray, "*parts n"]) -> Float[np.ndarray, "*parts n"]:
    """Mean over the step that ends at each sample, of what is nearly straight within it."""
    return 0.5 * (values + before(values))


def change_over_step(values: Float[np.ndarray, "*parts n"], step_s: float) -> Float[np.ndarray, "*parts n"]:
    """Mean of the derivative over the step that ends at each sample, exactly."""
    return (values - before(values)) / step_s
