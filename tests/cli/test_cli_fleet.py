"""`eivor fleet` as a user meets it."""

from __future__ import annotations

from fleets.fleet_rows import row, write_fleet


def test_query_prints_and_writes(eivor, tmp_path):
    fleet = write_fleet(tmp_path / "fleet", [row("a"), row("b", verdict="failed", reason="It is empty.")])
    run = eivor("fleet", "query", fleet)
    assert run.code == 0
    assert [line.split() for line in run.out.splitlines()] == [
        ["verdict", "logs"],
        ["failed", "1"],
        ["weak", "1"],
    ]
    run = eivor("fleet", "query", fleet, "gain", "--csv", "-")
    assert run.out.splitlines()[1].startswith("vertical,,2026-05-01T12:00:00.000000+0000,a,1.0")
    run = eivor("fleet", "query", fleet, "gain", "--csv", tmp_path / "gain.csv")
    assert "2026-05-01 12:00" in run.out
    assert (tmp_path / "gain.csv").read_text().startswith("motion,vehicle,")


def test_query_of_nothing(eivor, tmp_path):
    run = eivor("fleet", "query", tmp_path)
    assert (run.code, run.out) == (1, "")
    assert "eivor fleet run" in run.err
    assert eivor("fleet", "query", write_fleet(tmp_path / "fleet", [row("a")]), "nothing").code == 2
