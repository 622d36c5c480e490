"""The study of fractional difference equations: reduced, and at a size that tells coverage."""

import numpy as np
import pytest

from eivor.lab.experiments import marks
from validation.fractional.study import PART, Cell, Relaxation, answers, formulas, main, sharper_ways

COMPENSATED = ("total_least_squares", "bias_compensated_least_squares", "generalized_iv")
ORDER_PLACE = -1


@pytest.mark.thorough
@pytest.mark.parametrize("scenario", [Relaxation(), Cell()], ids=lambda scenario: scenario.name)
def test_orders_are_within_a_hundredth_at_40_db(scenario):
    errors = answers(scenario, formulas()["total_least_squares"], range(3))[:, ORDER_PLACE, 0]
    assert errors.size == 3
    assert np.abs(errors).max() < 0.01


@pytest.mark.thorough
def test_the_cells_order_by_least_squares_is_wrong_and_its_interval_does_not_say_so():
    answer = answers(Cell(), formulas()["least_squares"], range(3))[:, ORDER_PLACE]
    assert (answer[:, 0] < -0.03).all()
    assert not answer[:, 1].any()


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["bias_compensated_least_squares, again", "generalized_iv, far"])
def test_the_cells_order_is_within_a_hundredth_by_other_methods_too(name):
    errors = answers(Cell(), sharper_ways()[name], range(4))[:, ORDER_PLACE, 0]
    assert errors.size == 4
    assert np.abs(errors).max() < 0.006


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_intervals_of_the_cell_cover_by_the_papers_method():
    """24 runs: of 95 % intervals fewer than 18 cover once in ten thousand times."""
    result = answers(Cell(), sharper_ways()["generalized_iv, far"], range(24))
    assert len(result) == 24
    assert result[:, :, 1].sum(axis=0).min() >= 18


@pytest.mark.long
@pytest.mark.parametrize("name", COMPENSATED)
@pytest.mark.parametrize("scenario", [Relaxation(), Cell()], ids=lambda scenario: scenario.name)
@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_intervals_cover(scenario, name):
    """60 runs: of 95 % intervals fewer than 51 cover once in ten thousand times."""
    result = answers(scenario, formulas()[name], range(60))
    assert len(result) == 60
    assert result[:, :, 1].sum(axis=0).min() >= 51


def test_a_page_has_the_tables(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("validation.fractional.study.SCENARIOS", (Relaxation(),))
    monkeypatch.setattr(
        "validation.fractional.study.formulas",
        lambda: {"total_least_squares": formulas()["total_least_squares"]},
    )
    page = tmp_path / "page.md"
    begin, end = marks(PART)
    page.write_text(f"# Before\n\n{begin}\n{end}\n\nAfter.\n", encoding="utf-8")
    assert main(["--runs", "1", "--page", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert "| `total_least_squares` | 1 | `output_coefficient_2` | 8 |" in text
    assert text.startswith("# Before")
    assert "relaxation" in capsys.readouterr().out
