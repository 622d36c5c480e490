"""The study of wrong orders: what it asks can fail, and its page comes of what it kept."""

from __future__ import annotations

import json

import pytest

from validation.efficiency.wrong_orders import main, trial


@pytest.mark.thorough
def test_the_likelihood_is_biased_by_wrong_orders_and_spectral_giv_is_not():
    errors = [trial("rich-high", 4000, run).errors for run in range(3)]
    likelihood, spectral = (
        sum(error[name][0] for error in errors) / len(errors) for name in ("whittle_ml", "spectral_giv")
    )
    assert likelihood < -0.03
    assert abs(spectral) < 0.02


@pytest.mark.thorough
def test_the_page_comes_of_what_was_kept(tmp_path, capsys):
    grid, page, kept = tmp_path / "grid.toml", tmp_path / "page.md", tmp_path / "kept.jsonl"
    grid.write_text('scenarios = ["rich"]\nsamples = 500\nsmall = 2\nfull = 2\n')
    page.write_text("<!-- generated: wrong-orders -->\n<!-- end: wrong-orders -->\n")
    arguments = ["--grid", str(grid), "--kept", str(kept), "--page", str(page)]
    main(arguments)
    assert "| rich |" in page.read_text()
    lines = [json.loads(line) for line in kept.read_text().splitlines()]
    for line in lines:
        line["errors"]["spectral_giv"] = [0.5, 0.5]
    kept.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert main(arguments) == 3
    assert "50" in capsys.readouterr().out
