"""Allow one `softsim up` per namespace and ROS domain, since two simulators would send on the same topics."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from softsim_core.base import SoftSimError, open_lock, runtime_folder


class AlreadyUpError(SoftSimError, RuntimeError):
    """Another `softsim up` serves the same namespace."""


def lock_file(namespace: str) -> Path:
    """Return the lock file of a namespace in this process's ROS domain."""
    domain = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
    return runtime_folder() / f"softsim-{os.getuid()}-domain-{domain}-{namespace.replace('/', '.')}.lock"


@contextlib.contextmanager
def only_one(namespace: str) -> Iterator[None]:
    """Lock the namespace for the `with` block; the system releases it even after kill -9.

    Raises:
        AlreadyUpError: another process has locked it; carries its process id.
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
