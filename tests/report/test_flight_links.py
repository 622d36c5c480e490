"""Links from a fleet's page to the reports of its flights."""

from __future__ import annotations

from pathlib import Path

import pytest

from eivor.fleet.report import flight_links, linked
from eivor.fleet.table import write_report

HASH = "0123456789abcdef" * 4


@pytest.mark.parametrize(
    ("page", "address"),
    [
        ("report.html", f"my%20fleet/reports/{HASH}.html"),
        ("my fleet/report.html", f"reports/{HASH}.html"),
        ("pages/report.html", f"../my%20fleet/reports/{HASH}.html"),
    ],
)
def test_addresses_are_relative_to_the_page_and_say_the_hash_alone(
    tmp_path: Path, page: str, address: str
) -> None:
    folder = tmp_path / "my fleet"
    folder.mkdir()
    assert flight_links(folder, tmp_path / page) == {}
    write_report(folder, HASH, "a page")
    (folder / "reports" / "javascript:alert(1).html").write_text("somebody else's")
    assert flight_links(folder, tmp_path / page) == {HASH: address}


def test_a_flight_without_a_report_says_so_where_others_have_one() -> None:
    assert linked("a.ulg", HASH, {HASH: "there"}).link == "there"
    assert linked("a.ulg", "", {HASH: "there"}).below == "no report of its own"
    assert linked("a.ulg", HASH, {}).below == ""
