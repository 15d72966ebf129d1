"""Kernels call each other without a wrapper for Python, which calls them, too; another process compiles."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType, ModuleType

import numpy as np
import pytest
from small_kernels import SOURCE, loaded
from waiting import DEADLINE_S

from softsim_core.physics.kernels import CompileProcess, KernelRequest, compile_process

pytest.importorskip("numba")
pytestmark = pytest.mark.numba


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


def test_copies_of_a_package_share_what_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from numba.core import config

    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    for name, seconds in (("first", 1e9), ("second", 2e9)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "kernels_here.py").write_text(SOURCE)
        os.utime(tmp_path / name / "kernels_here.py", (seconds, seconds))
    loaded(tmp_path / "first").four_times(np.ones(2))
    copy = loaded(tmp_path / "second")
    copy.four_times(np.ones(2))
    assert sum(copy.four_times.for_python.stats.cache_hits.values()) == 1
    assert not copy.four_times.for_python.stats.cache_misses
    changed = SOURCE.replace("2.0", "3.0")
    (tmp_path / "second" / "kernels_here.py").write_text(changed)
    values = np.ones(2)
    loaded(tmp_path / "second").four_times(values)
    assert values.tolist() == [9.0, 9.0]


@pytest.fixture
def importable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The same package where another process finds it, too."""
    (tmp_path / "kernels_there.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("kernels_there")
    compile_process.close()
    del sys.modules["kernels_there"]


def test_what_is_missing_in_the_cache_another_process_compiles(importable: ModuleType) -> None:
    """A process that compiled, and one that loads, would differ in the last bits."""
    values = np.ones(2)
    importable.four_times(values)
    assert values.tolist() == [4.0, 4.0]
    assert not importable.four_times.for_python.stats.cache_misses
    assert sum(importable.four_times.for_python.stats.cache_hits.values()) == 1
    assert not importable.twice.overloads


@pytest.mark.slow
def test_a_process_that_compiles_may_die_and_cannot_compile_everything(importable: ModuleType) -> None:
    from numba.core.errors import TypingError

    process = CompileProcess()
    try:
        assert process.compile(wanted("twice", float))
        child = process._process
        assert child is not None
        child.kill()
        child.wait()
        assert process.compile(wanted("four_times", float))
        assert not process.compile(wanted("twice", str))
        assert not process.compile(wanted("thrice", float))
        assert not process.compile(KernelRequest("kernels_nowhere", "twice", ()))
    finally:
        process.close()
    with pytest.raises(TypingError):
        importable.twice("text")


def wanted(name: str, of: type) -> KernelRequest:
    """A kernel of the importable package, for an array of floats, or for a text."""
    from numba import float64, types

    return KernelRequest("kernels_there", name, (types.unicode_type if of is str else float64[::1],))


@pytest.mark.slow
def test_types_that_no_other_process_knows_are_compiled_here(importable: ModuleType) -> None:
    """Of a script, which is another program there, and of a function, which cannot be told.

    The process that compiles for the script ends with it, however that ends. It imports the kernels, which
    make it wait for long.
    """
    idle = "\nfrom softsim_core.physics.kernels import worker\nworker.IDLE_S = 10.0 * 60.0\n"
    assert importable.__file__ is not None
    Path(importable.__file__).write_text(SOURCE + idle)
    code = (
        "import os, signal\n"
        "from typing import NamedTuple\n"
        "import numpy as np\n"
        "import kernels_there\n"
        "class Pair(NamedTuple):\n"
        "    one: float\n"
        "    other: float\n"
        "def local():\n"
        "    class Inner(NamedTuple):\n"
        "        one: float\n"
        "    return Inner(4.0)\n"
        "print(kernels_there.first(Pair(3.0, 2.0)), kernels_there.first(local()))\n"
        "print(sum(kernels_there.first.for_python.stats.cache_misses.values()))\n"
        "kernels_there.twice(np.ones(2))\n"
        "print(sum(kernels_there.twice.for_python.stats.cache_misses.values()), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(  # to the end of its errors, which are the other process's, too
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=DEADLINE_S
    )
    assert run.stdout.split() == ["3.0", "4.0", "2", "0"], run.stderr
    assert run.stderr == ""
    assert run.returncode == -signal.SIGKILL


def test_where_nothing_is_kept_it_is_tried_once(
    importable: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a disk that is full: compiled elsewhere, and not found."""
    from softsim_core.physics.kernels import dispatchers

    asked: list[bytes] = []

    def compile_for_nothing(request: bytes) -> bool:
        asked.append(request)
        return True

    mine = CompileProcess()
    monkeypatch.setattr(dispatchers, "compile_process", mine)
    monkeypatch.setattr(mine, "_answer", compile_for_nothing)
    values = np.ones(2)
    importable.twice(values)
    importable.four_times(values)
    assert values.tolist() == [8.0, 8.0]
    assert len(asked) == 1


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_fork_has_a_process_of_its_own(importable: ModuleType) -> None:
    code = (
        "import os\n"
        "import numpy as np\n"
        "import kernels_there\n"
        "kernels_there.twice(np.ones(2))\n"
        "forked = os.fork()\n"
        "kernels_there.four_times(np.ones(2))\n"
        "print(sum(kernels_there.four_times.for_python.stats.cache_misses.values()), flush=True)\n"
        "if forked:\n"
        "    assert os.waitpid(forked, 0)[1] == 0\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=DEADLINE_S
    )
    assert run.stdout.split() == ["0", "0"], run.stderr


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
