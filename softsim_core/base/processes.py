"""Child processes: the only place where the suite starts them.

`python -m` and `python -c` search modules in the current folder first, so a `pickle.py` in a downloaded
folder would run. Children that are started here do not do this, nor do the processes that they start.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from softsim_core.base.machine import usable_cores

Item = TypeVar("Item")
Result = TypeVar("Result")

SAFE_PATH: Final = "PYTHONSAFEPATH"
"""If set, Python 3.11 and later exclude the program's or the current folder from the import path."""

_OPTION_SINCE: Final = (3, 11)
_STARTER: Final = str(Path(__file__).with_name("program_starter.py"))


def use_safe_path() -> None:
    """Exclude the current folder from the import path of this process and of all its Python children.

    Each program of the suite calls this function first. It also covers processes that other libraries start,
    such as the workers of multiprocessing.
    """
    os.environ.update(_safe(os.environ))
    sys.path[:] = [each for each in sys.path if each]
    if sys.version_info < _OPTION_SINCE:
        from multiprocessing import util

        util._args_from_interpreter_flags = _isolated_flags  # type: ignore[attr-defined]


def python_command(program: str | Path, *words: str | Path) -> list[str]:
    """Return the command line that runs a Python program without the current folder in its import path.

    The program is the name of a module as text, or a script as a Path.
    """
    if sys.version_info >= _OPTION_SINCE:
        how = ["-P", str(program)] if isinstance(program, Path) else ["-P", "-m", program]
    else:
        how = [_STARTER, str(program)]
    return [sys.executable, *how, *map(str, words)]


def start_process(
    command: Sequence[str], env: Mapping[str, str] | None = None, **options: Any
) -> subprocess.Popen[Any]:
    """Start a program, see `subprocess.Popen`; Python programs come from `python_command`."""
    return subprocess.Popen(command, env=_safe(os.environ if env is None else env), **options)


def run_process(
    command: Sequence[str], env: Mapping[str, str] | None = None, **options: Any
) -> subprocess.CompletedProcess[Any]:
    """Run a program to its end, see `subprocess.run`; Python programs come from `python_command`."""
    options.setdefault("check", False)
    return subprocess.run(command, env=_safe(os.environ if env is None else env), **options)


_forked: Callable[[Any], Any] = print
"""What forked processes do."""


def in_processes(work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Yield the result of `work` for each item, in order; on Linux, forked processes share the items.

    Each core has one, with all that this process had before; what it changes is lost. Ctrl-C ends them.
    """
    global _forked
    count = min(usable_cores(), len(items))
    if count < 2 or sys.platform != "linux":
        yield from map(work, items)
        return
    _forked = work
    with multiprocessing.get_context("fork").Pool(count, _ended_by_this_process) as pool:
        yield from pool.imap(_do_forked, items)


def _ended_by_this_process() -> None:
    """Leave interrupts to the process that forked this one, and end at its request without a word."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _do_forked(item: Any) -> Any:
    return _forked(item)


def _safe(environment: Mapping[str, str]) -> dict[str, str]:
    """Return an environment in which Python excludes the current folder from the import path.

    An empty entry of PYTHONPATH stands for that folder, too: `PYTHONPATH=$PYTHONPATH:folder` contains one.
    """
    safe = {**environment, SAFE_PATH: "1"}
    if "PYTHONPATH" in safe:
        safe["PYTHONPATH"] = os.pathsep.join(filter(None, safe["PYTHONPATH"].split(os.pathsep)))
    return safe


def _isolated_flags() -> list[str]:
    """Return the options with which multiprocessing of Python 3.10 starts its processes: `-I` for `-P`.

    A worker gets the import path of its parent before it imports anything else.
    """
    return [*subprocess._args_from_interpreter_flags(), "-I"]  # type: ignore[attr-defined]
