"""Tests of this folder may import `reference_scenes`; SciPy runs a sample of their cases."""

from __future__ import annotations

import sys
from pathlib import Path

from sampled_cases import pytest_collection_modifyitems

__all__ = ["pytest_collection_modifyitems"]

sys.path.insert(0, str(Path(__file__).parent))
