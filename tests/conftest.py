"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.append(str(Path(__file__).parent))  # tests may import `terminal_session`


@pytest.fixture(scope="session")
def reference_dir() -> Path:
    """Folder of the reference facts; tests that need it skip where it is absent."""
    folder = Path(os.environ.get("SOFTSIM_REFERENCE", REPOSITORY.parent / "shared" / "reference"))
    if not (folder / "data").is_dir():
        pytest.skip(f"reference data not found in {folder} (set SOFTSIM_REFERENCE)")
    return folder
