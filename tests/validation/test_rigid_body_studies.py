"""Studies of the rigid body, of turning, and of K by both motions."""

from __future__ import annotations

from dataclasses import replace

import pytest

from validation.joint import study as joint
from validation.joint.study import Told as ToldOfK
from validation.rates import study as rates

pytest.importorskip("rotorpy")


def told_of_rates(vehicle: str, condition: str, number: int) -> rates.Turned:
    return rates.Turned(
        vehicle, condition, number, rates.INSTRUMENTS, "roll_effectiveness", 0.01, -0.02, 0.03, True
    )


def told_of_k(
    flight: str, formula: str, half: float = 0.1, value: float = 0.42, **changes: object
) -> ToldOfK:
    item = ToldOfK(flight, formula, "identified", "identified", 0.4, value, value - half, value + half)
    return replace(item, **changes)


@pytest.mark.parametrize(("study_of", "trials"), [(rates, None), (joint, 12)], ids=["rates", "joint"])
def test_a_run_goes_on_where_it_was_interrupted(study_of, trials, tmp_path, monkeypatch, capsys):
    kept, flown = tmp_path / "kept.jsonl", []

    def fly(specs):
        flown.extend(specs)
        return iter(specs)

    def strength_of(first, *others):
        if study_of is rates:
            vehicle, condition, number = others
            return [told_of_rates(vehicle, condition.name, number)]
        return [told_of_k(first.name, formula) for formula in joint.FORMULAS]

    monkeypatch.setattr(study_of, "simulate_rigid_body_flights", fly)
    monkeypatch.setattr(study_of, "strength_of", strength_of)
    code = study_of.main(["--kept", str(kept)])
    printed, lines = capsys.readouterr().out, kept.read_text()
    assert len(flown) == (trials or len(lines.splitlines()))
    assert study_of.main(["--kept", str(kept)]) == code
    assert (capsys.readouterr().out, kept.read_text()) == (printed, lines)
    assert len(flown) == (trials or len(lines.splitlines()))
