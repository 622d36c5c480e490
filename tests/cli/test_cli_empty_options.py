"""An option that is nothing by default and was given as nothing: `--lag "$LAG"` where LAG was never set."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

Caller = Callable[..., Any]


@pytest.mark.parametrize(
    "option",
    ["--lag", "--lag-from", "--window", "--input", "--input-map", "--map", "--json", "--figure", "--html"],
)
def test_an_empty_option_is_not_passed_over(eivor: Caller, option: str) -> None:
    run = eivor("identify", "--example", option, "")
    assert run.code == 2
    assert run.out == ""
    assert f"Expected a value for {option}; received an empty text." in run.err
    assert run.err.rstrip().endswith("or leave it out.")


def test_of_the_group_and_of_a_file(eivor: Caller, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "a value for --config" in eivor("--config", "", "identify", "--example").err
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eivor.toml").write_text('[identify]\nlag = ""\n')
    run = eivor("identify", "--example")
    assert (run.code, run.out) == (2, "")
    assert "a value for --lag" in run.err


def test_options_with_words_of_their_own_keep_them(eivor: Caller) -> None:
    assert "a method out of reference_iv" in eivor("identify", "--example", "--method", "").err
    assert "terms out of" in eivor("identify", "--example", "--term", "").err
