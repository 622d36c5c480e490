"""The page of `eivor serve` in a real browser, with its server: from a log to a verdict."""

from __future__ import annotations

import base64
import json
import os
import signal
import time
from contextlib import suppress
from functools import partial
from importlib import resources
from pathlib import Path

import polars as pl
import pytest

import eivor as ev
from eivor.report.flight import card_entries, result_card
from eivor.serve.app import ServeOptions, Server

pytestmark = pytest.mark.thorough

LOOKS = (Path(__file__).parent / "looks.js").read_text(encoding="utf-8")
HOSTILE = f"</script><script>alert(1)</script><img src=x onerror=alert(2)>\u202e\u2066{10_000 * 'W'}.csv"
#: Shows everything that unfolds.
UNFOLD = "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
#: Drops files as a hand would, with their names and their bytes in base64.
DROP = """(files) => {
    const carried = new DataTransfer();
    for (const [name, bytes] of files) {
        carried.items.add(new File([Uint8Array.from(atob(bytes), (one) => one.charCodeAt(0))], name));
    }
    const how = { dataTransfer: carried, bubbles: true, cancelable: true };
    document.body.dispatchEvent(new DragEvent("drop", how));
}"""
A_WHILE = 60_000


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """The first quarter of the example flight, which tells little and is quick."""
    path = tmp_path_factory.mktemp("flights") / "short.parquet"
    with resources.as_file(resources.files("eivor.data").joinpath("example_flight.parquet")) as whole:
        pl.read_parquet(whole).filter(pl.col("time") < 15.0).write_parquet(path)
    return path


@pytest.fixture(scope="module")
def result(log):
    """What the command line finds in it."""
    return ev.identify_flight(ev.read_log(log))


@pytest.fixture(scope="module")
def server():
    made = Server(ServeOptions(workers=1))
    yield made
    made.close()


@pytest.fixture
def served(watched, server):
    """Open the page."""
    return partial(watched, server.url)


def drop(page, *files):
    page.evaluate(DROP, [[name, base64.b64encode(content).decode()] for name, content in files])


def done(page, count=1):
    page.locator('[data-state="done"]').nth(count - 1).wait_for(timeout=A_WHILE)


def looks_right(page):
    for width in (360, 390, 768, 1280):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(100)
        assert page.evaluate(LOOKS) == [], width


def nothing_stands_in_the_way(page):
    axe = resources.files(pytest.importorskip("axe_playwright_python")).joinpath("axe.min.js")
    page.evaluate(axe.read_text(encoding="utf-8"))
    for scheme, rules in (("dark", "runOnly: ['color-contrast']"), ("light", "")):
        page.emulate_media(color_scheme=scheme)
        evaluate = page.evaluate(
            f"axe.run(document, {{iframes: false, {rules}}}).then((done) => done.violations)"
        )
        assert [(item["id"], item["nodes"][0]["html"]) for item in evaluate] == []


def nothing_went_wrong(page, server):
    current = server.url.partition("?")[0]
    assert [url for url in page.asked if not url.startswith((current, f"blob:{current}", "data:"))] == []
    assert (page.said, page.evaluate("broken")) == ([], [])


def test_a_log_is_dropped_and_its_verdict_comes_back(served, server, log, result, tmp_path):
    page = served(width=390)
    page.reload()
    looks_right(page)
    drop(page, (log.name, log.read_bytes()))
    done(page)
    card = result_card((result,))
    assert page.locator("#verdict .said").text_content() == card.title
    readings = [
        tuple(item.locator(part).text_content() for part in (".value", ".interval"))
        for item in page.locator(".reading").all()
    ]
    lines = [line for group in card.groups for line in group.lines if line.quantity]
    assert readings == [(line.text, line.interval) for line in lines]
    page.evaluate(UNFOLD)
    page.locator('.files [data-refused="true"]').first.wait_for(timeout=A_WHILE)
    reasons = page.locator('.files [data-refused="true"] .why').all_text_contents()
    assert reasons
    assert all(len(reason) > 20 for reason in reasons)
    assert [reason for reason in reasons if "--" in reason] == []  # the page's fields, no options
    with page.expect_download() as saved:
        page.get_by_role("button", name="result.json").click()
    saved.value.save_as(tmp_path / "saved.json")
    document = json.loads((tmp_path / "saved.json").read_text())["motions"]["vertical"]
    alone = json.loads(result.to_json())
    assert document == {name: alone[name] for name in document}
    looks_right(page)
    nothing_stands_in_the_way(page)
    page.locator("iframe").scroll_into_view_if_needed()
    page.wait_for_timeout(500)
    report = page.frames[1]
    assert report.evaluate("document.querySelector('.verdict').checkVisibility()") is False
    assert report.evaluate("document.querySelectorAll('.chart canvas').length") == 5
    assert report.evaluate("document.documentElement.scrollHeight - innerHeight") <= 1
    assert report.evaluate(LOOKS) == []
    nothing_went_wrong(page, server)
    server.jobs.end(next(url for url in page.asked if url.endswith("/events")).split("/")[-2])
    page.get_by_role("button", name="report.html").press("Enter")
    page.locator(".files .why", has_text="is forgotten: drop the log again.").wait_for(timeout=A_WHILE)


def test_keys_alone_fit_another_window_again(served, server, log):
    page = served()
    reached = []
    for _ in range(4):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id"))
    assert reached == ["theme", "files", "folder", "example"]
    page.set_input_files("#files", log)
    done(page)
    page.get_by_label("The window begins at").focus()
    for _ in range(30):
        page.keyboard.press("ArrowRight")
    assert page.locator(".ends output").text_content() == "3.0 s to 15.0 s"
    while page.evaluate("document.activeElement.textContent") != "Fit again":
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.textContent") == "Cancel"  # so it is not done any more
    done(page)
    assert page.locator(".ends output").text_content() == "3.0 s to 15.0 s"
    assert page.locator(".panel > details").get_attribute("open") is None
    window = ev.identify_flight(ev.read_log(log), window=(3.0, 14.99))
    lines = [line for group in result_card((window,)).groups for line in group.lines]
    displayed = [line.text for line in lines if line.quantity]
    assert page.locator(".reading .value").all_text_contents() == displayed
    nothing_went_wrong(page, server)


def test_flights_are_compared_and_one_may_be_cancelled(served, server, log, result):
    page = served()
    content = log.read_bytes()
    drop(page, ("first.parquet", content), ("second.parquet", content), ("third.parquet", content))
    page.get_by_role("button", name="Cancel third.parquet").click()
    page.locator('[data-state="cancelled"]').wait_for(timeout=A_WHILE)
    done(page, 2)
    rows = page.locator("#compared tbody th").all_text_contents()
    assert sorted(rows) == ["first.parquet", "second.parquet"]
    assert page.locator("#compared .forest").count() == len(card_entries((result,)))
    looks_right(page)
    nothing_stands_in_the_way(page)
    page.get_by_role("button", name="third.parquet", exact=True).click()
    assert "Cancelled." in page.locator("#result .failure").text_content()
    nothing_went_wrong(page, server)


def test_what_a_log_and_its_name_say_stays_text(served, server):
    page = served()
    header = b'"</script><script>alert(3)</script>",<img src=x onerror=alert(4)>\n1,2\n'
    drop(page, (HOSTILE, header), ("damaged.ulg", b"ULog\x01\x12\x35" + bytes(40)))
    page.locator('[data-state="failed"]').nth(1).wait_for(timeout=A_WHILE)
    name = page.locator("#result h2").text_content()
    assert name.startswith(
        r"</script><script>alert(1)</script><img src=x onerror=alert(2)>\u{202e}\u{2066}WW"
    )
    assert len(name) == 120
    assert page.locator("img").count() == 0
    looks_right(page)
    page.get_by_role("button", name="damaged.ulg", exact=True).click()
    assert "Expected " in page.locator("#result .failure").text_content()
    nothing_went_wrong(page, server)


def workers_of_this_process():
    """Worker processes, whatever they do."""
    workers = []
    for entry in Path("/proc/self/task").glob("*/children"):
        with suppress(OSError):  # threads and processes end meanwhile
            workers += [
                int(item)
                for item in entry.read_text().split()
                if b"process_pool" in Path(f"/proc/{item}/cmdline").read_bytes()
            ]
    return workers


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="processes are looked for in /proc")
def test_a_worker_that_is_killed_is_a_sentence(served, server):
    """Always, whenever it works: a flight is tried again in a new process. The example needs no file."""
    page = served()
    server.workers.choices()  # what the page itself needs of a worker is there
    page.get_by_role("button", name="Try the example flight").click()
    failed = page.locator('[data-state="failed"]')
    end = time.monotonic() + A_WHILE / 1000
    while not failed.count() and time.monotonic() < end:
        for item in workers_of_this_process():
            with suppress(ProcessLookupError):  # it was dead, and the server has noticed
                os.kill(item, signal.SIGKILL)
        page.wait_for_timeout(50)
    assert page.locator("#result h2").text_content() == "example_flight.parquet"
    text_content = page.locator("#result .failure").text_content()
    assert "the process that worked on it died (signal 9)" in text_content
    assert "eivor serve --time S --memory GB." in text_content
    nothing_went_wrong(page, server)


def test_folders_are_dropped(served, server, log, tmp_path):
    """Files that are one log together are one, others one by one; what is no log is left out."""
    tables = tmp_path / "<img src=x onerror=alert(5)>"
    flights = tmp_path / "flights" / "monday"
    tables.mkdir()
    flights.mkdir(parents=True)
    for topic in ("vehicle_attitude", "sensor_combined"):
        (tables / f"one_{topic}_0.csv").write_text("timestamp,q[0]\nx,2\n")
    (flights / log.name).write_bytes(log.read_bytes())
    (flights / "notes.txt").write_text("windy")
    page = served()
    known = page.context.new_cdp_session(page)
    drag_data = {"items": [], "files": [str(tables), str(flights.parent)], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        known.send("Input.dispatchDragEvent", {"type": kind, "x": 200, "y": 200, "data": drag_data})
    done(page)
    page.locator('[data-state="failed"]').wait_for(timeout=A_WHILE)
    assert page.locator(".flight-name").all_text_contents() == [tables.name, log.name]
    page.get_by_role("button", name=tables.name, exact=True).click()
    text_content = page.locator("#result .failure").text_content()
    assert f"Expected tables with flight data; received '{tables.name}' without a value." in text_content
    (flights / log.name).unlink()
    page.set_input_files("#folder", flights)
    page.locator('[data-state="failed"]').nth(1).wait_for()
    page.get_by_role("button", name="monday", exact=True).click()
    assert "No log is in this folder." in page.locator("#result .failure").text_content()
    nothing_went_wrong(page, server)


def test_a_server_that_has_gone_is_a_sentence(served, log):
    page = served()
    page.context.set_offline(True)
    drop(page, (log.name, log.read_bytes()))
    page.locator('[data-state="failed"]').wait_for()
    assert "Eivor's server does not answer." in page.locator("#result .failure").text_content()
