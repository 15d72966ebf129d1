"""SciPy on a sample of the cases."""

from __future__ import annotations

from sampled_cases import pytest_collection_modifyitems

__all__ = ["pytest_collection_modifyitems"]
