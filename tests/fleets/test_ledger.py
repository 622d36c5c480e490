"""What a run knows of each log is on disk: what it says, and that it takes no memory."""

from __future__ import annotations

import gc
import hashlib
import sqlite3
import tracemalloc
from dataclasses import replace

import polars as pl
import pytest

from eivor.errors import InputError
from eivor.fleet import logs
from eivor.fleet.logs import Log, LogList, logs_found
from eivor.fleet.table import SHARES, Ledger, Task, share_of


def sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def log(name: str, content: str = "") -> Log:
    return Log(f"/logs/{name}", name, {"tail": "N1"}, sha256(content) if content else "")


def rows(*record: tuple[str, str, str]) -> pl.DataFrame:
    columns = ("name", "sha256", "verdict")
    return pl.DataFrame(
        [(name, sha256(content) if content else None, verdict) for name, content, verdict in record],
        schema=dict.fromkeys(columns, pl.String),
        orient="row",
    )


def ledger_of(*logs: Log) -> Ledger:
    ledger = Ledger(LogList(replace(item, sha256="") for item in logs))
    ledger.note(logs)
    return ledger


def names(pages) -> list[str]:
    return [item.name for page in pages for item in page]


def test_logs_are_in_the_order_of_their_names_and_once():
    paths = ("b/é.ulg", "a.ulg", "b/z.ulg", "b.ulg", "a.ulg", "\U0001f681")
    logs = LogList(Log(f"/{index}", name, {}) for index, name in enumerate(paths))
    assert [item.name for item in logs] == sorted(set(paths))
    assert next(iter(logs)).path == "/4"
    assert names(logs.pages("SELECT * FROM logs WHERE name > ? ORDER BY name LIMIT ?", size=2)) == sorted(
        set(paths)
    )


def test_a_path_that_is_no_text_stays_as_it_is():
    (log_list,) = LogList([Log("/\udcff.ulg", "x", {"a": "\n"})])
    assert (log_list.path, log_list.metadata) == ("/\udcff.ulg", {"a": "\n"})


def test_the_numbers_are_of_the_row_that_is_there_else_of_the_first_by_name():
    ledger = ledger_of(log("c", "one"), log("a", "one"), log("b", "two"), log("d", "two"), log("e", "three"))
    ledger.take_rows([rows(("gone", "two", "weak"), ("b", "two", "copy")), rows(("e", "three", "failed"))])
    ledger.settle()
    assert names(ledger.of_task(Task.IDENTIFY)) == ["a"]
    assert [(item.name, ledger.first(item)) for page in ledger.of_task(Task.TELL_COPY) for item in page] == [
        ("c", "a"),
        ("d", "gone"),
    ]
    assert (ledger.opened(), ledger.rows(), ledger.verdicts()) == (5, 3, {"copy": 1, "failed": 1})


def test_a_log_of_another_content_under_an_old_name_is_another_log():
    ledger = ledger_of(log("a", "new"), log("b", "old"))
    ledger.take_rows([rows(("a", "old", "weak"))])
    ledger.settle()
    assert names(ledger.of_task(Task.IDENTIFY)) == ["a"]
    assert names(ledger.of_task(Task.TELL_COPY)) == ["b"]


def test_logs_that_cannot_be_opened_are_in_the_share_of_their_name():
    given = [log(f"{number}") for number in range(200)]
    ledger = ledger_of(*given, log("a", "one"))
    results = [[item.name for item in ledger.unopened(share)] for share in range(SHARES)]
    assert sorted(name for some in results for name in some) == sorted(item.name for item in given)
    assert all(share_of(name) == share for share, some in enumerate(results) for name in some)
    assert (ledger.has("7"), ledger.has("nobody"), ledger.opened()) == (True, False, 1)


def test_reports_are_wanted_of_results_that_have_none():
    ledger = ledger_of(*(log(name, name) for name in "abcd"))
    ledger.take_rows(
        [rows(("a", "a", "weak"), ("b", "b", "failed"), ("c", "c", "identified"), ("d", "x", "weak"))]
    )
    ledger.settle_reports([sha256("a")])
    assert names(ledger.of_task(Task.REPORT)) == ["c"]


def test_a_second_run_over_the_same_list_begins_anew():
    logs = LogList([log("a"), log("b")])
    first = Ledger(logs)
    first.note([log("a", "one"), log("b")])
    first.take_rows([rows(("a", "one", "weak"))])
    again = Ledger(logs)
    assert (again.opened(), again.rows(), list(again.unopened(share_of("b")))) == (0, 0, [])


def peak(count: int) -> int:
    """Largest memory of Python's objects while a ledger of so many logs is made and gone through [bytes]."""
    gc.collect()
    tracemalloc.start()
    try:
        contents = {number: sha256(str(number // 2)) for number in range(2)}
        ledger = Ledger(LogList(log(f"vehicle/{number}.ulg") for number in range(count)))
        for page in ledger.logs():
            ledger.note([replace(item, sha256=contents[len(item.name) % 2]) for item in page])
        ledger.take_rows(rows((f"vehicle/{number}.ulg", "x", "copy")) for number in range(0, count, 50))
        ledger.settle()
        assert sum(len(page) for page in ledger.of_task(Task.TELL_COPY)) > count / 2
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_logs():
    peak(100)  # what is loaded once
    assert peak(3_600) < peak(1_200) + 100 * 2_400  # pages of logs that wait to be freed come and go


def test_no_room_for_the_list_is_told(tmp_path, monkeypatch):
    for number in range(200):
        (tmp_path / f"{number}.ulg").touch()

    def small(*given, **choices):
        connection = sqlite3.connect(*given, **choices)
        connection.execute("PRAGMA max_page_count = 3")
        return connection

    class Small:
        connect = staticmethod(small)
        OperationalError = sqlite3.OperationalError

    monkeypatch.setattr(logs, "sqlite3", Small)
    with pytest.raises(InputError, match=r"room for the list of the logs.*disk is full.*TMPDIR=FOLDER"):
        logs_found(str(tmp_path))
