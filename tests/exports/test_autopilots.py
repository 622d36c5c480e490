"""Parameters of autopilots: read back by strict parsers, refused where not told, harmless in any name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eivor as ev
from eivor.errors import UsageError
from exports.documents import document, of_motors, quantity, refused, written

HEADER = "# Vehicle-Id Component-Id Name Value Type"
HOSTILE = "a\n1\t1\tMPC_THR_HOVER\t0.9\t9\r\u2028b\x1b[2J\udcff.ulg"


def qgc(text: str) -> dict[str, float]:
    """Parameters of a file of QGroundControl, which is refused for anything out of the ordinary."""
    assert text.isascii()
    assert text.endswith("\n")
    assert HEADER in text.split("\n")
    found: dict[str, float] = {}
    for line in text[:-1].split("\n"):
        assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", line)
        if line.startswith("#"):
            assert "\t" not in line
            continue
        vehicle, component, name, value, kind = line.split("\t")
        assert (vehicle, component, kind) == ("1", "1", "9")
        assert re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", name)
        assert re.fullmatch(r"-?\d+\.\d+", value)
        assert name not in found
        assert float(np.float32(value)) == pytest.approx(float(value), rel=1e-7)
        found[name] = float(np.float32(value))
    return found


def ardupilot(text: str) -> dict[str, float]:
    """Parameters of a file of ArduPilot."""
    assert text.isascii()
    rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", name) for name, _ in rows)
    return {name: float(value) for name, value in rows}


def exported(told: dict[str, Any], folder: Path, to: str = "px4") -> str:
    return ev.load_fit(written(told, folder)).export(to)


def test_hover_of_a_thrust_setpoint(tmp_path: Path) -> None:
    text = exported(document(), tmp_path)
    assert qgc(text) == {"MPC_THR_HOVER": pytest.approx(0.41, rel=1e-7)}
    assert "95 % interval [0.406, 0.414]" in text
    assert "flight.ulg, SHA-256 abab" in text
    assert "Eivor 0.1.0" in text
    assert "THR_MDL_FAC is not written" in text


def test_curve_and_hover_of_motors_signals(tmp_path: Path) -> None:
    found = qgc(exported(of_motors(document()), tmp_path))
    assert found["THR_MDL_FAC"] == pytest.approx(0.6, rel=1e-6)
    assert found["MPC_THR_HOVER"] == pytest.approx(0.4 * 0.41 + 0.6 * 0.41**2, rel=1e-6)


@pytest.mark.parametrize("name", ["thrust_curve", "hover_input"])
def test_curve_and_hover_go_together(name: str, tmp_path: Path) -> None:
    text = exported(refused(of_motors(document()), name), tmp_path)
    assert qgc(text) == {}
    assert "The flight does not tell it." in text
    beyond = of_motors(document())
    beyond["parameters"]["thrust_curve"] = quantity(1.0, 0.03)
    beyond["derived"]["hover_input"] = quantity(0.95, 0.001)
    assert qgc(exported(beyond, tmp_path)) == {}


def test_a_refused_hover_is_a_comment_with_its_reason(tmp_path: Path) -> None:
    text = exported(refused(document(), "hover_input", "Wind."), tmp_path)
    assert qgc(text) == {}
    assert "# MPC_THR_HOVER is not written: hover_input is refused. Wind." in text


def test_what_the_autopilot_does_not_take_is_a_comment(tmp_path: Path) -> None:
    text = exported(document(hover_input=(0.05, 0.001)), tmp_path)
    assert qgc(text) == {}
    assert "beyond what the autopilot takes, 0.1 to 0.8" in text


def test_rotor_speeds_and_other_motions_are_refused(tmp_path: Path) -> None:
    speeds = document(hover_input=(1788.0, 1.0))
    speeds["model"]["input"] = "rotor_command"
    with pytest.raises(UsageError, match="a share of the largest"):
        exported(speeds, tmp_path)
    rates = document()
    rates["model"]["name"] = "angular_rates"
    with pytest.raises(UsageError, match="the vertical motion for PX4"):
        exported(rates, tmp_path)
    with pytest.raises(UsageError, match="each autopilot counts shares"):
        exported(document(), tmp_path, "ardupilot")
    with pytest.raises(UsageError, match="Did you mean 'px4'"):
        exported(document(), tmp_path, "px5")
    fit = ev.load_fit(written(document(), tmp_path))
    with pytest.raises(UsageError, match="no mass for px4"):
        fit.export("px4", mass=(1.5, 0.1))
    with pytest.raises(UsageError, match="priors that px4 uses"):
        fit.export("px4", priors={"hover_input": (0.4, 0.1)})


@pytest.mark.parametrize(("to", "format_name"), [("px4", "ulog"), ("ardupilot", "dataflash")])
def test_no_name_of_a_log_becomes_a_parameter(to: str, format_name: str, tmp_path: Path) -> None:
    told = refused(document(log=HOSTILE), "viscous_friction", HOSTILE)
    told["logs"][0]["format"] = format_name
    told["parameters"]["delay"]["reasons"] = [HOSTILE]
    text = exported(told, tmp_path, to)
    read = qgc if to == "px4" else ardupilot
    assert list(read(text).values()) == [pytest.approx(0.41, rel=1e-6)]
    hostile = exported(refused(told, "hover_input", HOSTILE), tmp_path, to)
    assert read(hostile) == {}


def test_parameters_of_ardupilot(tmp_path: Path) -> None:
    told = of_motors(document())
    told["logs"][0]["format"] = "dataflash"
    found = ardupilot(exported(told, tmp_path, "ardupilot"))
    assert found["MOT_THST_EXPO"] == pytest.approx(0.6, rel=1e-6)
    assert found["MOT_THST_HOVER"] == pytest.approx(0.4 * 0.41 + 0.6 * 0.41**2, rel=1e-6)
