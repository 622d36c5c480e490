"""The vertical motion about hover as a linear state space, for the design of controllers.

States are the deviation of the actuators from hover and the climb rate: tau x' + x = u(t - d), and
v' = K_u map'(u_h) x - K v. Without a lag the climb rate is the only state.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, final

import numpy as np

from eivor.errors import MissingReaderError
from eivor.exports.comments import one_line
from eivor.exports.fitted import Exported, Fitted, Number, Supplied
from eivor.exports.target import Target
from eivor.shapes import Float

SCHEMA = "eivor.statespace/1"
#: What the arrays are made of.
NEEDED = ("viscous_friction", "input_gain", "hover_input")
LAGS = ("actuator_lag", "delay")


@dataclass(frozen=True)
class StateSpace:
    """x' = A x + B u(t - delay), y = C x + D u.

    Parameters
    ----------
    A, B, C, D : ndarray
        Of shapes (n, n), (n, 1), (1, n) and (1, 1).
    states, inputs, outputs : tuple of str
        Their names; the input is the deviation of the command from hover.
    delay_s : float
        Of the input [s].
    numbers : mapping of str to Number
        What they are made of.
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n 1"]
    C: Float[np.ndarray, "1 n"]
    D: Float[np.ndarray, "1 1"]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    delay_s: float
    numbers: dict[str, Number] = field(default_factory=dict)

    def to_control(self) -> Any:
        """The same as a ``control.StateSpace`` of python-control, without the delay.

        Python-control has no delays in continuous time: multiply by ``control.pade(delay_s, n)``.

        Raises
        ------
        MissingReaderError
            When python-control is not installed.
        """
        try:
            control = import_module("control")
        except ImportError as error:
            raise MissingReaderError(
                "python-control, which to_control makes its model with",
                "a Python without it",
                "Install it: pip install control. The arrays A, B, C and D are there without it.",
            ) from error
        return control.ss(
            self.A,
            self.B,
            self.C,
            self.D,
            states=list(self.states),
            inputs=list(self.inputs),
            outputs=list(self.outputs),
        )


def state_space(fitted: Fitted, supplied: Supplied) -> StateSpace:
    """State space of a result of the vertical motion.

    Raises
    ------
    NotIdentifiedError
        When friction, gain, hover input, lag or delay is neither identified nor given.
    UsageError
        When the result is of another motion.
    """
    fitted.check_vertical("a state space")
    names = NEEDED if fitted.input_measured else (*NEEDED, *LAGS)
    numbers = {name: fitted.needed(name, supplied, "a state space") for name in names}
    friction, gain, hover = (numbers[name].value for name in NEEDED)
    lag, delay = (numbers[name].value if name in numbers else 0.0 for name in LAGS)
    slope = gain * fitted.input_map.slope(hover)
    inputs, outputs, D = (fitted.input,), ("velocity_z",), np.zeros((1, 1))
    if lag > 0.0:
        A, B = np.array([[-1.0 / lag, 0.0], [slope, -friction]]), np.array([[1.0 / lag], [0.0]])
        states = ("actuator", "velocity_z")
        return StateSpace(A, B, np.array([[0.0, 1.0]]), D, states, inputs, outputs, delay, numbers)
    A, B = np.array([[-friction]]), np.array([[slope]])
    return StateSpace(A, B, np.ones((1, 1)), D, ("velocity_z",), inputs, outputs, delay, numbers)


@final
class StateSpaceDocument(Target):
    """The arrays as JSON."""

    name = "statespace"
    words = "arrays A, B, C, D of the motion about hover (JSON)"
    ending = ".json"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        supplied.check_only((*NEEDED, *LAGS), self.name, body=False)
        made = state_space(fitted, supplied)
        document = {
            "schema": SCHEMA,
            "comments": [one_line(line) for line in fitted.origin()],
            **{name: getattr(made, name).tolist() for name in "ABCD"},
            "states": made.states,
            "inputs": made.inputs,
            "outputs": made.outputs,
            "delay_s": made.delay_s,
            "numbers": {
                name: {"value": one.value, "interval": one.interval, "source": one.source}
                for name, one in made.numbers.items()
            },
        }
        return Exported(json.dumps(document, indent=2) + "\n")
