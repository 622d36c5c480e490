"""What a run has to do, by the logs that it is given and the rows that are there."""

from __future__ import annotations

import hashlib

import polars as pl

from eivor.fleet.logs import Log, LogList
from eivor.fleet.run import Work, share_of, without_report, work_of
from eivor.fleet.table import KEY_COLUMNS, SHARES


def sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def log(name: str, content: str = "") -> Log:
    return Log(f"/logs/{name}", name, {"tail": "N1"}, sha256(content) if content else "")


def rows(*record: tuple[str, str, str]) -> pl.DataFrame:
    known = [(name, sha256(content) if content else None, verdict) for name, content, verdict in record]
    return pl.DataFrame(known, schema=dict.fromkeys(KEY_COLUMNS, pl.String), orient="row")


def work(logs: list[Log], there: pl.DataFrame) -> Work:
    return work_of(LogList.of(logs).table, there)


def test_logs_are_in_the_order_of_their_names_and_once():
    paths = ("b/é.ulg", "a.ulg", "b/z.ulg", "b.ulg", "a.ulg", "\U0001f681")
    logs = LogList.of(Log(f"/{index}", name, {}) for index, name in enumerate(paths))
    assert [item.name for item in logs] == sorted(set(paths))
    assert next(iter(logs)).path == "/4"
    assert [len(page) for page in logs.pages(2)] == [2, 2, 1]
    assert len(logs) == 5
    assert (len(LogList.of([])), list(LogList.of([]))) == (0, [])


def test_a_path_that_is_no_text_stays_as_it_is():
    (log_list,) = LogList.of([Log("/\udcff.ulg", "x", {"a": "\n"})])
    assert (log_list.path, log_list.metadata, log_list.sha256) == ("/\udcff.ulg", {"a": "\n"}, "")


def test_the_numbers_are_of_the_row_that_is_there_else_of_the_first_by_name():
    logs = [log("c", "one"), log("a", "one"), log("b", "two"), log("d", "two"), log("e", "three"), log("f")]
    there = rows(("gone", "two", "weak"), ("b", "two", "copy"), ("e", "three", "failed"), ("x", "", "failed"))
    result = work(logs, there)
    assert result.identify["name"].to_list() == ["a"]
    assert result.copies.select("name", "first").rows() == [("c", "a"), ("d", "gone")]
    assert result.opened.height == 5


def test_a_log_of_another_content_under_an_old_name_is_another_log():
    result = work([log("a", "new"), log("b", "old")], rows(("a", "old", "weak")))
    assert result.identify["name"].to_list() == ["a"]
    assert result.copies["name"].to_list() == ["b"]


def test_nothing_is_to_be_done_with_logs_that_have_rows():
    result = work([log("a", "one"), log("b", "one")], rows(("a", "one", "weak"), ("b", "one", "copy")))
    assert (result.opened.height, result.identify.height, result.copies.height) == (2, 0, 0)


def test_logs_that_cannot_be_opened_are_spread_over_all_shares():
    assert {share_of(f"{number}") for number in range(2000)} == set(range(SHARES))
    assert share_of("a.ulg") == 6


def test_reports_are_wanted_of_results_that_have_none():
    logs = LogList.of(log(name, name) for name in "abcd").table
    there = rows(("a", "a", "weak"), ("b", "b", "failed"), ("c", "c", "identified"), ("d", "x", "weak"))
    assert without_report(logs, there, [sha256("a")])["name"].to_list() == ["c"]
    assert without_report(logs, there, [])["name"].to_list() == ["a", "c"]
