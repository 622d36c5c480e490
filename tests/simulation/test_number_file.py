"""A user's own series from a file beside the scenario: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from eivor.errors import InputError, ParameterError
from eivor.lab import scenario_files
from eivor.lab.records import simulate
from eivor.lab.scenario_files import read_scenario, read_study
from eivor.simulation.excitation import GivenSeries

SCENARIO = "viscous_friction = 0.293\ninput_gain = 0.021\nsamples = 60\n"
SERIES = '[excitation]\nkind = "series"\nvalues = {{ file = "{file}", column = "{column}" }}\n'
VALUES = np.random.default_rng(4).standard_normal(60)


@pytest.fixture
def series(tmp_path):
    """Scenario file that names a file, and a column of it."""

    def scenario(file: str, column: str = "u") -> Path:
        path = tmp_path / "one.toml"
        path.write_text(SCENARIO + SERIES.format(file=file, column=column), encoding="utf-8")
        return path

    return scenario


def table(**columns: object) -> pl.DataFrame:
    return pl.DataFrame({"time": np.arange(60.0), "u": VALUES} | columns)


@pytest.mark.parametrize("name", ["mine.csv", "mine.parquet", "below/mine.CSV"])
def test_column_is_the_input(series, tmp_path, name):
    (tmp_path / "below").mkdir()
    write = pl.DataFrame.write_parquet if name.endswith("parquet") else pl.DataFrame.write_csv
    write(table(), tmp_path / name)
    scenario = read_scenario(series(name))
    assert scenario.excitation == GivenSeries(tuple(VALUES.tolist()))
    truth = simulate(scenario, np.random.default_rng(0)).truth
    np.testing.assert_array_equal(truth.channel("input"), VALUES)


def test_whole_numbers_are_numbers(series, tmp_path):
    (tmp_path / "mine.csv").write_text("u, v\n" + "".join(f" {k % 2} , 0\n" for k in range(60)))
    table(u=np.arange(60)).write_parquet(tmp_path / "mine.parquet")
    assert read_scenario(series("mine.csv")).excitation == GivenSeries((0.0, 1.0) * 30)
    assert read_scenario(series("mine.parquet")).excitation == GivenSeries(tuple(map(float, range(60))))


def test_any_list_of_numbers_may_stand_in_a_file(tmp_path):
    (tmp_path / "levels.csv").write_text("level\n1\n-1\n0.5\n")
    path = tmp_path / "one.toml"
    values = 'levels = { file = "levels.csv", column = "level" }'
    path.write_text(f'{SCENARIO}[excitation]\nkind = "steps"\ndwell_s = 2\n{values}\n')
    assert read_scenario(path).excitation.levels == (1.0, -1.0, 0.5)


def test_too_short_a_series_is_told(series, tmp_path):
    table().head(59).write_csv(tmp_path / "mine.csv")
    scenario = read_scenario(series("mine.csv"))
    with pytest.raises(ParameterError, match=r"a series of 60 values or more.*received 59"):
        simulate(scenario, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("none.csv", "a file that exists at excitation.values.file of one.toml; received 'none.csv'"),
        ("../mine.csv", "beside the scenario or in a folder below it"),
        ("below/../../mine.csv", "beside the scenario or in a folder below it"),
        ("{absolute}", "beside the scenario or in a folder below it"),
        ("link.csv", "beside the scenario or in a folder below it.*received 'link.csv'"),
        ("loop.csv", "beside the scenario or in a folder below it|a file that exists"),
        ("below", "ends in .csv or .parquet"),
        ("folder.csv", "a file that exists"),
        ("mine.xlsx", "ends in .csv or .parquet"),
        ("broken.parquet", "a table as PARQUET.*'broken.parquet', which is not"),
        ("empty.csv", "a table as CSV.*'empty.csv', which is not"),
        ("ragged.csv", "a table as CSV.*'ragged.csv', which is not"),
    ],
)
def test_files_that_are_refused(series, tmp_path, file, said):
    outside = tmp_path.parent / f"{tmp_path.name}-outside.csv"
    table().write_csv(outside)
    (tmp_path / "below").mkdir()
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "link.csv").symlink_to(outside)
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    (tmp_path / "mine.xlsx").write_text("u\n1\n")
    (tmp_path / "broken.parquet").write_bytes(b"PAR1 no more")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "ragged.csv").write_text("u,v\n1,2\n3,4,5\n")
    path = series(file.format(absolute=outside))
    with pytest.raises(InputError, match=f"(?s)Expected .*{said}") as caught:
        read_scenario(path)
    assert "one.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("column", "said"),
    [
        ("U", r"a column out of time, u, .*received 'U', not in mine.csv"),
        ("word", "finite numbers in column 'word' of mine.csv.*received 'x'.*See its row 3, not"),
        ("hole", "finite numbers in column 'hole'.*received no value.*row 60"),
        ("infinite", "finite numbers in column 'infinite'.*received 'inf'.*row 1,"),
    ],
)
def test_columns_that_are_refused(series, tmp_path, column, said):
    words = ["1", "2", "x", *["4"] * 57]
    columns = {"word": words, "hole": [1.0] * 59 + [None], "infinite": [np.inf] + [1.0] * 59}
    table(**columns).write_csv(tmp_path / "mine.csv")
    with pytest.raises(InputError, match=f"(?s){said}"):
        read_scenario(series("mine.csv", column))


def test_columns_of_parquet_that_are_refused(series, tmp_path):
    holes = [1.0] * 59 + [None]
    table(flag=[True] * 60, hole=holes, nan=[np.nan] * 60).write_parquet(tmp_path / "mine.parquet")
    for column, item in (("flag", "values of Boolean"), ("hole", "no value"), ("nan", "received nan")):
        with pytest.raises(InputError, match=item):
            read_scenario(series("mine.parquet", column))


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ('{ file = "mine.csv" }', "a text in quotes at excitation.values.column.*nothing"),
        ('{ column = "u" }', "a text in quotes at excitation.values.file.*nothing"),
        ('{ file = "mine.csv", column = "u", sheet = 2 }', "the unknown key 'sheet'"),
        ('"mine.csv"', "a list of numbers or a table at excitation.values"),
    ],
)
def test_tables_that_are_refused(tmp_path, values, said):
    table().write_csv(tmp_path / "mine.csv")
    path = tmp_path / "one.toml"
    path.write_text(f'{SCENARIO}[excitation]\nkind = "series"\nvalues = {values}\n', encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_scenario(path)


def test_what_is_too_large_is_refused(series, tmp_path, monkeypatch):
    table().write_csv(tmp_path / "mine.csv")
    monkeypatch.setattr(scenario_files, "MOST_NUMBERS", 59)
    with pytest.raises(InputError, match="59 numbers or fewer"):
        read_scenario(series("mine.csv"))
    monkeypatch.setattr(scenario_files, "LARGEST_BYTES", 100)
    with pytest.raises(InputError, match="a file of 100 bytes or fewer"):
        read_scenario(series("mine.csv"))


def study_identity(folder: Path, values: str) -> str:
    path = folder / "study.toml"
    body = SCENARIO + f'excitation = {{ kind = "series", values = {values} }}\n'
    path.write_text(f'runs = 2\nseed = 1\n[scenario]\n{body}[[methods]]\nname = "least_squares"\n')
    return read_study(path).identity


def test_a_study_depends_on_the_numbers_and_not_on_the_file(tmp_path):
    table().write_csv(tmp_path / "one.csv")
    table(v=VALUES).write_parquet(tmp_path / "two.parquet")
    changed = VALUES.copy()
    changed[59] += 1e-15
    table(u=changed).write_csv(tmp_path / "three.csv")
    names = {name: f'{{ file = "{name}", column = "u" }}' for name in ("one.csv", "two.parquet", "three.csv")}
    results = {name: study_identity(tmp_path, values) for name, values in names.items()}
    assert results["one.csv"] == results["two.parquet"] == study_identity(tmp_path, str(VALUES.tolist()))
    assert results["one.csv"] == study_identity(tmp_path, '{ file = "two.parquet", column = "v" }')
    assert results["three.csv"] != results["one.csv"]


def test_a_file_of_a_scenario_that_a_study_names_is_beside_the_scenario(tmp_path):
    (tmp_path / "below").mkdir()
    table().write_csv(tmp_path / "below" / "mine.csv")
    (tmp_path / "below" / "one.toml").write_text(SCENARIO + SERIES.format(file="mine.csv", column="u"))
    (tmp_path / "study.toml").write_text(
        'runs = 2\nseed = 1\nscenario = "below/one.toml"\n[[methods]]\nname = "least_squares"\n'
    )
    assert read_study(tmp_path / "study.toml").experiment.scenario.excitation.values[:2] == tuple(VALUES[:2])
