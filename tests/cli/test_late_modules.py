"""Parts of NumPy that commands have no use for are loaded when they are used, and are whole then."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

from eivor.__main__ import load_late

#: Each is loaded with the part of NumPy that it belongs to.
WITHIN = ("numpy.f2py.crackfortran", "numpy.testing._private.utils")


def printed(code: str) -> str:
    """What a fresh interpreter prints."""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.strip()


def test_scipy_does_not_load_them():
    code = (
        "import sys\n"
        "from eivor.__main__ import load_late\n"
        "load_late()\n"
        "import scipy.linalg, scipy.special\n"
        f"print([name for name in {WITHIN!r} if name in sys.modules])"
    )
    assert printed(code) == "[]"


def test_they_are_whole_when_they_are_used():
    code = (
        "import sys\n"
        "from eivor.__main__ import load_late\n"
        "load_late()\n"
        "import numpy as np, scipy.linalg\n"
        "from numpy.testing import assert_allclose\n"
        "assert_allclose(1.0, 1.0)\n"
        "import numpy.f2py\n"
        "print(callable(np.f2py.get_include), np.testing.assert_allclose is assert_allclose,"
        f" [name for name in {WITHIN!r} if name not in sys.modules])"
    )
    assert printed(code) == "True True []"


def test_asked_twice_is_as_asked_once():
    code = (
        "import sys\n"
        "from eivor.__main__ import load_late\n"
        "load_late(); before = list(sys.meta_path); load_late()\n"
        "print(before == sys.meta_path)"
    )
    assert printed(code) == "True"


def test_packages_without_an_init_file_are_found_as_before(tmp_path, monkeypatch):
    inner = tmp_path / "folder_alone" / "folder_within"
    inner.mkdir(parents=True)
    (inner / "found.py").write_text("HERE = True\n")
    monkeypatch.setattr(sys, "meta_path", sys.meta_path[:])
    monkeypatch.syspath_prepend(tmp_path)
    load_late()
    try:
        assert import_module("folder_alone.folder_within.found").HERE
    finally:
        for name in [name for name in sys.modules if name.startswith("folder_alone")]:
            del sys.modules[name]
