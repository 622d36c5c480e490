"""The study of recursive identification at a reduced size, and its table."""

from __future__ import annotations

import numpy as np
import pytest

import eivor as ev
from eivor.lab.scenario_files import shipped_scenario
from validation.recursion.study import changed_record, main, trial


def test_a_record_whose_parameter_does_not_change_is_the_simulated_one():
    scenario = shipped_scenario("rich")
    same = changed_record(scenario, np.random.default_rng(3), "input_gain", 1.0, 1000)
    for name, values in ev.simulate(scenario, np.random.default_rng(3)).signals.channels.items():
        np.testing.assert_allclose(same.channels[name], values, atol=1e-14)


@pytest.mark.thorough
def test_drops_are_told_and_nothing_else():
    delays = []
    for run in range(5):
        assert trial("rich", "nothing", run).alarms == 0
        delays.append(trial("rich", "input_gain", run).delay)
    assert None not in delays
    assert 0 < np.median(delays) <= 150
    # a memory that follows the friction would leave most of these untold
    assert sum(trial("rich", "viscous_friction", run).delay is not None for run in range(10)) >= 6


def test_the_command_makes_the_page_of_a_kept_study(tmp_path, capsys):
    grid, page = tmp_path / "grid.toml", tmp_path / "page.md"
    grid.write_text(
        "".join(
            f'[[records]]\nscenario = "rich"\nchanged = "{what}"\nsmall = 1\nfull = 1\n'
            for what in ("nothing", "input_gain")
        )
    )
    page.write_text("<!-- generated: recursion -->\n<!-- end: recursion -->\n")
    arguments = ["--grid", str(grid), "--kept", str(tmp_path / "kept.jsonl"), "--page", str(page)]
    main(arguments)
    table = capsys.readouterr().out
    assert "| rich | K_u | 1 |" in table
    assert table.strip() in page.read_text()
    kept = (tmp_path / "kept.jsonl").read_text()
    main(arguments)
    assert (tmp_path / "kept.jsonl").read_text() == kept
    with pytest.raises(SystemExit):
        main(["--size", "huge"])
