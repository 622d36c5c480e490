"""`eivor validate` as it is called."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Caller = Callable[..., Any]
pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_another_flight_is_predicted(eivor: Caller, log: Path, tmp_path: Path) -> None:
    fit, figure = tmp_path / "fit.json", tmp_path / "fit.svg"
    assert eivor("identify", f"{log}@0:25", "--json", fit).code == 0
    run = eivor("validate", fit, f"{log}@15:30", "--figure", figure)
    assert run.code == 0
    assert "leaves less than the simpler models" in " ".join(run.out.split())
    assert "RMS error" in run.out
    assert figure.stat().st_size > 1000
    reported = eivor("validate", fit, log, "--window", "15:30", "--json", "-")
    assert json.loads(reported.out)["schema"] == "eivor.validate/1"

    document = json.loads(fit.read_text())
    document["covariance"]["candidates"][0]["values"] = [9.0, 1.0, 0.2]
    fit.write_text(json.dumps(document))
    assert eivor("validate", fit, log).code == 3
    document["prediction"] = None
    fit.write_text(json.dumps(document))
    refused = eivor("validate", fit, log)
    assert refused.code == 2
    assert "a result with an estimate" in refused.err
    assert eivor("validate", fit, log, "--json", fit).code == 2


def test_files_that_are_no_results_are_told(eivor: Caller, log: Path, tmp_path: Path) -> None:
    assert eivor("validate", log, log).code == 1
    missing = eivor("validate", tmp_path / "none.json", log)
    assert missing.code == 1
    assert "none.json" in missing.err
