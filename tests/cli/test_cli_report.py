"""`eivor report` and `eivor identify --html`: the page is written, over nothing that is read."""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path

import pytest

from eivor.cli.identify import NOT_HERE, identify, report

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


def embedded(page: Path) -> dict:
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="result">(.*?)</script>', text)[1])


def test_a_report_is_what_identify_finds(eivor, log, tmp_path):
    page, beside = tmp_path / "flight.html", tmp_path / "flight.json"
    told = eivor("report", log, "-o", page)
    other = eivor("identify", log, "--json", beside, "--html", tmp_path / "other.html")
    assert told.code == other.code == 0
    assert "IDENTIFIED" in told.out
    assert str(page) in re.sub(r"\s", "", told.out)
    assert embedded(page) == json.loads(beside.read_text()) == embedded(tmp_path / "other.html")
    assert page.read_bytes() == (tmp_path / "other.html").read_bytes()


@pytest.mark.thorough
def test_a_refusal_is_a_report_too(eivor, log, tmp_path):
    page = tmp_path / "flight.html"
    assert eivor("report", log, "--window", "0:4", "-o", page).code == 3
    assert embedded(page)["verdict"] != "identified"


def test_a_report_on_standard_output_is_nothing_else(eivor, log):
    told = eivor("report", log, "--window", "0:4", "-o", "-")
    assert told.out.startswith("<!DOCTYPE html>")
    assert told.out.endswith("</html>\n")


@pytest.mark.parametrize("arguments", [("report", "-o"), ("identify", "--html")])
def test_a_report_is_written_over_no_log(eivor, log, arguments):
    command, option = arguments
    before = log.read_bytes()
    told = eivor(command, log, option, log)
    assert told.code == 2
    assert "would replace" in told.err
    assert log.read_bytes() == before


def test_a_report_needs_a_file(eivor, log):
    told = eivor("report", log)
    assert told.code == 2
    assert "-o flight.html" in told.err


def test_a_log_that_cannot_be_read_gives_a_sentence_and_no_page(eivor, tmp_path):
    broken, page = tmp_path / "broken.ulg", tmp_path / "flight.html"
    broken.write_bytes(b"ULog\x01\x12\x35 nothing")
    told = eivor("report", broken, "-o", page)
    assert told.code == 1
    assert told.err.startswith("eivor: ")
    assert not page.exists()


def test_a_report_takes_what_identify_takes():
    own, known = (inspect.signature(one).parameters for one in (report, identify))
    assert set(own) - {"out"} == set(known) - set(NOT_HERE)
