"""The state space: its response is that of the motion, and it asks for all that it is made of."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import eivor as ev
from eivor.errors import MissingReaderError, NotIdentifiedError, UsageError
from exports.documents import JOINT, document, of_speeds, quantity, refused, written
from exports.simulated import FRICTION, GAIN, climb


def test_the_gain_at_rest_is_that_of_the_equation(tmp_path: Path) -> None:
    made = ev.load_fit(written(document(delay=(0.005, 0.0)), tmp_path)).to_statespace()
    assert made.states == ("actuator", "velocity_z")
    assert made.delay_s == 0.005
    rest = -made.C @ np.linalg.solve(made.A, made.B)
    assert rest[0, 0] == pytest.approx(23.9 / 0.3)
    assert sorted(np.linalg.eigvals(made.A).real) == pytest.approx([-1 / 0.05, -0.3])


def test_a_curved_map_enters_by_its_slope_at_hover(tmp_path: Path) -> None:
    reported = document()
    reported["model"]["input_map"] = "square"
    reported["model"]["input_measured"] = True
    made = ev.load_fit(written(reported, tmp_path)).to_statespace()
    assert made.B.item() == pytest.approx(23.9 * 2.0 * 0.41)
    assert (made.A.item(), made.states) == (-0.3, ("velocity_z",))


@pytest.mark.parametrize("name", [*JOINT, "delay", "hover_input"])
def test_what_is_refused_must_be_given(name: str, tmp_path: Path) -> None:
    fit = ev.load_fit(written(refused(document(), name), tmp_path))
    with pytest.raises(NotIdentifiedError, match=f"{name} is refused. The flight does not identify it"):
        fit.to_statespace()
    reported = json.loads(fit.export("statespace", priors={name: (0.2, 0.01)}))
    assert reported["numbers"][name]["value"] == 0.2
    assert reported["numbers"][name]["source"] == "given"
    assert reported["schema"] == "eivor.statespace/1"
    assert np.shape(reported["A"]) == (2, 2)


def test_wrong_priors_are_told(tmp_path: Path) -> None:
    fit = ev.load_fit(written(document(), tmp_path))
    with pytest.raises(UsageError, match="priors that statespace uses"):
        fit.export("statespace", priors={"drag": (0.2, 0.01)})
    with pytest.raises(UsageError, match="not below zero"):
        fit.export("statespace", priors={"delay": (0.2, -0.01)})
    with pytest.raises(UsageError, match="a mass above zero"):
        fit.export("statespace", mass=(0.0, 0.01))


@pytest.mark.thorough  # python-control takes seconds to import
def test_python_control_takes_it_and_climbs_as_the_flight_did(tmp_path: Path) -> None:
    control = pytest.importorskip("control", reason="python-control is not installed")
    speeds = of_speeds(delay=(0.02, 0.0))
    speeds["parameters"]["viscous_friction"] = quantity(FRICTION, 0.02)
    linear = ev.load_fit(written(speeds, tmp_path)).to_statespace()
    made = linear.to_control()
    assert made.input_labels == ["rotor_command"]
    assert made.output_labels == ["velocity_z"]
    assert made.state_labels == ["actuator", "velocity_z"]
    hover = speeds["derived"]["hover_input"]["value"]
    assert float(np.real(control.dcgain(made))) == pytest.approx(2.0 * GAIN * hover / FRICTION)
    answer = control.step_response(made, T=np.linspace(0.0, 1.0, 101))
    assert 1e-4 * hover * answer.outputs[-1] == pytest.approx(climb(1.0 + 1e-4, 1.0), rel=1e-3)
    late = made * control.tf(*control.pade(linear.delay_s, 4))
    behind = control.step_response(late, T=np.linspace(0.0, 1.0, 101)).outputs
    np.testing.assert_allclose(behind[20:], answer.outputs[18:-2], rtol=1e-3)


def test_without_python_control_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "control", None)
    with pytest.raises(MissingReaderError, match="pip install control"):
        ev.load_fit(written(document(), tmp_path)).to_statespace().to_control()
