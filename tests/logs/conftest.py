"""What tests of logs share: a file of some content, as it is read."""

from __future__ import annotations

import pytest

import eivor as ev


@pytest.fixture
def read(tmp_path):
    """Reads bytes, a text, or what a writer has written, as a file of some name."""

    def read(content, name="flight.log", **options):
        content = content.bytes() if hasattr(content, "bytes") else content
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
        return ev.read_log(tmp_path / name, **options)

    return read


@pytest.fixture
def whole(monkeypatch):
    """Files are whole: no child need decode them first."""
    monkeypatch.setattr("eivor.logs.table.columnar.decode_in_child", lambda *_, **__: None)
