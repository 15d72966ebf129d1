"""One `softsim up` a namespace and ROS domain: two simulators on the same topics would fight."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from softsim_core.base.errors import SoftSimError
from softsim_core.base.files import open_lock, runtime_folder


class AlreadyUpError(SoftSimError, RuntimeError):
    """The same namespace is being served by another `softsim up`."""


def lock_file(namespace: str) -> Path:
    """The file that stands for a namespace in this process's ROS domain."""
    domain = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
    return runtime_folder() / f"softsim-{os.getuid()}-domain-{domain}-{namespace.replace('/', '.')}.lock"


@contextlib.contextmanager
def only_one(namespace: str) -> Iterator[None]:
    """Hold the namespace for the `with` block; freed by the system even after kill -9.

    Raises:
        AlreadyUpError: another process holds it; carries its process id.
        RuntimeFolderError: there is no private folder for the lock.
    """
    file = lock_file(namespace)
    with open_lock(file) as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = lock.read(20).strip()
            holder = holder if holder.isdecimal() else "unknown"
            raise AlreadyUpError(
                f"/{namespace} is up already (process {holder}); end that one first, or start this one under "
                f"another name: softsim up ROBOT --namespace {namespace}_2"
            ) from None
        lock.truncate(0)
        lock.write(f"{os.getpid()}\n")
        lock.flush()
        yield
