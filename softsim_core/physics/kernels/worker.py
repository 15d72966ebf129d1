"""The process that compiles kernels for this one, which loads them; run as a program, this module compiles.

A process that compiles kernels sums in another order than one that loads them: a kernel that another one
calls exists twice, by itself and within its caller, and the process calls the first of the two. Both are
right, and differ in the last bits. So no process steps with kernels that it has compiled itself: a simulation
gives the same bytes in the process that needed the kernels first, and in all later ones.
"""

from __future__ import annotations

import atexit
import os
import pickle
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from queue import Empty, SimpleQueue
from subprocess import DEVNULL, PIPE, Popen
from threading import Lock, Thread
from typing import Any, BinaryIO, Final, NamedTuple

from softsim_core.base import open_lock, python_command, start_process

IDLE_S: Final = 10.0
"""The process ends after this time in [s] without work, since it uses half a gigabyte of memory."""


class KernelRequest(NamedTuple):
    """A kernel for arguments of some types (Numba types)."""

    module: str
    name: str
    types: tuple[Any, ...]


class CompileProcess:
    """The process that compiles for this one; it starts when a kernel is missing in the cache."""

    def __init__(self) -> None:
        self._one_at_a_time = Lock()
        self._process: Popen[bytes] | None = None
        self._used = bool(sys.executable) and not getattr(sys, "frozen", False)

    def compile(self, requested: KernelRequest) -> bool:
        """Compile a kernel into the cache in the other process and wait.

        False: it failed, whatever the reason.
        """
        if not self._used:
            return False
        try:
            request = pickle.dumps((_import_paths(), pickle.dumps(requested)))
        except Exception:  # a type unknown to other processes, such as one local to a function
            return False
        with self._one_at_a_time:
            for _ in range(2):  # an idle process may end during a request
                try:
                    return self._answer(request)
                except (OSError, EOFError):
                    self.close()
                except BaseException:  # Ctrl-C: the late answer would go to the next request
                    self.close()
                    raise
        return False

    def compile_here(self) -> None:
        """Compile everything in this process: it takes no steps, or does not save compiled kernels."""
        self._used = False

    def close(self) -> None:
        """End the process; the cache stays."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()

    def forget(self) -> None:
        """Start again in a forked process: the compiling process belongs to its parent."""
        self._one_at_a_time, self._process = Lock(), None

    def _answer(self, request: bytes) -> bool:
        if self._process is None:
            self._process = _begun()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(request)
        self._process.stdin.flush()
        return bool(pickle.load(self._process.stdout))


compile_process: Final = CompileProcess()
atexit.register(compile_process.close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=compile_process.forget)


@contextmanager
def alone(file: Path) -> Iterator[None]:
    """Hold a file's lock, after waiting for it; without effect on systems without such locks."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with open_lock(file) as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _begun() -> Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(_import_paths())}
    errors = DEVNULL if sys.stderr is None else None  # a service may have closed it
    return start_process(python_command(__name__), environment, stdin=PIPE, stdout=PIPE, stderr=errors)


def _import_paths() -> list[str]:
    return [str(Path(each).absolute()) for each in sys.path if each]


def _compile_kernel(paths: list[str], request: bytes) -> bool:
    """Compile a kernel, unless another process has done so meanwhile."""
    sys.path[:] = paths  # also those of a new package
    requested: KernelRequest = pickle.loads(request)
    kernel = getattr(import_module(requested.module), requested.name).for_python
    with alone(Path(kernel.stats.cache_path) / "compiling"):
        kernel.compile(requested.types)
    return True


def _receive_requests(requests: BinaryIO, received: SimpleQueue[tuple[list[str], bytes]]) -> None:
    """Yield requests, and end this process with the one that asks, even in the middle of a kernel."""
    with suppress(EOFError, OSError):
        while True:
            received.put(pickle.load(requests))
    os._exit(0)


def main() -> None:
    """Compile requests from the standard input until it ends or stays idle for a while; ends the process."""
    import signal

    from softsim_core.physics.kernels.cache import be_silent

    be_silent()
    compile_process.compile_here()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks, which ends this one
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # output of modules is no answer
    received: SimpleQueue[tuple[list[str], bytes]] = SimpleQueue()
    Thread(target=_receive_requests, args=(sys.stdin.buffer, received), daemon=True).start()
    while True:
        try:
            request = received.get(timeout=IDLE_S)
        except Empty:
            os._exit(0)  # the reading thread has the input's lock, and Python would end with an error
        try:
            done = _compile_kernel(*request)
        except Exception:  # the next compilation reports the reason
            done = False
        answers.write(pickle.dumps(done))
        answers.flush()


if __name__ == "__main__":  # kernels know this module by its name
    import_module("softsim_core.physics.kernels.worker").main()
