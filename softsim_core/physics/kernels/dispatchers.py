"""Numba's dispatchers of a kernel: one for calls from kernels, and one for Python, compiled elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from numba.core.registry import CPUDispatcher, cpu_target

from softsim_core.physics.kernels.cache import KernelCache
from softsim_core.physics.kernels.worker import KernelRequest, compile_process


class Inside(CPUDispatcher):
    """A kernel as other kernels call it; a call from Python goes to the one with a wrapper for Python."""

    with_wrapper: Callable[[], Any]

    def cache_in(self, folder: Path, content: str) -> None:
        """Cache compiled code in a folder, in checked files of these sources."""
        self._cache = KernelCache(self.py_func, folder, content)

    @cached_property
    def for_python(self) -> Any:
        """The dispatcher that Python calls."""
        return self.with_wrapper()

    def __call__(self, *arguments: Any) -> Any:
        """Call the dispatcher for Python."""
        return self.for_python(*arguments)


class ForPython(CPUDispatcher):
    """A kernel that Python calls; another process compiles it if it is missing in the cache."""

    def cache_in(self, folder: Path, content: str) -> None:
        """Cache compiled code in a folder; another process compiles it."""
        self._cache = _CompiledElsewhere(self.py_func, folder, content)


class _CompiledElsewhere(KernelCache):
    def __init__(self, function: Callable[..., Any], folder: Path, content: str) -> None:
        super().__init__(function, folder, content)
        self._module, self._name = function.__module__, function.__name__

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = super().load_overload(sig, target_context)
        if found is None and compile_process.compile(KernelRequest(self._module, self._name, tuple(sig))):
            found = super().load_overload(sig, target_context)
            if found is None:  # a full disk stores nothing
                compile_process.compile_here()
        return found


def get_ready_to_load() -> None:
    """Load Numba's tables of supported operations, so that the first kernel does not wait for them."""
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
