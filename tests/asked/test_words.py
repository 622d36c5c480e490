import math
from pathlib import Path

import pytest

from eivor.cli.parsing import LogArgument, log_argument, named, parse_names, parse_window
from eivor.errors import CorruptLogError, UsageError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("4:67", (4.0, 67.0)),
        ("-26.5:-1", (-26.5, -1.0)),
        ("0:1e2", (0.0, 100.0)),
        (" 4 : 67 ", (4.0, 67.0)),
        ("4:", (4.0, math.inf)),
        (":67", (-math.inf, 67.0)),
    ],
)
def test_a_window_is_two_seconds(text: str, expected: tuple[float, float]) -> None:
    assert parse_window(text) == expected


@pytest.mark.parametrize("text", ["", "4", "67:4", "4:4", "a:b", "4:nan", "nan:", "1:2:3", "4-67"])
def test_a_window_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="START before END"):
        parse_window(text)


def test_a_log_may_bring_its_window() -> None:
    assert log_argument("a/b.ulg@4:67") == LogArgument(Path("a/b.ulg"), (4.0, 67.0))
    assert log_argument("b.ulg@-4:6.5") == LogArgument(Path("b.ulg"), (-4.0, 6.5))
    assert log_argument("me@home.csv") == LogArgument(Path("me@home.csv"))
    assert log_argument("me@home.csv@1:2") == LogArgument(Path("me@home.csv"), (1.0, 2.0))
    assert log_argument("@1:2") == LogArgument(Path("@1:2"))


def test_an_existing_file_with_an_at_in_its_name_wins(tmp_path: Path) -> None:
    path = tmp_path / "flight@4:67"
    path.touch()
    assert log_argument(str(path)) == LogArgument(path)


def test_a_log_with_a_broken_window_is_refused() -> None:
    with pytest.raises(UsageError, match="START:END"):
        log_argument("b.ulg@4:x")


def test_names_are_a_list_with_commas() -> None:
    assert parse_names("lags") == ("lags",)
    assert parse_names("reference_position_z, pilot_throttle") == ("reference_position_z", "pilot_throttle")


@pytest.mark.parametrize("text", [",", " ", "lags,references", "references,pilot_throttle"])
def test_instruments_that_exclude_each_other_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="alone"):
        parse_names(text)


def test_an_error_names_its_log_once() -> None:
    with pytest.raises(CorruptLogError, match=r"bits, in b\.ulg"), named("a/b.ulg", several=True):
        raise CorruptLogError("a log", "bits, in b.ulg", "Try again.")
    with pytest.raises(CorruptLogError, match=r"bits, in a/b\.ulg"), named("a/b.ulg", several=True):
        raise CorruptLogError("a log", "bits", "Try again.")
    with pytest.raises(CorruptLogError, match=r"bits\. Try"), named("a/b.ulg", several=False):
        raise CorruptLogError("a log", "bits", "Try again.")
