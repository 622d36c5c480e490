"""What `validation.house` counts, on a small package and on a walk."""

from __future__ import annotations

import pytest

from validation import house

FILES = {
    "__init__.py": '"""All of it."""\n',
    "one.py": """\
'''Docstring
of two lines.'''

from __future__ import annotations

import math  # late

# A comment.
def ahead(at: int) -> float:
    '''Line.'''
    from small.two import VALUE

    return math.sqrt(VALUE + at)
""",
    "two.py": """\
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from small.room import three
VALUE = 1
""",
    "room/__init__.py": "",
    "room/three.py": """\
from .. import one


class Motion:
    name: str
    words = "He told what she tells."

    def told_lag(self):
        return one
""",
    "room/four.py": "from small import two\n",
}

LINES = sum(text.count("\n") for text in FILES.values())


@pytest.fixture
def small(tmp_path):
    package = tmp_path / "small"
    for name, text in FILES.items():
        path = package / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return package


def test_counts_of_a_package(small):
    counted = house.architecture(small)
    assert counted == {
        "files": 6,
        "lines": LINES,
        "files of the library": 6,
        "lines of the library": LINES,
        "lines of code without docstrings and imports": 2 + 2 + 5,
        "circles of imports": 1,
        "files in circles of imports": 3,
        "files in the largest circle": 3,
        "imports of the package inside functions": 1,
        "imports of the package for type checking only": 1,
        "files of fewer than 60 lines": 4,
        "files of more than 900 lines": 0,
        "files in the largest folder": 3,
        "the words told and tells": 2,
        "members of the protocol of motions": 3,
    }
    assert "| files / lines |" in house.table(small, [{}, {}, {}])
