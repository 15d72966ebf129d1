"""Writes what a process does to files and processes, a line each, to the file that AUDIT_LOG names.

Python imports this module at its start from any folder of PYTHONPATH; nobody else does.
"""

import os
import sys

_FILES = ("open", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.symlink", "os.link", "os.truncate")
_PROGRAMS = ("os.system", "os.exec", "os.posix_spawn", "os.spawn", "subprocess.Popen", "ctypes.dlopen")


def _mode(mode: object, flags: object = 0) -> object:
    """How a file was opened; "w" for one that the os module opened in order to write."""
    return mode or ("w" if isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR) else "")


def _watch(log: str) -> None:
    file = os.open(f"{log}.{os.getpid()}", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event in _FILES or event in _PROGRAMS:
            mode = _mode(*arguments[1:3]) if event == "open" else ""
            os.write(file, f"{event}\t{arguments[0]!r}\t{mode}\n".encode(errors="replace"))

    sys.addaudithook(hook)


if os.environ.get("AUDIT_LOG"):
    _watch(os.environ["AUDIT_LOG"])
