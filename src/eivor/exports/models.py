"""Exports of equations: state spaces, of python-control too, functions of CasADi, and structs of MATLAB."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from eivor.errors import EstimationError, NotIdentifiedError, UsageError
from eivor.exports import vehicle
from eivor.exports.fitted import (
    VERTICAL,
    Exported,
    Fitted,
    Number,
    Supplied,
    one_line,
    rendered,
    targets,
)
from eivor.exports.vehicle import Columns, ExportOfDraws, VehicleDescription
from eivor.logs.channel_map import Expression
from eivor.models.frequency_response import python_control
from eivor.motions.equation import SolvedEquation
from eivor.motions.machine import Machine
from eivor.motions.rigid_body.dynamics import Coefficients, body_derivative, speed_derivative
from eivor.signals.recording import GRAVITY
from eivor.signals.thrust_map import Mixed, Power
from eivor.simulation.rigid_body import quaternions
from eivor.strict_toml import package_tables
from eivor.tools import Float

#: What the arrays of the vertical motion are made of.
NEEDED = ("viscous_friction", "input_gain", "hover_input")
LAGS = ("actuator_lag", "delay")
#: Name in documents of the motion that turns, and its axes with channels of the inputs and outputs.
RATES = "body_rates"
TURNING = {"roll": "x", "pitch": "y", "yaw": "z"}
KINDS = ("effectiveness", "damping")


@dataclass(frozen=True)
class StateSpace:
    """x' = A x + B u(t - delay), y = C x + D u."""

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n m"]
    C: Float[np.ndarray, "k n"]
    D: Float[np.ndarray, "k m"]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    delay_s: float
    numbers: dict[str, Number] = field(default_factory=dict)

    def to_control(self) -> Any:
        """The same as a ``control.StateSpace`` of python-control, without the delay."""
        control = python_control(" The arrays A, B, C and D are there without it.")
        names = {name: list(getattr(self, name)) for name in ("states", "inputs", "outputs")}
        return control.ss(self.A, self.B, self.C, self.D, **names)


def state_space(fitted: Fitted, supplied: Supplied, speed_m_s: float = 0.0) -> StateSpace:
    """State space of a result, about hover or flight along x."""
    if fitted.model == vehicle.RIGID_BODY:
        return linearised(vehicle.describe(fitted, supplied, "a state space", vehicle.BODY), speed_m_s)
    if speed_m_s:
        raise UsageError(
            "a result of the rigid body, for flight along x", f"one of {fitted.model}", "Leave the speed out."
        )
    if fitted.model == RATES:
        return _rates_space(fitted, supplied)
    if fitted.machine is not None:
        return _about_rest(_MachineEquations.of(fitted.machine, fitted, supplied, "a state space"))
    numbers = _vertical_numbers(fitted, supplied, "a state space")
    friction, gain, hover = (numbers[name].value for name in NEEDED)
    lag, delay = (numbers[name].value if name in numbers else 0.0 for name in LAGS)
    slope = gain * fitted.input_map.slope(hover)
    states: tuple[str, ...] = ("velocity_z",)
    A, B = np.array([[-friction]]), np.array([[slope]])
    if lag > 0.0:
        A, B = np.array([[-1.0 / lag, 0.0], [slope, -friction]]), np.array([[1.0 / lag], [0.0]])
        states = ("actuator", *states)
    C, outputs = np.eye(1, len(states), len(states) - 1), ("velocity_z",)
    return StateSpace(A, B, C, np.zeros((1, 1)), states, (fitted.input,), outputs, delay, numbers)


def _vertical_numbers(fitted: Fitted, supplied: Supplied, target: str) -> dict[str, Number]:
    """Numbers of the vertical motion; an input that was measured has no lag."""
    fitted.check_vertical(target)
    supplied.check_only((*NEEDED, *LAGS), target, body=False)
    return fitted.needed(NEEDED if fitted.input_measured else (*NEEDED, *LAGS), supplied, target)


def _rates_space(fitted: Fitted, supplied: Supplied) -> StateSpace:
    """Rates by torque setpoints: each axis has a state of its actuators and one of its rate."""
    priors = (*LAGS, *(f"{axis}_{kind}" for axis in TURNING for kind in KINDS))
    supplied.check_only(priors, "a state space", body=False)
    axes = [axis for axis in TURNING if fitted.is_identified(f"{axis}_effectiveness")]
    if not axes:
        fitted.needed([f"{axis}_effectiveness" for axis in TURNING], supplied, "a state space")
    names = (*LAGS, *(f"{axis}_{kind}" for axis in axes for kind in KINDS))
    numbers = fitted.needed(names, supplied, "a state space")
    total, second = max(numbers["actuator_lag"].value, 1e-6), fitted.identified_number("second_lag")
    lags = [total] if second is None or not second.value > 0.0 else [total - second.value, second.value]
    n, stages = len(axes), len(lags)
    AB = np.zeros(((stages + 1) * n, (stages + 2) * n))  # Columns of the inputs last
    for row, axis in enumerate(axes):
        gain, damping = (numbers[f"{axis}_{kind}"].value for kind in KINDS)
        reaction = fitted.identified_number(f"{axis}_reaction")
        jump = 0.0 if reaction is None else reaction.value / lags[-1]
        source = (stages + 1) * n + row
        for stage, lag in enumerate(lags):
            state = stage * n + row
            AB[state, state], AB[state, source] = -1.0 / lag, 1.0 / lag
            previous, source = source, state
        rate = stages * n + row
        AB[rate, source], AB[rate, rate], AB[rate, previous] = gain - jump, -damping, jump
    A, B = np.split(AB, [(stages + 1) * n], axis=1)
    C = np.hstack([np.zeros((n, stages * n)), np.eye(n)])
    rates = tuple(f"angular_rate_{TURNING[axis]}" for axis in axes)
    inputs = tuple(f"torque_setpoint_{TURNING[axis]}" for axis in axes)
    words = ("actuator", "second_stage")[:stages]
    states = (*(f"{axis}_{word}" for word in words for axis in axes), *rates)
    delay = numbers["delay"].value
    return StateSpace(A, B, C, np.zeros((n, n)), states, inputs, rates, delay, numbers)


STATES = (*(f"velocity_{axis}" for axis in "xyz"), *TURNING, *(f"angular_rate_{axis}" for axis in "xyz"))
#: Of the difference quotients, and of the trimmed accelerations [m/s^2, rad/s^2].
STEP, TRIMMED = 1e-5, 1e-6
FORWARD_M_S = 5.0


def _jacobian(
    f: Callable[[Float[np.ndarray, " m"]], Float[np.ndarray, " n"]],
    x: Float[np.ndarray, " m"],
    sizes: Float[np.ndarray, " m"],
) -> Float[np.ndarray, "n m"]:
    return np.stack([(f(x + step) - f(x - step)) / (2.0 * step.sum()) for step in np.diag(sizes)], axis=1)


def linearised(craft: VehicleDescription, speed_m_s: float = 0.0) -> StateSpace:
    """Linear equations of the first vehicle about steady flight along x."""
    c, count, mass = vehicle.coefficients(craft), craft.vehicle.count, craft.values["mass"][0]
    hover = vehicle.manoeuvre(craft, 0.0)[0]
    squares = np.linalg.pinv(vehicle.mixing_matrix(craft)) * mass * GRAVITY / c.thrust_quadratic

    def speeds(shares: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " rotors"]:
        return np.sqrt(np.maximum(hover**2 + squares @ shares, 1e-12))

    def trim_residual(trim: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 6"]:
        state = np.array([speed_m_s, 0.0, 0.0, *trim[:2], *[0.0] * 4, *speeds(trim[2:])])
        derivative = _state_dot(c, state, state[9:])
        return np.concatenate([derivative[:3], derivative[6:9]])

    trim = scipy.optimize.root(trim_residual, np.zeros(6), tol=1e-12).x
    if not np.abs(trim_residual(trim)).max() < TRIMMED:
        expected = f"a vehicle that flies steadily at {speed_m_s:g} m/s"
        raise EstimationError(expected, "equations that it cannot hold", "Fly slower.")
    state = np.array([speed_m_s, 0.0, 0.0, *trim[:2], *[0.0] * 4, *speeds(trim[2:])])
    sizes = STEP * np.array([*[1.0] * 9, *state[9:]])
    A = _jacobian(lambda point: _state_dot(c, point, state[9:]), state, sizes)
    B = np.zeros((state.size, count))
    B[9:] = 0.5 * (c.rate_up + c.rate_down) * np.eye(count)
    C = np.eye(9, state.size)
    inputs = tuple(f"rotor_command_{number}" for number in range(1, count + 1))
    states = (*STATES, *(f"rotor_speed_{number}" for number in range(1, count + 1)))
    delay = float(craft.values["delay"][0]) if "delay" in craft.values else 0.0
    return StateSpace(A, B, C, np.zeros((9, count)), states, inputs, STATES, delay)


def _state_dot(c: Coefficients, state: Float[np.ndarray, " n"], command: Float[np.ndarray, " rotors"]) -> Any:
    """Change of velocity, roll, pitch, yaw, rates and rotor speeds."""
    (roll, pitch, _), (p, q, r), speeds = state[3:6], state[6:9], state[9:].tolist()
    still, attitude = (0.0, 0.0, 0.0), quaternions(state[None, 3:6])[0]
    body = [*still, *state[:3].tolist(), *attitude.tolist(), float(p), float(q), float(r)]
    spin_up = speed_derivative(c, speeds, command.tolist())
    rates = body_derivative(c, body, speeds, spin_up, still, still)
    transverse = q * np.sin(roll) + r * np.cos(roll)
    angles = (p + transverse * np.tan(pitch), q * np.cos(roll) - r * np.sin(roll), transverse / np.cos(pitch))
    return np.array([*rates[3:6], *angles, *rates[10:13], *spin_up], dtype=np.float64)


@dataclass(frozen=True)
class _MachineEquations:
    """Equations of a declared machine with numbers, x' = f(x, u(t - delay))."""

    numbers: dict[str, Number]
    equations: list[SolvedEquation]
    states: list[str]
    acting: list[str]  # Inputs behind actuators, states too
    inputs: list[str]  # All that no equation determines
    lag_s: float

    @classmethod
    def of(cls, machine: Machine, fitted: Fitted, supplied: Supplied, target: str) -> _MachineEquations:
        names = (*(term.name for term in machine.terms), *(LAGS if machine.has_lag else ()))
        supplied.check_only(names, target, body=False)
        numbers = fitted.needed(names, supplied, target)
        equations = machine.solved({name: number.value for name, number in numbers.items()})
        states = [name for equation in equations for name in equation.lower]
        inputs = [c.name for c in machine.logged if c.role in ("input", "state") and c.name not in states]
        lag_s = numbers["actuator_lag"].value if machine.has_lag else 0.0
        lagged = {name for e in equations for _, item, is_late in e.terms if is_late for name in item.columns}
        acting = [name for name in inputs if name in lagged and lag_s > 0.0]
        return cls(numbers, equations, states, acting, inputs, lag_s)

    def derivative(self, x: Float[np.ndarray, " n"], u: Float[np.ndarray, " m"]) -> Float[np.ndarray, " n"]:
        acting = dict(zip(self.acting, x[len(self.states) :], strict=True))
        signals: dict[str, Any] = dict(
            zip([*self.states, *self.inputs], [*x[: len(self.states)], *u], strict=True)
        )
        for equation in self.equations:
            signals[equation.solved] = equation.derivative(signals, acting, 0.0)
        lag_rates = [(signals[name] - value) / self.lag_s for name, value in acting.items()]
        return np.array([*(signals[f"{name}'"] for name in self.states), *lag_rates], dtype=np.float64)

    def formulas(self) -> dict[str, Any]:
        """The same for CasADi: of each equation what is zero where its highest derivative is right."""
        names = {name: f"x[{row}]" for row, name in enumerate([*self.states, *self.acting])}
        actuators = {name: names.pop(name) for name in self.acting}
        names |= {name: f"u[{row}]" for row, name in enumerate(self.inputs)}
        balances: list[str] = []
        for number, equation in enumerate(self.equations, 1):
            names[equation.solved] = "highest"
            parts = [
                f"- {value!r} * {_formula(expression, names | actuators if is_late else names)}"
                for value, expression, is_late in equation.terms
            ]
            balances.append(" ".join([_formula(equation.response, names), *parts]))
            names[equation.solved] = f"solved_{number}"
        lag_rates = [f"({names[name]} - {actuators[name]}) / {self.lag_s!r}" for name in self.acting]
        return {"balances": balances, "xdot": [*(names[f"{name}'"] for name in self.states), *lag_rates]}


#: CasADi's words for functions that are called otherwise there.
_CASADI = package_tables("eivor.exports", "casadi.toml")


def _formula(expression: Expression, names: dict[str, str]) -> str:
    """An expression as Python for CasADi, with what stands for its columns."""
    stack: list[str] = []
    for step in expression.steps:
        if isinstance(step, np.ufunc):
            arguments = [stack.pop() for _ in range(step.nin)][::-1]
            words = _CASADI.get(step.__name__) or f"ca.{step.__name__}({', '.join(['{}'] * step.nin)})"
            stack.append(words.format(*arguments))
        else:
            stack.append(names[step] if isinstance(step, str) else repr(float(step)))  # type: ignore[arg-type]
    return stack.pop()


def _about_rest(machine: _MachineEquations) -> StateSpace:
    n, m = len(machine.states) + len(machine.acting), len(machine.inputs)
    origin = np.zeros(n + m)
    AB, closer = (
        _jacobian(lambda z: machine.derivative(z[:n], z[n:]), origin, np.full(n + m, size))
        for size in (STEP, 0.1 * STEP)
    )
    if not np.allclose(AB, closer, rtol=1e-3, atol=1e-6):
        expected = "equations that have slopes at rest"
        remedy = "Write the whole equations: --to casadi."
        raise UsageError(expected, "terms that jump there, such as dry friction", remedy)
    states = (*machine.states, *(f"{name}_behind" for name in machine.acting))
    outputs, late = tuple(machine.states), machine.numbers.get("delay")
    C, D, inputs = np.eye(len(outputs), n), np.zeros((len(outputs), m)), tuple(machine.inputs)
    delay_s = 0.0 if late is None else late.value
    return StateSpace(AB[:, :n], AB[:, n:], C, D, states, inputs, outputs, delay_s, machine.numbers)


def _document(comments: Iterable[str], space: StateSpace, **parts: object) -> str:
    document = {
        "schema": "eivor.statespace/1",
        "comments": [one_line(line) for line in comments],
        **{name: getattr(space, name).tolist() for name in "ABCD"},
        "states": space.states,
        "inputs": space.inputs,
        "outputs": space.outputs,
        "delay_s": space.delay_s,
        "numbers": {name: asdict(number) for name, number in space.numbers.items()},
    }
    return json.dumps(document | parts, indent=2) + "\n"


def _state_space_document(fitted: Fitted, supplied: Supplied) -> Exported:
    if fitted.model != vehicle.RIGID_BODY:
        return _reduced_document(fitted, state_space(fitted, supplied))
    craft = vehicle.describe(fitted, supplied, "a state space", vehicle.BODY)
    hover, forward = linearised(craft), linearised(craft, FORWARD_M_S)
    parts = {"A": forward.A.tolist(), "B": forward.B.tolist(), "speed_m_s": FORWARD_M_S}
    remark = f"A and B are about hover; forward has those about flight along x at {FORWARD_M_S:g} m/s."
    comments = (*craft.comments, *vehicle.speed_comments(craft, "a state space"), remark)
    return Exported(_document(comments, hover, forward=parts), craft.omitted, craft.lost)


def _reduced_document(fitted: Fitted, space: StateSpace) -> Exported:
    """Of a motion that is no rigid body, with what is identified and not among its numbers."""
    left_over = (
        {"input_gain", "thrust_gain"} if fitted.model == RATES else {"quadratic_drag", *vehicle.ELSEWHERE}
    )
    lost = tuple(fitted.left_over("a state space", left_over))
    axes = [f"{axis}_effectiveness" for axis in TURNING if fitted.model == RATES]
    absent = [name for name in axes if name in fitted.quantities and name not in space.numbers]
    omitted = (f"Not written: {fitted.why_not(*absent)}",) if absent else ()
    return Exported(_document((*fitted.origin(space.numbers), *omitted, *lost), space), omitted, lost)


def _state_space_draws(fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
    """A, B and delay of each draw about hover, of six axes also A and B about forward flight."""
    if fitted.model == vehicle.RIGID_BODY:
        sample = vehicle.describe(fitted, supplied, "a state space", vehicle.BODY, draws, seed)
        vehicles = [
            replace(sample, values={name: column[[row]] for name, column in sample.values.items()})
            for row in range(sample.values["mass"].size)
        ]
        spaces = [linearised(item) for item in vehicles]
        further = {"forward": _arrays([linearised(item, FORWARD_M_S) for item in vehicles])}
    else:
        spaces, further = [], {}
        for row in range(next(iter(draws.values())).size):
            values = {name: float(column[row]) for name, column in draws.items()}
            quantities = {
                name: replace(item, value=values.get(name, item.value))
                for name, item in fitted.quantities.items()
            }
            if fitted.model == VERTICAL and "input_gain" in values:
                hover = fitted.input_map.inverse(GRAVITY / values["input_gain"])
                quantities["hover_input"] = replace(quantities["hover_input"], value=hover)
            spaces.append(state_space(replace(fitted, quantities=quantities), supplied))
    nominal = _state_space_document(fitted, supplied)
    document = json.loads(nominal.text)
    document["comments"].insert(0, one_line(vehicle.REMARKS["draws"]))
    document["draws"] = {**_arrays(spaces), "delay_s": [item.delay_s for item in spaces], **further}
    return replace(nominal, text=json.dumps(document) + "\n")


def _arrays(spaces: Iterable[StateSpace]) -> dict[str, Any]:
    return {name: [getattr(item, name).tolist() for item in spaces] for name in "AB"}


def _casadi(fitted: Fitted, supplied: Supplied) -> Exported:
    if fitted.model == vehicle.RIGID_BODY:
        craft = vehicle.describe(fitted, supplied, "CasADi", vehicle.BODY)
        comments = (*craft.comments, *vehicle.speed_comments(craft, "CasADi"))
        return vehicle.render("casadi.txt", craft, comments, c=asdict(vehicle.coefficients(craft)))
    if fitted.machine is not None:
        equations = _MachineEquations.of(fitted.machine, fitted, supplied, "CasADi")
        delay = equations.numbers.get("delay")
        late = "" if delay is None else f", {delay.value:.6g} s late"
        states = [*equations.states, *(f"{name} behind its lag" for name in equations.acting)]
        remark = f"x: {', '.join(states)}; u: {', '.join(equations.inputs)}{late}."
        comments = (*fitted.origin(equations.numbers), remark)
        sizes = len(states), len(equations.inputs)
        return Exported(rendered("casadi.txt", comments, machine=equations.formulas(), sizes=sizes))
    identified = _vertical_numbers(fitted, supplied, "CasADi")
    drag = fitted.identified_number("quadratic_drag")
    if drag is not None:
        identified["quadratic_drag"] = drag
    numbers = {name: number.value for name, number in identified.items()}
    match fitted.input_map:
        case Mixed(share):
            curve = f"{1.0 - share!r} * state + {share!r} * state**2"
        case Power(exponent):
            curve = f"state**{exponent!r}"
    vertical = {"quadratic_drag": 0.0, "delay": 0.0, **numbers} | {
        "actuator_lag": max(numbers.get("actuator_lag", 0.0), vehicle.LEAST["actuator_lag"]),
        "curve": curve,
        "gravity": numbers["input_gain"] * float(fitted.input_map(np.array([numbers["hover_input"]]))[0]),
    }
    lost = tuple(fitted.left_over("CasADi's function", vehicle.ELSEWHERE))
    comments = (*fitted.origin(identified), *lost)
    return Exported(rendered("casadi.txt", comments, vertical=vertical), lost=lost)


#: Longest name of a field in MATLAB.
LONGEST_FIELD = 63


def _field(name: str, row: int) -> str:
    """The name, or one that MATLAB takes in its place."""
    if name.isascii() and name.isidentifier() and name[0] != "_" and len(name) <= LONGEST_FIELD:
        return name
    return f"quantity_{row}_{re.sub('[^A-Za-z0-9]', '_', name)}"[:LONGEST_FIELD]


def _matlab(fitted: Fitted, supplied: Supplied) -> Exported:
    """A struct `fit` of every quantity; NaN stands for what is not identified."""
    supplied.check_only((), "matlab", body=False)
    identified = {name: fitted.is_identified(name) for name in fitted.quantities}
    if not any(identified.values()):
        raise NotIdentifiedError("a quantity that is identified", "none", fitted.why_not(*identified))
    joint, nothing = fitted.joint, np.full(2, np.nan)
    rows = np.array([identified.get(name, False) for name in fitted.names], dtype=bool)
    content = {
        "quantities": {
            _field(name, row): {
                "value": item.value if identified[name] else np.nan,
                "std_error": item.std_error if identified[name] else np.nan,
                "interval": np.array(item.interval) if identified[name] else nothing,
                "unit": one_line(item.unit),
                "verdict": item.verdict.value,
            }
            for row, (name, item) in enumerate(fitted.quantities.items())
        },
        "names": np.array([one_line(name) for name in fitted.names], dtype=object),
        "covariance": []
        if joint is None
        else np.where(np.outer(rows, rows), joint.covariance.matrix, np.nan),
        "model": one_line(fitted.model),
        "origin": np.array([one_line(line) for line in fitted.origin()], dtype=object),
    }
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"fit": content}, long_field_names=True, oned_as="column")
    missing = [name for name, is_known in identified.items() if not is_known]
    return Exported(buffer.getvalue(), (f"NaN in the file: {fitted.why_not(*missing)}",) if missing else ())


MODELS = targets({"statespace": _state_space_document, "casadi": _casadi, "matlab": _matlab})
DRAWN_MODELS: dict[str, ExportOfDraws] = {"statespace": _state_space_draws}
