"""Makes the Python environment of a checkout; ./softsim runs it with any Python 3.10 to 3.13.

Safe to interrupt (the next start begins again), safe to start twice (the second waits for the first), and it
shows what it is doing: a line per stage, with a moving last line in a terminal.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

EXTRAS = (
    "test,viewer,recording,report,c3d,mesh"  # of pyproject.toml, on every machine; ros where its wheels fit
)
NEEDED_BYTES = 1_500_000_000  # measured: 1.1 GB on disk, and the wheels pass through a cache
TAIL_LINES, TAIL_COLUMNS = 15, 200
BEAT_S = 0.2  # of the moving line in a terminal
QUIET_BEAT_S = 15.0  # between lines where there is no terminal
EXIT_INTERRUPTED = 130

CAUSES = (  # what an installer's log says -> what a person can do
    (
        r"No space left on device|Errno 28|Disk quota exceeded",
        "the disk is full; free about 1.5 GB, or put the environment elsewhere with SOFTSIM_HOME=/other/disk",
    ),
    (
        r"name resolution|Name or service not known|Network is unreachable|NewConnectionError|ConnectionError"
        r"|Connection refused|Connection reset|timed? ?out|dns error|error sending request|ProxyError"
        r"|Could not fetch URL|--no-index|network was disabled",
        "the package index cannot be reached; connect to the network (or set up pip's proxy) and start again",
    ),
    (
        r"Permission denied|Errno 13|Read-only file system|Errno 30",
        "a file cannot be written; check the owner of the folder, or name another with SOFTSIM_HOME",
    ),
    (
        r"No matching distribution|not find a version|No solution found|ResolutionImpossible",
        "the package index offers no build of a pinned package for this Python; try another one "
        "with SOFTSIM_PYTHON, or look whether pip is set up to use another index (pip config list)",
    ),
)


class InstallError(RuntimeError):
    """The environment could not be made; the text says why and what to do."""


def ros_wheels_fit() -> str | None:
    """None where the pip wheels of ROS 2 run on this machine, else why they do not."""
    system, machine = platform.system(), platform.machine()
    if (system, machine) != ("Linux", "x86_64"):
        return f"they exist for x86-64 Linux only, and this is {system} on {machine}"
    library, version = platform.libc_ver()
    if library != "glibc" or tuple(map(int, version.split(".")[:2])) < (2, 28):
        return (
            f"they need glibc 2.28 or newer, and this system has {library or 'another C library'} {version}"
        )
    return None


def likely_cause(log: str) -> str:
    """One sentence on why an installer failed, from its log (its last 200 lines)."""
    recent = "\n".join(log.splitlines()[-200:])
    for pattern, sentence in CAUSES:
        if re.search(pattern, recent, re.IGNORECASE):
            return sentence
    return "see the lines above"


class Stages:
    """Shows stages as they run, and keeps everything the programs print in a log file."""

    def __init__(self, log: Path, total: int) -> None:
        """`total` stages will be shown; `log` is made anew."""
        self.log, self.total, self.number = log, total, 0
        self.terminal = sys.stderr.isatty()
        self.log.write_text("", encoding="utf-8")

    def run(self, title: str, command: Sequence[str | Path]) -> None:
        """Run one program to its end.

        Raises:
            InstallError: it failed; the message carries the likely cause and the log's place.
        """
        self.number += 1
        head = f"[{self.number}/{self.total}] {title}"
        began = time.monotonic()
        before = self.log.stat().st_size
        with self.log.open("ab") as log:
            log.write(f"\n$ {' '.join(map(str, command))}\n".encode())
            log.flush()
            child = subprocess.Popen(
                [str(word) for word in command],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | {"PYTHONUNBUFFERED": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"},
            )
            try:
                self._watch(child, head, began)
            except BaseException:
                end(child)
                raise
        self._say(
            f"{head}: {'failed' if child.returncode else 'done'} in {time.monotonic() - began:.0f} s",
            last=True,
        )
        if child.returncode:
            text = self.log.read_bytes()[before:].decode(errors="replace")
            for line in text.splitlines()[-TAIL_LINES:]:
                print(f"    {line[:TAIL_COLUMNS]}", file=sys.stderr)
            raise InstallError(f"{likely_cause(text)} (all of its output: {self.log})")

    def _watch(self, child: subprocess.Popen[bytes], head: str, began: float) -> None:
        self._say(f"{head} ...", last=not self.terminal)
        beat = BEAT_S if self.terminal else QUIET_BEAT_S
        while True:
            try:
                child.wait(timeout=beat)
                return
            except subprocess.TimeoutExpired:
                self._say(
                    f"{head}: {time.monotonic() - began:.0f} s  {self._newest()}", last=not self.terminal
                )

    def _newest(self) -> str:
        """Last line of the log, short enough for one line of the terminal."""
        with self.log.open("rb") as log:
            log.seek(max(0, self.log.stat().st_size - 20_000))
            lines = log.read().decode(errors="replace").splitlines()
        telling = [line.strip() for line in lines if line.strip() and not line.startswith("WARNING")]
        return telling[-1][:TAIL_COLUMNS] if telling else ""

    def _say(self, line: str, last: bool) -> None:
        if self.terminal:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r\033[K{line[:width]}", end="\n" if last else "", file=sys.stderr, flush=True)
        else:
            print(line[:160], file=sys.stderr, flush=True)


def end(child: subprocess.Popen[bytes]) -> None:
    """End a program that runs in its own session, and what it started."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, number)
        try:
            child.wait(timeout=5)
            return
        except subprocess.TimeoutExpired:
            continue


@contextlib.contextmanager
def only_one(home: Path) -> Iterator[None]:
    """Hold the folder's lock; where another process installs, say so and wait. Freed even by kill -9."""
    with (home / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("softsim: another terminal is making the environment; waiting for it", file=sys.stderr)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def make_environment(root: Path, home: Path, stages: Stages, extras: str) -> None:
    """Build `home/venv` and install the checkout at `root` into it, editable, with pinned versions."""
    venv = home / "venv"
    python = venv / "bin" / "python"
    uv = shutil.which("uv")
    if not python.exists():
        maker = [uv, "venv", "--python", sys.executable] if uv else [sys.executable, "-m", "venv"]
        stages.run(f"Making a Python {platform.python_version()} environment in {venv}", [*maker, venv])
    else:
        stages.number += 1
    pip: list[str | Path] = [uv, "pip"] if uv else [python, "-m", "pip"]
    into: list[str | Path] = ["--python", python] if uv else ["--no-input"]
    pinned = [*pip, "install", *into, "-c", root / "constraints.txt"]
    stages.run("Installing the build tool", [*pinned, "setuptools"])
    stages.run(
        "Installing softsim and what it needs (about 300 MB to fetch)",
        [*pinned, "--no-build-isolation", "-e", f"{root}[{extras}]"],
    )
    try:
        stages.run("Compiling the physics kernels", [python, "-m", "softsim_core.warmup"])
    except InstallError as error:  # slower, not broken: they compile when first used, or the SciPy path runs
        print(f"softsim: the kernels are left for their first use: {error}", file=sys.stderr)


def install(root: Path, home: Path, stamp: str) -> None:
    """Bring the environment to `stamp`; does nothing where another process has just done it.

    Raises:
        InstallError: with a sentence on what to do.
    """
    home.mkdir(parents=True, exist_ok=True)
    stamp_file, unfinished = home / "stamp", home / "unfinished"
    with only_one(home):
        made = stamp_file.read_text(encoding="utf-8").rstrip("\n") if stamp_file.exists() else ""
        python_runs = os.access(home / "venv" / "bin" / "python", os.X_OK)
        if made == stamp and python_runs:
            return
        same_place = made.split("|")[1:] == stamp.split("|")[1:]
        if not same_place or not python_runs or unfinished.exists():
            shutil.rmtree(home / "venv", ignore_errors=True)
        free = shutil.disk_usage(home).free
        if not (home / "venv").exists() and free < NEEDED_BYTES:
            raise InstallError(
                f"{home} has {free / 1e9:.1f} GB free and the environment needs about "
                f"{NEEDED_BYTES / 1e9:.1f} GB; free some, or put it elsewhere with SOFTSIM_HOME=/other/disk"
            )
        print(f"softsim: first use of this version: making the Python environment in {home}", file=sys.stderr)
        missing = ros_wheels_fit()
        if missing:
            print(
                f"softsim: the ROS 2 wheels are left out: {missing}; the physics core works, "
                "the nodes need a ROS 2 Jazzy",
                file=sys.stderr,
            )
        unfinished.touch()
        stamp_file.unlink(missing_ok=True)
        extras = EXTRAS if missing else f"ros,{EXTRAS}"
        make_environment(root, home, Stages(home / "install.log", total=4), extras)
        stamp_file.write_text(stamp + "\n", encoding="utf-8")
        unfinished.unlink()


def main() -> int:
    """Entry point of the launcher; returns the exit code."""
    parser = argparse.ArgumentParser(description="Make the Python environment of a softsim checkout.")
    parser.add_argument("--root", type=Path, required=True, help="the checkout")
    parser.add_argument("--home", type=Path, required=True, help="folder that holds the environment")
    parser.add_argument("--stamp", required=True, help="identifies what gets installed")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        install(arguments.root, arguments.home, arguments.stamp)
    except InstallError as error:
        print(f"softsim: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"softsim: {error}; {likely_cause(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nsoftsim: interrupted; the next start begins again where needed", file=sys.stderr)
        return EXIT_INTERRUPTED
    return 0


if __name__ == "__main__":
    sys.exit(main())
