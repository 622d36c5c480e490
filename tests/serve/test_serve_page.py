"""The text of the page of `eivor serve`: what its policy allows, and that text in it stays text."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from importlib import resources

import pytest

from eivor.inference.verdict import Status
from eivor.report.html import report_sources
from eivor.serve.page import PARTS, page_text
from report.parsed_page import Element, parsed

#: What would make HTML or code of a string.
NEVER = (
    "innerHTML",
    "outerHTML",
    "insertAdjacentHTML",
    "document.write",
    "DOMParser",
    "srcdoc",
    "eval(",
    "new Function",
    'setTimeout("',
)


@pytest.fixture(scope="module")
def page() -> Element:
    return parsed(page_text())


def test_the_policy_allows_the_page_its_reports_and_its_own_server(page):
    (policy,) = (item.attributes["content"] for item in page.all("meta") if "http-equiv" in item.attributes)
    rules = dict(item.split(" ", 1) for item in policy.split("; "))
    (style,) = page.all("style")
    (script,) = (item for item in page.all("script") if item.attributes.get("type") != "application/json")
    report = report_sources()
    assert rules == {
        "default-src": "'none'",
        "script-src": f"{checksum(script.text)} {checksum(report.script)}",
        "style-src": f"{checksum(style.text)} {checksum(report.style)}",
        "img-src": "data:",
        "connect-src": "'self'",
        "frame-src": "blob:",
        "base-uri": "'none'",
        "form-action": "'none'",
        "require-trusted-types-for": "'script'",
    }


def checksum(source: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()}'"


def test_nothing_in_it_is_fetched_or_handled_inline(page):
    for item in page.all():
        assert not {
            key for key in item.attributes if key.startswith("on") or key in {"style", "src", "srcset"}
        }
        assert item.attributes.get("href", "data:,") == "data:,"
    assert page.all("noscript")


def test_text_never_becomes_markup():
    folder = resources.files("eivor.serve").joinpath("static")
    scripts = {
        item.name: item.read_text(encoding="utf-8") for item in folder.iterdir() if item.name.endswith(".js")
    }
    assert set(scripts) == {f"{name}.js" for name in PARTS}
    for name, script in scripts.items():
        assert [item for item in NEVER if item in script] == [], name
        assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", script), name


def test_every_verdict_and_every_stage_has_a_shape_of_its_own(page):
    (embedded,) = page.all("script", id="shapes")
    shapes = json.loads(embedded.text)
    assert {status.value for status in Status} | {"over", "now", "ahead"} == set(shapes)
    assert len(set(shapes.values())) == len(shapes)


def test_what_the_script_looks_for_is_there(page):
    folder = resources.files("eivor.serve").joinpath("static")
    names = {
        name
        for part in PARTS
        for name in re.findall(
            r'found\("([\w-]+)"\)', folder.joinpath(f"{part}.js").read_text(encoding="utf-8")
        )
    }
    assert names
    for name in names:
        assert len(page.all(id=name)) == 1, name
