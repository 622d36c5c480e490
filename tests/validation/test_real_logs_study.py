"""The study of logs as they are: its grid, its rows in a folder, what it requires, and its command."""

from __future__ import annotations

import dataclasses

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from eivor.errors import InputError
from eivor.lab.experiments import marks
from validation.flight_recipe.trials import QUANTITIES
from validation.real_logs import study
from validation.real_logs.study import PART, far_off, hover_sentence, requirements
from validation.real_logs.trials import (
    NAMES,
    family_tasks,
    folder_of,
    grid_from,
    interleaved,
    published_grid,
)
from validation.studies import StudyFolder, read_study_table

GRID = published_grid()


@pytest.mark.parametrize(
    "family", [family for family in GRID.families if family.frequencies], ids=lambda item: item.name
)
def test_flights_of_a_pool_share_the_vehicle_and_not_the_wind(family):
    specs = [family.flight(number) for number in range(12)]
    first, second = specs[:6], specs[6:]
    assert len({(spec.vehicle.actuator_lag, spec.vehicle.hover_input) for spec in first}) == 1
    assert first[0].vehicle.actuator_lag != second[0].vehicle.actuator_lag
    assert len({spec.vehicle.viscous_friction for spec in first}) == 6
    assert {spec.frequency for spec in first} == set(family.frequencies)


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("flights = 170", "flights = 170.5", "Expected `int`, got `float` - at `$.family[1].flights`"),
        ("seed = 1200000", "seed = 1100001", "families with names and seeds of their own"),
        ("thrust_power = 1.0", "thrust_might = 1.0", "keys of a flight; received thrust_might"),
        ('holds = "short"', 'holds = "perhaps"', "Invalid enum value 'perhaps' - at `$.family["),
    ],
)
def test_damaged_grid_is_refused(before, after, expected):
    assert before in GRID.text
    with pytest.raises(InputError) as caught:
        grid_from(GRID.text.replace(before, after, 1))
    assert expected in str(caught.value)


def test_a_run_cut_short_has_flown_the_same_share_of_each_family():
    tasks = interleaved(GRID.families)
    assert len(tasks) == sum(len(family_tasks(family)) for family in GRID.families)
    half = tasks[: len(tasks) // 2]
    share = half[-1].first / GRID.family(half[-1].family).count
    assert 0.4 < share < 0.6
    for family in GRID.families:
        done = sum(task.last - task.first for task in half if task.family == family.name)
        largest = max(task.last - task.first for task in family_tasks(family))
        assert share * family.count <= done <= share * family.count + largest


def rows(count: int, family: str, **columns) -> pl.DataFrame:
    """Rows of accepted flights whose intervals hold the truth."""
    results: dict[str, object] = {
        "class": [family] * count,
        "number": np.arange(count),
        "verdict": ["identified"] * count,
    }
    for name in QUANTITIES:
        results |= {f"truth.{name}": 1.0, f"recipe.{name}.value": 1.0, f"verdict.{name}": "identified"}
        results |= {f"recipe.{name}.low": 0.9, f"recipe.{name}.high": 1.1}
    results |= {f"named.{name}": False for name in NAMES} | columns
    results |= {"recipe.first_stage_F": 100.0, "recipe.p_value": 0.5}
    return pl.DataFrame(
        {
            name: results[name] if isinstance(results[name], list | np.ndarray) else [results[name]] * count
            for name in results
        }
    )


def unmet(table: pl.DataFrame) -> list[str]:
    return [item.what for item in requirements(table, GRID) if not item.met]


def test_coverage_and_bias_are_required_of_families_that_the_model_holds():
    name = "gusts of .5 to 1 m/s"
    truth = np.where(np.arange(200) % 20 == 0, 1.15, 1.0)
    table = rows(200, name, **{f"truth.{quantity}": truth for quantity in QUANTITIES})
    assert unmet(table) == [f"{name}: mean error of the lag"]
    right = table.with_columns(pl.col("truth.effective_lag") * 0 + 1.0)
    right = right.with_columns(
        pl.Series("truth.effective_lag", np.where(np.arange(200) % 40 == 0, 1.02, 1.0))
    )
    assert f"{name}: mean error of the lag" not in unmet(right)
    worse = rows(200, name, **{"truth.viscous_friction": np.where(np.arange(200) % 5 == 0, 1.15, 1.0)})
    assert f"{name}: coverage of K" in unmet(worse)
    assert f"{name}: accepted flights" in unmet(worse.head(100))


def test_what_must_be_said_is_counted():
    name = "velocity scaled by 1.05"
    sentence = rows(10, name, **{"named.velocity reads more": [True] * 8 + [False] * 2})
    assert unmet(sentence.with_columns()) == unmet(
        rows(0, name)
    ) or f"{name}: named: velocity reads more" not in unmet(sentence)
    silent = rows(10, name, **{"named.velocity reads more": [True] * 7 + [False] * 3})
    assert f"{name}: named: velocity reads more" in unmet(silent)


def test_an_interval_far_off_counts_only_where_it_is_called_identified():
    table = rows(10, "300 s", **{"truth.input_gain": [1.25] + [1.15] * 9})
    assert (far_off(table).hits, far_off(table).count) == (1, 10)
    weak = table.with_columns(pl.lit("weak").alias("verdict.input_gain"))
    assert far_off(weak).hits == 0


def test_no_drag_is_never_identified():
    name = "no drag, velocity of an estimator"
    assert unmet(rows(3, name))[0] == f"{name}: identified"
    refused = rows(3, name, verdict=["weak", "refused", "weak"])
    assert f"{name}: identified" not in unmet(refused)


def test_pools_are_judged_by_their_lag():
    name = "pools with two reference frequencies"
    narrow = {"recipe.effective_lag.low": 0.98, "recipe.effective_lag.high": 1.015}
    assert f"{name}: half-width of the lag in the median" not in unmet(rows(12, name, **narrow))
    assert f"{name}: half-width of the lag in the median" in unmet(rows(12, name))


def test_pools_with_two_frequencies_are_judged_together_too():
    first, second = "pools with two reference frequencies", "pools with two quicker reference frequencies"
    wide = rows(12, first)
    narrow = rows(24, second, **{"recipe.effective_lag.low": 0.98, "recipe.effective_lag.high": 1.015})
    together = "all pools with two reference frequencies: half-width of the lag in the median"
    (selected,) = [item for item in requirements(pl.concat([wide, narrow]), GRID) if item.what == together]
    assert (selected.measured, selected.met) == ("17.5 ms of 6 pools", True)
    assert together not in [item.what for item in requirements(wide, GRID)]
    assert together in unmet(pl.concat([wide, narrow.head(6)]))


def test_the_hover_inputs_errors_stand_beside_the_floor():
    table = rows(20, "30 s", **{"truth.hover_input": [1.0] * 19 + [1.001]})
    (sentence,) = hover_sentence(table, GRID)
    assert "by 0.100% at most" in sentence
    assert not hover_sentence(rows(3, "voltage sags by 10 %, logged"), GRID)


def test_rows_are_kept_and_a_run_goes_on(tmp_path):
    """The rows of two tasks in a folder; a damaged one is done again, and the table is the same again."""
    families = tuple(replace(family, count=1) for family in GRID.families[:2])
    made = []

    def trial(task):
        made.append(task.family)
        return tuple(rows(1, task.family).to_dicts())

    study = folder_of(tmp_path / "study", replace(GRID, families=families))
    folder = dataclasses.replace(study, rows_of=trial)
    folder.run(1)
    before = folder.gathered()
    assert made == [family.name for family in families]
    victim = sorted((tmp_path / "study").iterdir())[1]
    victim.write_bytes(victim.read_bytes()[:-9])
    folder.run(1)
    assert made[2:] == [families[1].name]
    assert folder.gathered().rows.equals(before.rows)
    assert before.origin["flights"] == "2 of 2"
    before.write(tmp_path / "all.parquet")
    read = read_study_table(tmp_path / "all.parquet")
    assert read.rows["class"].to_list() == made[:2]
    assert read.origin == before.origin
    (tmp_path / "all.parquet").write_bytes(b"other")
    with pytest.raises(InputError, match="a table of the study"):
        read_study_table(tmp_path / "all.parquet")


@pytest.mark.thorough
def test_command_flies_a_family_and_fills_the_page(tmp_path, capsys, monkeypatch):
    """One short flight from its specification to the tables."""
    (short,) = [family for family in GRID.families if family.holds == "short"]
    grid = replace(GRID, families=(replace(short, count=1),))
    monkeypatch.setattr(study, "published_grid", lambda: grid)
    begin, end = marks(PART)
    page = tmp_path / "page.md"
    page.write_text(f"# Page\n\n{begin}\n{end}\n", encoding="utf-8")
    chosen = ["--folder", str(tmp_path / "rows"), "--workers", "1", "--page", str(page)]
    assert study.main(chosen) == 3
    printed = capsys.readouterr().out
    assert "| 15 s | 1 | " in printed
    assert "| 15 s: coverage of K | at least 0.9, or weak |" in printed
    assert printed.strip() in page.read_text(encoding="utf-8")
    (row,) = folder_of(tmp_path / "rows", grid).gathered().rows.to_dicts()
    vehicle = short.flight(0).vehicle
    assert row["truth.effective_lag"] == pytest.approx(vehicle.actuator_lag + vehicle.delay)
    assert row["truth.viscous_friction"] == pytest.approx(vehicle.viscous_friction, rel=0.01)
    monkeypatch.setattr(StudyFolder, "run", None)
    assert study.main([*chosen, "--tables"]) == 3
    assert capsys.readouterr().out == printed
    assert study.main(["--folder", str(tmp_path / "none"), "--tables"]) == 2


@pytest.mark.calibration
def test_small_size(tmp_path):
    """A few flights of the families of clocks: accepted, and few intervals miss."""
    grid = study.part_of(GRID, 0.025, "r")
    families = tuple(
        family
        for family in grid.families
        if family.holds == "yes" and family.flight(0).duration < 100.0 and not family.flight(0).multirotor
    )
    folder = folder_of(tmp_path, replace(grid, families=families[:3]))
    folder.run(1)
    table = folder.gathered().rows
    assert table.height >= 12
    assert (table["verdict"] == "identified").mean() > 0.6
    assert far_off(table).value < 0.2
