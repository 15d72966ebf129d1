"""Kernels call each other without a wrapper for Python, and Python calls each of them all the same."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import FunctionType, ModuleType

import numpy as np
import pytest

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

SOURCE = """
from pathlib import Path

from softsim_core.kernels import Compiler

compiler = Compiler(Path(__file__).parent)
kernel = compiler.kernel


@kernel
def twice(values):
    for i in range(len(values)):
        values[i] *= 2.0


@kernel
def four_times(values):
    twice(values)
    twice(values)
"""


def loaded(folder: Path) -> ModuleType:
    """The package in a folder, as a process loads it."""
    spec = importlib.util.spec_from_file_location("kernels_here", folder / "kernels_here.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def kernels(tmp_path: Path) -> ModuleType:
    """A package of two kernels, one of which calls the other."""
    (tmp_path / "kernels_here.py").write_text(SOURCE)
    return loaded(tmp_path)


def test_a_kernel_is_called_by_another_and_by_python(kernels: ModuleType) -> None:
    values = np.array([1.0, -3.0])
    kernels.four_times(values)
    assert values.tolist() == [4.0, -12.0]
    kernels.twice(values)
    assert values.tolist() == [8.0, -24.0]


def test_only_what_python_calls_is_compiled_for_it(kernels: ModuleType) -> None:
    kernels.four_times(np.ones(2))
    cache = kernels.compiler.cache
    for_python = cache / "for_python"
    assert [file.name.split("-")[0] for file in for_python.rglob("*.nbc")] == ["kernels_here.four_times"]
    inside = [file.name.split("-")[0] for file in cache.rglob("*.nbc") if for_python not in file.parents]
    assert inside == ["kernels_here.twice"]
    kernels.twice(np.ones(2))
    assert len(list(for_python.rglob("*.nbc"))) == 2


def test_kernels_come_from_the_cache_in_the_next_process(kernels: ModuleType, tmp_path: Path) -> None:
    kernels.four_times(np.ones(2))
    again = loaded(tmp_path)
    values = np.ones(2)
    again.four_times(values)
    assert values.tolist() == [4.0, 4.0]
    assert sum(again.four_times.for_python.stats.cache_hits.values()) == 1
    assert not again.four_times.for_python.stats.cache_misses


def test_without_compiling_they_are_plain_python(
    kernels: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a debugger wants them, with NUMBA_DISABLE_JIT=1."""
    import numba

    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    plain = loaded(tmp_path)
    values = np.ones(2)
    plain.four_times(values)
    assert values.tolist() == [4.0, 4.0]
    assert isinstance(plain.four_times, FunctionType)
    assert not isinstance(kernels.four_times, FunctionType)
