"""`eivor report` and `eivor identify --html`: the page is written, over nothing that is read."""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path

import pytest

from eivor.cli.identify import identify, report

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


def embedded(page: Path) -> dict:
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="result">(.*?)</script>', text)[1])


def test_a_report_is_what_identify_finds(eivor, log, tmp_path):
    page, path = tmp_path / "flight.html", tmp_path / "flight.json"
    reported = eivor("report", log, "-o", page)
    other = eivor("identify", log, "--json", path, "--html", tmp_path / "other.html")
    assert reported.code == other.code == 0
    assert "IDENTIFIED" in reported.out
    assert str(page) in re.sub(r"\s", "", reported.out)
    assert embedded(page) == json.loads(path.read_text()) == embedded(tmp_path / "other.html")
    assert page.read_bytes() == (tmp_path / "other.html").read_bytes()


@pytest.mark.thorough
def test_a_refusal_is_a_report_too(eivor, log, tmp_path):
    page = tmp_path / "flight.html"
    assert eivor("report", log, "--window", "0:4", "-o", page).code == 3
    assert embedded(page)["verdict"] != "identified"


def test_a_report_on_standard_output_is_nothing_else(eivor, log):
    reported = eivor("report", log, "--window", "0:4", "-o", "-")
    assert reported.out.startswith("<!DOCTYPE html>")
    assert reported.out.endswith("</html>\n")


@pytest.mark.parametrize("arguments", [("report", "-o"), ("identify", "--html")])
def test_a_report_is_written_over_no_log(eivor, log, arguments):
    command, option = arguments
    before = log.read_bytes()
    reported = eivor(command, log, option, log)
    assert reported.code == 2
    assert "would replace" in reported.err
    assert log.read_bytes() == before


def test_a_report_needs_a_file(eivor, log):
    reported = eivor("report", log)
    assert reported.code == 2
    assert "-o flight.html" in reported.err


def test_a_log_that_cannot_be_read_gives_a_sentence_and_no_page(eivor, tmp_path):
    broken, page = tmp_path / "broken.ulg", tmp_path / "flight.html"
    broken.write_bytes(b"ULog\x01\x12\x35 nothing")
    reported = eivor("report", broken, "-o", page)
    assert reported.code == 1
    assert reported.err.startswith("eivor: ")
    assert not page.exists()


def test_a_report_takes_what_identify_takes():
    current, known = (inspect.signature(item).parameters for item in (report, identify))
    assert set(current) - {"out"} == set(known) - {"json", "figure", "html", "card"}
