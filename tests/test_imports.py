"""What importing costs, and that every public name is there."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import eivor
import shape_checks

#: Each of these costs a tenth of a second or more.
HEAVY = (
    *("jaxtyping", "matplotlib", "polars", "pyulog", "scipy.optimize", "scipy.signal", "scipy.stats"),
    *("rotorpy", "pandas"),
)


def modules_after(code):
    """Names of the modules that a fresh interpreter has loaded after running `code`."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("COV_")}
    listing = f"import sys\n{code}\nprint('\\n'.join(['@modules', *sys.modules]))"
    run = subprocess.run(
        [sys.executable, "-c", listing], capture_output=True, text=True, check=True, env=environment
    )
    return set(run.stdout.partition("@modules\n")[2].split())


def heavy(modules):
    return sorted(name for name in HEAVY if name in modules)


def test_import_loads_nothing_heavy():
    assert heavy(modules_after("import eivor")) == []


def test_public_names_load_nothing_heavy():
    """Touching every name loads the estimator, but no file format, no figure, no scipy.signal, no checks."""
    # Fleets and scenarios are of leaf rooms, which read tables.
    loaded = modules_after(
        "import eivor\nfor name in {*eivor.__all__} - {'fleet', 'shipped_scenario'}: getattr(eivor, name)"
    )
    assert heavy(loaded) == []
    assert "beartype" not in loaded


@pytest.mark.thorough
def test_one_ulog_loads_no_tables_and_no_figures():
    """A whole command is held against a reading of the log: what few need is loaded by those."""
    loaded = modules_after(
        "import eivor.logs.ulog.reader, eivor.motions.identify\n"
        "from eivor.motions.table import motion_by_name\n"
        "motion_by_name('vertical')"
    )
    assert "eivor.flights.identify" in loaded
    assert not {"polars", "matplotlib", "scipy.fft"} & loaded


@pytest.mark.thorough
def test_the_command_loads_no_leaf_room_and_no_figures(recordings):
    """Half of `eivor identify` on a log of 3 MB was loading."""
    loaded = modules_after(
        f"sys.argv = ['eivor', 'identify', {str(recordings / 'px4' / 'battery_brownout.ulg')!r}]\n"
        "from eivor.__main__ import run\n"
        "try:\n    run()\nexcept SystemExit as end:\n    assert end.code == 0, end.code"
    )
    assert "eivor.linalg.total_least_squares" in loaded
    assert set(heavy(loaded)) <= {"scipy.optimize"}
    leaf_rooms = ("eivor.lab", "eivor.fleet", "eivor.serve")
    assert not [name for name in loaded if name.startswith(leaf_rooms)]
    assert not loaded & {"eivor.methods", "numpy.f2py.crackfortran"}


def test_help_loads_nothing_heavy():
    code = (
        "from eivor.cli.main import run\n"
        "sys.argv = ['eivor', '--help']\n"
        "try:\n    run()\nexcept SystemExit as end:\n    assert not end.code, end.code"
    )
    loaded = modules_after(code)
    assert "typer" in loaded
    assert heavy(loaded) == []


@pytest.mark.parametrize("name", eivor.__all__)
def test_public_name_resolves(name):
    assert getattr(eivor, name) is not None
    assert name in dir(eivor)


def test_names_shadow_no_submodule():
    """`eivor.identify` is the function; a package of that name would replace it once imported."""
    for name in eivor.__all__:
        if name not in {"methods", "fleet", "__version__"}:  # `eivor.fleet` is the package itself
            assert f"eivor.{name}" not in sys.modules


@pytest.mark.skipif(not shape_checks.wanted(), reason="EIVOR_SHAPE_CHECKS=0")
def test_shapes_are_checked_in_this_run():
    """The hook in conftest.py is on: a matrix where a vector belongs is refused by the annotation."""
    with pytest.raises(Exception, match=r"violates|Type-check"):
        eivor.Signals(5.0, {"input": np.zeros(3)}).channel(3)


@pytest.mark.parametrize("name", ["bounds", "covariances", "fleet", "methods"])
def test_modules_of_names_show_those_only(name):
    """What an interactive prompt completes is what the module offers, not what it imports."""
    module = getattr(eivor, name)
    assert dir(module) == sorted(module.__all__)
    assert all(hasattr(module, offered) for offered in module.__all__)
    assert not {"annotations", "Callable", "UsageError", "AugmentedLeastSquares"} & set(dir(module))
