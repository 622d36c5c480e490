"""Draws as a Python file for Isaac Lab: ranges for its configuration, and the joint draws beside them.

Its terms draw each number by itself, out of a range: a box, which holds vehicles that the flight excludes.
Names are those of ``randomize_rigid_body_mass`` of ``isaaclab.envs.mdp`` and of ``ThrusterCfg`` of
``isaaclab_contrib``, which counts speeds in revolutions per second.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np

from eivor.exports.comments import hash_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.simulators.described import BODY, Described, describe
from eivor.exports.simulators.parts import INERTIAS, Column, Columns
from eivor.exports.simulators.randomisation import JOINT, Randomisation
from eivor.exports.simulators.rotors import rotors_of, speed_comments

NAME = "Isaac Lab"
#: What it takes gravity for [m/s^2].
GRAVITY = 9.81
NEEDS = (*BODY, "largest_command")
#: Quantiles that the ranges reach to.
ENDS = (0.025, 0.975)
REMARKS = (
    "events are the parameters of a term of events beside its asset_cfg; thruster is what a ThrusterCfg "
    "takes beside dt and thruster_names_expr, with the lag as it is: the approximation that it has by itself "
    "would make the lag longer by dt.",
    "events and thruster are ranges of 95 % of the draws, for terms that draw each number by itself: they "
    "hold vehicles that the flight excludes. draws are the joint ones: set them where you can.",
    "Drag is over mass, as linear_damping has it: of motion along z.",
)


@final
class IsaacLabDraws(Randomisation):
    """``events``, ``thruster`` and ``draws``, as plain dictionaries."""

    name = "isaaclab"
    words = "ranges and draws for Isaac Lab (Python file)"

    def export(self, fitted: Fitted, supplied: Supplied, draws: Columns, seed: int) -> Exported:
        """See `Randomisation`."""
        made = describe(fitted, supplied, NAME, NEEDS)
        columns = _columns(describe(fitted, supplied, NAME, NEEDS, draws, seed))
        lags, thrusts = (_range(columns[name]) for name in ("time_constant", "thrust_const"))
        masses = f'"mass_distribution_params": {_range(columns["mass"])}'
        uniform = '"operation": "abs", "distribution": "uniform"'
        lines = [
            *hash_comments((JOINT, *made.comments, *speed_comments(made, NAME, GRAVITY), *REMARKS)),
            "events = {",
            f'    "randomize_rigid_body_mass": {{{masses}, {uniform}}},',
            "}",
            "thruster = {",
            f'    "thrust_const_range": {thrusts},',
            f'    "tau_inc_range": {lags},',
            f'    "tau_dec_range": {lags},',
            f'    "thrust_range": {(0.0, float(np.median(columns["thrust_max"])))},',
            '    "use_discrete_approximation": False,',
            f'    "torque_to_thrust_ratio": {float(np.median(columns["torque_to_thrust_ratio"]))!r},',
            "}",
            "draws = {",
            *(f'    "{name}": {column.tolist()},' for name, column in columns.items()),
            "}",
        ]
        return Exported("\n".join(lines) + "\n", made.left_out)


def _columns(drawn: Described) -> dict[str, Column]:
    values, rotors = drawn.values, rotors_of(drawn, GRAVITY)
    friction = {"linear_damping": values["drag_z"] / values["mass"]} if "drag_z" in values else {}
    return {
        "mass": values["mass"],
        **{name: values[name] for name in INERTIAS},
        "thrust_const": rotors.thrust_constant * (2.0 * math.pi) ** 2,
        "thrust_max": rotors.thrust_constant * rotors.largest_speed**2,
        "time_constant": values["actuator_lag"],
        "torque_to_thrust_ratio": values["torque_ratio"],
        **friction,
    }


def _range(column: Column) -> tuple[float, float]:
    low, high = np.quantile(column, ENDS)
    return float(low), float(high)
