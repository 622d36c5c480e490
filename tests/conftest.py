"""What all tests share: checked shapes, Matplotlib without a display, real recordings."""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import Phase, settings

import coarse_search as searches
import shape_checks

if "eivor" in sys.modules:
    raise RuntimeError("eivor was imported before the hook that checks shapes; import it in tests only")

if shape_checks.wanted():
    shape_checks.install()

os.environ["MPLBACKEND"] = "Agg"
# The matrices are small, and every processor runs tests: more threads would wait for each other. The
# processes that run tests read this when they start.
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

settings.register_profile("default", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
# Of a mutant it is enough that a test fails: the search for the smallest example takes minutes.
settings.register_profile("mutation", settings.get_profile("ci"), phases=[Phase.explicit, Phase.generate])
settings.load_profile("ci" if os.environ.get("CI") else "default")


@pytest.fixture(scope="session")
def recordings():
    """Folder of the real recordings: EIVOR_DATA, or ../shared/data beside the repository."""
    default = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("EIVOR_DATA") or default)
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; set EIVOR_DATA")
    return folder


def pytest_collection_modifyitems(items):
    """Mark every test that uses the recordings, so that none escapes the rule above."""
    for item in items:
        if "recordings" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.recordings)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Run calibrations, and what is made for them, without the checks of shapes."""
    shape_checks.begin_test()
    with shape_checks.unchecked() if item.get_closest_marker("calibration") else nullcontext():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    """Turn the skip of a test on real recordings into a failure where they are required."""
    report = yield
    is_required = os.environ.get("EIVOR_REQUIRE_DATA", "") not in {"", "0"}
    if report.skipped and is_required and item.get_closest_marker("recordings"):
        report.outcome = "failed"
        report.longrepr = f"EIVOR_REQUIRE_DATA is set, but this test was skipped: {report.longrepr}"
    return report


@cache
def command():
    """The command `eivor`, as each call of its app makes it."""
    from typer.main import get_command

    from eivor.cli.main import app

    return get_command(app)


@pytest.fixture
def command_line(capsys, monkeypatch):
    """The command `eivor` as a user meets it, called in this process."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delenv("EIVOR_DEBUG", raising=False)

    def call(*arguments):
        with pytest.raises(SystemExit) as left:
            command()([str(argument) for argument in arguments], prog_name="eivor")
        captured = capsys.readouterr()
        return SimpleNamespace(code=int(left.value.code or 0), out=captured.out, err=captured.err)

    return call


@pytest.fixture
def unchecked_shapes():
    """Calls go through to the library's own checks, as they do outside this test run."""
    with shape_checks.unchecked():
        yield


#: Folders of tests that identify the same flights with the same options many times.
OF_FLIGHTS = {"exports", "flights", "motions", "planning", "report"}


@pytest.fixture(autouse=True)
def results_once(request):
    """A flight of one test is that of another, and identified once; not for tests that change how."""
    changed = "monkeypatch" in request.fixturenames and "command_line" not in request.fixturenames
    once = OF_FLIGHTS & set(request.path.parts) and not changed
    with searches.identified_once() if once else nullcontext():
        yield


@pytest.fixture
def coarse_search():
    """Flights are searched for few lags and delays: a fifth of the time, where numbers are not the point."""
    with searches.coarse():
        yield
