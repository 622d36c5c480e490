"""The study of turning: a run goes on where it was interrupted."""

from __future__ import annotations

import pytest

from validation.rates import study as rates

pytest.importorskip("rotorpy")


def test_a_run_goes_on_where_it_was_interrupted(tmp_path, monkeypatch, capsys):
    kept, flown = tmp_path / "kept.jsonl", []

    def fly(specs):
        flown.extend(specs)
        return iter(specs)

    def strength_of(_flight, vehicle, condition, number):
        of = (vehicle, condition.name, number, rates.INSTRUMENTS, "roll_effectiveness")
        return [rates.Turned(*of, 0.01, -0.02, 0.03, True)]

    monkeypatch.setattr(rates, "simulate_rigid_body_flights", fly)
    monkeypatch.setattr(rates, "strength_of", strength_of)
    code = rates.main(["--kept", str(kept)])
    printed, lines = capsys.readouterr().out, kept.read_text()
    assert len(flown) == len(lines.splitlines())
    assert rates.main(["--kept", str(kept)]) == code
    assert (capsys.readouterr().out, kept.read_text()) == (printed, lines)
    assert len(flown) == len(lines.splitlines())
