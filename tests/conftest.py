"""What all tests share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of the real recordings: EIVOR_DATA, or ../shared/data beside the repository."""
    default = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("EIVOR_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; set EIVOR_DATA")
    return folder
