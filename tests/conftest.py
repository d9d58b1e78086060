"""Fixtures that several test files share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def reference() -> Path:
    """The published reference data: ``../shared/reference`` beside the checkout, or ``$SIMGEN_REFERENCE``."""
    default = Path(__file__).resolve().parents[2] / "shared" / "reference"
    folder = Path(os.environ.get("SIMGEN_REFERENCE", default))
    if not folder.is_dir():
        pytest.skip(f"no reference data at {folder} (set SIMGEN_REFERENCE)")
    return folder
