"""`softsim test`: the test suite of the checkout, two workers, under a time limit."""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

from softsim_core.extras import install_command
from softsim_core.processes import python_command, run_process

LIMIT_S = {False: 5400, True: 600}
"""Time limits in [s], for what hangs."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--quick", action="store_true", help="leave the slow tests out")
    parser.add_argument(
        "--workers", default="2", metavar="N", help="test processes (default 2; 0: in this one)"
    )
    parser.usage = "softsim test [--quick] [--workers N] [pytest arguments]"
    parser.epilog = "Everything else goes to pytest: softsim test tests/unit -k codec"


def command(arguments: argparse.Namespace, root: Path) -> list[str]:
    """The command line that runs the tests of the checkout at `root`."""
    words = python_command("pytest", f"--rootdir={root}", "-c", root / "pyproject.toml")
    words += ["-n", arguments.workers, "--dist=loadfile"]
    if arguments.quick:
        words += ["-m", "not slow and not exhaustive"]
    timeout = shutil.which("timeout")
    limit = [timeout, "--foreground", "-k", "30", str(LIMIT_S[arguments.quick])] if timeout else []
    return [*limit, *words, *arguments.rest]


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
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes would compile their sources
    run_process(python_command("softsim_core.warmup"), cwd=root)
    _become(command(arguments, root), root)


def _become(words: list[str], folder: Path) -> NoReturn:
    os.chdir(folder)
    os.execvp(words[0], words)
