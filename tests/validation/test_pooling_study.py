"""The study of pooling at a reduced size, and its table."""

from __future__ import annotations

import pytest

from validation.pooling.study import cell, main


@pytest.mark.parametrize(("flights", "heterogeneity"), [(4, 0.05), (10, 0.02)])
def test_intervals_hold_and_those_of_others_do_not(flights, heterogeneity):
    reported = cell(flights, heterogeneity, 1000, (0.01, 0.05))
    assert reported.mean >= 0.93
    assert reported.following >= 0.90
    assert reported.fixed < reported.moments < reported.mean
    assert reported.spread == pytest.approx(0.95, abs=0.03)
    assert cell(flights, heterogeneity, 1000, (0.01, 0.05)) == reported


def test_the_plain_prediction_is_short_where_heterogeneity_and_errors_are_alike():
    reported = cell(10, 0.02, 1000, (0.01, 0.05))
    assert reported.plain < 0.88 < reported.following
    assert reported.wider > 1.1


def test_the_command_makes_the_page_of_a_kept_study(tmp_path, capsys):
    grid, page, kept = (tmp_path / name for name in ("grid.toml", "page.md", "kept.jsonl"))
    grid.write_text(
        "flights = [4]\nheterogeneity = [0.0, 0.05]\nstd_errors = [0.01, 0.05]\nsmall = 40\nfull = 50\n"
    )
    page.write_text("<!-- generated: pooling -->\n<!-- end: pooling -->\n")
    arguments = ["--grid", str(grid), "--kept", str(kept), "--page", str(page)]
    main(arguments)
    table = capsys.readouterr().out
    assert "| 4 | 0.05 |" in table
    assert table.strip() in page.read_text()
    lines = kept.read_text()
    main(arguments)
    assert kept.read_text() == lines
