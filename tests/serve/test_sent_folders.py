"""A log that is a folder is sent as one: its files are kept beside each other, under plain names."""

from __future__ import annotations

import re
import socket
from importlib import resources

import pytest

from eivor.serve.jobs import Begin
from eivor.serve.requests import MOST_FILES, RefusedError, plain_name, sent_files
from eivor.serve.worker import outcome_of
from serve.conftest import wait_for


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("flight_1_vehicle_attitude_0.csv", "flight_1_vehicle_attitude_0.csv"),
        ("../../etc/passwd", "passwd"),
        ("..\\boot.ini", "boot.ini"),
        ("..", "_.."),
        (".hidden", "_.hidden"),
        ("", "_"),
        ("a\0b\u202e<c>:d*.db3", "a_b__c__d_.db3"),
        ("ä" * 10_000 + ".csv", "_" * 116 + ".csv"),
    ],
)
def test_a_name_in_a_folder_is_plain(name, plain):
    assert plain_name(name) == plain


@pytest.mark.parametrize(
    "header",
    [
        "a.csv",
        "a.csv/5",
        "a.csv/-1 b.csv/4",
        "a.csv/3  ",
        "a.csv/1 A.csv/2",
        "/3",
        "../a/3",
        "a.csv/2 %2fa.csv/1",
    ],
)
def test_what_are_no_files_of_a_folder(header):
    with pytest.raises(RefusedError, match="files of a folder"):
        sent_files(header, 3)


def test_more_files_than_a_folder_may_have():
    every = [f"{number}.csv/1" for number in range(MOST_FILES + 1)]
    assert len(sent_files(" ".join(every[1:]), MOST_FILES)) == MOST_FILES
    with pytest.raises(RefusedError, match=f"at most {MOST_FILES} files"):
        sent_files(" ".join(every), MOST_FILES + 1)


def test_its_files_are_kept_and_deleted_with_it(page):
    files = {"a_0.db3": b"123", "metadata.yaml": b"", "..%2Fb%3C_1.db3": b"4567"}
    text = " ".join(f"{name}/{len(content)}" for name, content in files.items())
    body = b"".join(files.values())
    log = page.json("POST", "/logs", body, x_eivor_name="my%2Fbag", x_eivor_files=text)
    assert (log["name"], log["bytes"]) == ("bag", 7)
    folder = page.server.folder / "logs" / log["log"]
    kept = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert kept == {"a_0.db3": b"123", "metadata.yaml": b"", "b__1.db3": b"4567"}
    assert folder.stat().st_mode & 0o077 == 0
    page.json("DELETE", f"/logs/{log['log']}")
    assert not folder.exists()
    assert page.refused("POST", "/logs", body, x_eivor_files="a/1")[0] == 400
    assert page.refused("POST", "/logs", bytes(1001), x_eivor_files="a/1001")[0] == 413


def test_a_folder_that_breaks_off_leaves_nothing(page):
    before = set(page.server.folder.rglob("*"))
    with socket.create_connection(("127.0.0.1", page.server.port)) as line:
        line.sendall(
            f"POST /logs HTTP/1.1\r\nHost: 127.0.0.1:{page.server.port}\r\nX-Eivor-Files: a/3 b/9\r\n"
            f"X-Eivor-Token: {page.server.token}\r\nContent-Length: 12\r\n\r\nabcd".encode()
        )
        wait_for(lambda: page.server.logs._coming > 0)
    wait_for(lambda: set(page.server.folder.rglob("*")) == before)


def test_the_example_is_kept_as_if_it_was_dropped(opening):
    page = opening(largest=10**6)
    log = page.json("POST", "/example", {})
    (kept,) = page.server.folder.glob(f"logs/{log['log']}*")
    assert kept.name == f"{log['log']}.parquet"
    assert kept.read_bytes() == resources.files("eivor.data").joinpath(log["name"]).read_bytes()


@pytest.mark.thorough
def test_the_page_is_told_which_files_of_folders_are_logs():
    outcome = outcome_of(Begin(), lambda _report: None)
    assert isinstance(outcome, dict)
    folders = outcome["folders"]
    assert {".ulg", ".bin", ".mcap", ".parquet", ".csv"} <= set(folders["endings"])
    assert {".db3", ".mcap"} <= set(folders["bags"])
    assert re.fullmatch(folders["tables"], "my_log_sensor_combined_0.csv")[1] == "my_log"
    assert re.fullmatch(folders["tables"], "flight.csv") is None
