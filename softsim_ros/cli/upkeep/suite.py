"""`softsim test`: the test suite of the checkout, one worker more than cores, under a time limit."""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from softsim_core.extras import install_command
from softsim_core.processes import python_command, run_process
from softsim_ros.cli.upkeep.covering import UncoveredPathError, covering_tests

LIMIT_S = {False: 5400, True: 600}
"""Time limits in [s], for what hangs."""

MOST_WORKERS = 6
"""Each has a robot, a page and a browser of its own, about 1 GB. A third of the tests' time is waiting for
processes, so that one worker more than cores keeps the cores busy; quick ones wait for nothing."""

QUICK = "not slow and not exhaustive and not packaging"
"""Tests of `--quick`, as an expression of pytest's option -m."""

_TAKES_A_VALUE = ("-k", "-m", "-p", "-o", "-W", "-c")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--quick", action="store_true", help="leave the slow tests out")
    parser.add_argument(
        "--workers",
        metavar="N",
        help="test processes (default: one more than cores, with --quick as many; 0: in this one)",
    )
    parser.usage = "softsim test [--quick] [--workers N] [PATH ...] [pytest arguments]"
    parser.epilog = (
        "PATH is a test, or a file or folder of the product, such as softsim_core/contact, whose tests run. "
        "All else goes to pytest: softsim test tests/unit -k codec. Other lanes: -m packaging, -m exhaustive."
    )


def command(arguments: argparse.Namespace, root: Path) -> list[str]:
    """Return the command line that runs the tests of the checkout at `root`.

    Packaging tests run where a path is named that holds them; without a path only `-m packaging` runs them.

    Raises:
        UncoveredPathError: no test covers a path.
    """
    words = python_command("pytest", f"--rootdir={root}", "-c", root / "pyproject.toml")
    workers = min((os.cpu_count() or 1) + (not arguments.quick), MOST_WORKERS)
    words += ["-n", arguments.workers or str(workers), "--dist=loadfile"]
    rest, has_paths = _with_tests(arguments.rest, root)
    if arguments.quick:
        words += ["-m", QUICK]
    elif has_paths:
        words += ["-m", "not exhaustive"]
    timeout = shutil.which("timeout")
    limit = [timeout, "--foreground", "-k", "30", str(LIMIT_S[arguments.quick])] if timeout else []
    return [*limit, *words, *rest]


def _with_tests(given: Sequence[str], root: Path) -> tuple[list[str], bool]:
    """Return the words, tests in place of paths of the product, and whether any word was a path."""
    words, has_paths, previous, root = list[str](), False, "", root.resolve()
    for word in given:
        place = (root / word.partition("::")[0]).resolve()
        is_path = previous not in _TAKES_A_VALUE and root in place.parents and place.exists()
        path = place.relative_to(root).as_posix() if is_path else ""
        words += covering_tests(path, root) if is_path and path.split("/")[0] != "tests" else [word]
        has_paths |= is_path
        previous = word
    return words, has_paths


def run(arguments: argparse.Namespace) -> int:
    """Compile the kernels where that has not been done, then hand over to pytest.

    Its exit code is the command's (124: the time limit was reached).
    """
    root = Path(__file__).resolve().parents[3]
    if not (root / "tests").is_dir():
        print(
            f"softsim test: no tests beside the installed package ({root}); use a checkout", file=sys.stderr
        )
        return 1
    if importlib.util.find_spec("pytest") is None or importlib.util.find_spec("xdist") is None:
        print(f"softsim test: pytest or pytest-xdist is missing; {install_command('test')}", file=sys.stderr)
        return 1
    try:
        words = command(arguments, root)
    except UncoveredPathError as error:
        print(f"softsim test: {error}", file=sys.stderr)
        return 2
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes would compile their sources
    run_process(python_command("softsim_core.warmup"), cwd=root)
    _become(words, root)


def _become(words: list[str], folder: Path) -> NoReturn:
    os.chdir(folder)
    os.execvp(words[0], words)
