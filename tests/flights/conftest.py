"""What users get who run without the check of shapes at each call."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from jaxtyping import config


@pytest.fixture
def unchecked_shapes() -> Iterator[None]:
    """Calls go through to the library's own checks, as they do outside this test run."""
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)
