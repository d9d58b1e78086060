"""Job files of one's own."""

import pytest


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Write text to ``job.yaml`` in an otherwise empty current folder."""
    monkeypatch.chdir(tmp_path)

    def write(text: str) -> str:
        (tmp_path / "job.yaml").write_text(text)
        return "job.yaml"

    return write
