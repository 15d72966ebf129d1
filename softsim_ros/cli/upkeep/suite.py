"""`softsim test`: run the test suite of the checkout; which tests cover which files."""

from __future__ import annotations

import argparse
import functools
import importlib.util
import os
import re
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath

from softsim_core.base import install_command, listing, python_command, run_process
from softsim_ros.cli import CommandError, UsageError


class UncoveredPathError(UsageError):
    """A path, relative to the checkout, that no test covers."""

    def __init__(self, path: str, covered: Iterable[str]) -> None:
        self.path = path
        super().__init__(
            f"no test covers {path}; name a test (tests/...), or a file or folder of "
            f"{listing(name for name in covered if '/' not in name)}"
        )


@functools.cache
def coverage_table(root: Path) -> dict[str, str]:
    """Return the table in CONTRIBUTING.md of the checkout at `root`: tests by folder or file.

    `unit` is tests/unit, `unit/mesh*` every tests/unit/test_mesh*.py. The longest entry that a path begins
    with applies.
    """
    table = (root / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("| changed | tests |")[2]
    return dict(re.findall(r"^\| `([^`]+)` \| `([^`]+)` \|$", table, re.MULTILINE))


def covering_tests(path: str, root: Path) -> list[str]:
    """Return the test files and folders that cover a path of the checkout.

    Args:
        path: Relative to the checkout, with "/".
        root: The checkout.

    Raises:
        UncoveredPathError: no entry of the table contains the path.
    """
    place, table = PurePosixPath(path), coverage_table(root)
    found = next((str(each) for each in (place, *place.parents) if str(each) in table), None)
    if found is None:
        raise UncoveredPathError(path, table)
    return [file for word in table[found].split() for file in files_of(word, root)]


def files_of(word: str, root: Path) -> list[str]:
    """Return the files and folders that a word of the table names, relative to the checkout."""
    folder, _, name = word.partition("/")
    if not name:
        return [f"tests/{folder}"]
    return sorted(f"tests/{folder}/{file.name}" for file in (root / "tests" / folder).glob(f"test_{name}.py"))


LIMIT_S = {False: 5400, True: 600}
"""Time limits in [s], for hanging tests."""

MOST_WORKERS = 6
"""Largest number of workers; each has its own robot, page and browser, about 1 GB.

A third of the tests' time is waiting for processes, so that one worker more than cores keeps the cores busy.
Quick tests do not wait.
"""

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
        "PATH is a test, or a file or folder of the product, such as softsim_core/physics/contact, whose "
        "tests run. All else goes to pytest: softsim test tests/unit -k codec. Other lanes: -m packaging, "
        "-m exhaustive."
    )


def command(arguments: argparse.Namespace, root: Path) -> list[str]:
    """Return the command line that runs the tests of the checkout at `root`.

    Packaging tests run if a named path contains them; without a path only `-m packaging` runs them.

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


def _with_tests(arguments: Sequence[str], root: Path) -> tuple[list[str], bool]:
    """Return the words with tests in place of paths of the product, and whether any word was a path."""
    words, has_paths, previous, root = list[str](), False, "", root.resolve()
    for word in arguments:
        place = (root / word.partition("::")[0]).resolve()
        is_path = previous not in _TAKES_A_VALUE and root in place.parents and place.exists()
        path = place.relative_to(root).as_posix() if is_path else ""
        words += covering_tests(path, root) if is_path and path.split("/")[0] != "tests" else [word]
        has_paths |= is_path
        previous = word
    return words, has_paths


def run(arguments: argparse.Namespace) -> int:
    """Compile the kernels if needed, then run pytest in place of this process.

    Its exit code is the command's (124: the time limit was reached).
    """
    root = Path(__file__).resolve().parents[3]
    if not (root / "tests").is_dir():
        raise CommandError(f"no tests beside the installed package ({root}); use a checkout")
    if importlib.util.find_spec("pytest") is None or importlib.util.find_spec("xdist") is None:
        raise CommandError(f"pytest or pytest-xdist is missing; {install_command('test')}")
    words = command(arguments, root)
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes would compile their sources
    run_process(python_command("softsim_core.simulation.warmup"), cwd=root)
    os.chdir(root)
    os.execvp(words[0], words)
