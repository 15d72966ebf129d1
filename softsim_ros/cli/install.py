"""Create the Python environment of a checkout; ./softsim runs this with any Python 3.10 to 3.13.

It can be interrupted (the next start begins again) and started twice (the second process waits for the
first). It shows what it is doing: a line per stage, with a moving last line in a terminal.
"""

from __future__ import annotations

import argparse
import ast
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

NEEDED_BYTES = 1_500_000_000  # measured: 1.1 GB on disk, and the wheels pass through a cache
TAIL_LINES, TAIL_COLUMNS = 15, 200
BEAT_S = 0.2  # period of the moving line in a terminal
QUIET_BEAT_S = 15.0  # period of lines without a terminal
EXIT_INTERRUPTED = 130

CAUSES = (  # pattern in an installer's log -> advice to the user
    (
        r"Hash mismatch|DO NOT MATCH THE HASHES|--require-hashes mode|Hash-checking is required",
        "a package came damaged or is not the one that requirements.lock describes, and was not installed; "
        "start again, and if it stays so, look which index pip is set up to use (pip config list)",
    ),
    (
        r"No space left on device|Errno 28|Disk quota exceeded",
        "the disk is full; free about 1.5 GB, or put the environment elsewhere with SOFTSIM_HOME=/other/disk",
    ),
    (
        r"name resolution|Name or service not known|Network is unreachable|NewConnectionError|ConnectionError"
        r"|Connection refused|Connection reset|timed? ?out|dns error|error sending request|ProxyError"
        r"|Could not fetch URL|--no-index|network was disabled|ConnectError|IncompleteRead|Connection broken"
        r"|IncompleteDownload|Wheel '.+' located at .+ is invalid|Failed to read from zip"  # half a file
        r"|end of file|error decoding",
        "the package index cannot be reached, or breaks off; connect to the network (or set up pip's proxy) "
        "and start again",
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


HOPELESS = 4
"""Number of causes, from the first one on, after which another installer would fail as well."""

OF_UV = {  # option of pip -> variable of uv
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "trusted-host": "UV_INSECURE_HOST",
    "timeout": "UV_HTTP_TIMEOUT",
    "default-timeout": "UV_HTTP_TIMEOUT",
    "proxy": "HTTPS_PROXY",
    "cert": "SSL_CERT_FILE",
}

LOCKED = re.compile(r"^([a-z0-9._-]+)==.*(?:\n[ \t]+.*)*\n", re.MULTILINE)
"""One package of requirements.lock: its name, version and condition, and the hashes of its files below."""

TOTAL_STAGES = 5

WITHOUT_UV = "SOFTSIM_WITHOUT_UV"
"""Variable that, set to 1, selects pip even if uv could be fetched."""


class InstallError(RuntimeError):
    """The environment could not be created; the text says why and what to do.

    Attributes:
        is_hopeless: Whether another installer would fail, too: no network, no disk space, no write
            permission.
    """

    def __init__(self, message: str, is_hopeless: bool = True) -> None:
        super().__init__(message)
        self.is_hopeless = is_hopeless


def ros_wheels_fit() -> str | None:
    """Return None if the pip wheels of ROS 2 run on this machine, else why they do not."""
    system, machine = platform.system(), platform.machine()
    if (system, machine) != ("Linux", "x86_64"):
        return f"they exist for x86-64 Linux only, and this is {system} on {machine}"
    library, version = platform.libc_ver()
    if library != "glibc" or tuple(map(int, version.split(".")[:2])) < (2, 28):
        return (
            f"they need glibc 2.28 or newer, and this system has {library or 'another C library'} {version}"
        )
    return None


def likely_cause(log: str) -> tuple[str, bool]:
    """Return a message on why an installer failed, and whether another one would fail as well.

    Args:
        log: Its output, of which the last 200 lines count.
    """
    recent = "\n".join(log.splitlines()[-200:])
    for number, (pattern, advice) in enumerate(CAUSES):
        if re.search(pattern, recent, re.IGNORECASE):
            return advice, number < HOPELESS
    return "see the lines above", False


class Stages:
    """Shows stages as they run, and writes everything that the programs print to a log file."""

    def __init__(self, log: Path, total: int) -> None:
        """Show `total` stages; create a new `log`."""
        self.log, self.total, self.number = log, total, 0
        self.terminal = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self.log.write_text("", encoding="utf-8")

    def run(
        self, title: str, command: Sequence[str | Path], variables: Mapping[str, str] | None = None
    ) -> None:
        """Run one program to its end, with additional environment variables.

        It runs in the folder of the log, because the current folder may contain foreign files.

        Raises:
            InstallError: it failed; the message contains the likely cause and the path of the log.
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
                cwd=self.log.parent,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={
                    **os.environ,
                    "PIP_DISABLE_PIP_VERSION_CHECK": "1",
                    **uv_settings(),
                    **(variables or {}),
                },
            )
            try:
                self._watch(child, head, began)
            except BaseException:
                end(child)
                raise
        outcome = "failed" if child.returncode else "done"
        self._say(f"{head}: {outcome} in {time.monotonic() - began:.0f} s", last=True)
        if child.returncode:
            text = self.log.read_bytes()[before:].decode(errors="replace")
            for line in text.splitlines()[-TAIL_LINES:]:
                print(f"    {line[:TAIL_COLUMNS]}", file=sys.stderr)
            advice, is_hopeless = likely_cause(text)
            raise InstallError(f"{advice} (all of its output: {self.log})", is_hopeless)

    def _watch(self, child: subprocess.Popen[bytes], head: str, began: float) -> None:
        self._say(f"{head} ...", last=not self.terminal)
        beat = BEAT_S if self.terminal else QUIET_BEAT_S
        while True:
            try:
                child.wait(timeout=beat)
                return
            except subprocess.TimeoutExpired:
                spent = f"{time.monotonic() - began:.0f} s"
                self._say(f"{head}: {spent}  {self._newest()}", last=not self.terminal)

    def _newest(self) -> str:
        """Return the last line of the log, short enough for one line of the terminal."""
        with self.log.open("rb") as log:
            log.seek(max(0, self.log.stat().st_size - 20_000))
            lines = log.read().decode(errors="replace").splitlines()
        shown = [line.strip() for line in lines if line.strip() and not line.startswith("WARNING")]
        return shown[-1][:TAIL_COLUMNS] if shown else ""

    def _say(self, line: str, last: bool) -> None:
        if self.terminal:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r\033[K{line[:width]}", end="\n" if last else "", file=sys.stderr, flush=True)
        else:
            print(line[:160], file=sys.stderr, flush=True)


def end(child: subprocess.Popen[bytes]) -> None:
    """End a program that runs in its own session, and its children."""
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
    """Lock the folder; if another process installs, report that and wait. Even kill -9 releases the lock."""
    with (home / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("softsim: another terminal is making the environment; waiting for it", file=sys.stderr)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def python_program(python: str | Path, module: str) -> list[str]:
    """Return the command that runs a module and imports nothing from the current folder or PYTHONPATH."""
    return [str(python), "-I", "-u", "-m", module]


def pip_settings(python: str | Path) -> dict[str, str]:
    """Return the settings of pip's files and variables, by option name; without pip, of its variables."""
    done = subprocess.run(
        [*python_program(python, "pip"), "config", "list"], capture_output=True, text=True, check=False
    )
    settings: dict[str, str] = {}
    for section in ("global", "install", ":env:"):  # later ones override earlier ones
        for line in done.stdout.splitlines():
            name, _, value = line.partition("=")
            if name.startswith(f"{section}."):
                with contextlib.suppress(ValueError, SyntaxError):
                    settings[name[len(section) + 1 :]] = str(ast.literal_eval(value))
    if done.returncode:
        for name, value in os.environ.items():
            if name.startswith("PIP_") and value:
                settings[name[4:].lower().replace("_", "-")] = value
    return settings


def uv_variables(pip: Mapping[str, str]) -> dict[str, str]:
    """Return variables that make uv use the same index in the same way as pip.

    Variables that the user has set take precedence.
    """
    values = ((variable, pip.get(option, "").split()) for option, variable in OF_UV.items())
    variables = {variable: " ".join(words) for variable, words in values if words}
    if "UV_INDEX" in variables:  # any index that has the pinned version, as pip does
        variables["UV_INDEX_STRATEGY"] = "unsafe-best-match"
    if "UV_FIND_LINKS" in variables:
        variables["UV_FIND_LINKS"] = variables["UV_FIND_LINKS"].replace(" ", ",")
    if "HTTPS_PROXY" in variables:
        variables["HTTP_PROXY"] = variables["HTTPS_PROXY"]
    return {variable: value for variable, value in variables.items() if not os.environ.get(variable)}


def uv_settings() -> dict[str, str]:
    """Return variables that make uv read the settings of the user or the system, and those of no folder.

    uv reads a `uv.toml` in the current folder or one above it, which may name another package index.
    """
    if os.environ.get("UV_CONFIG_FILE") or os.environ.get("UV_NO_CONFIG"):
        return {}
    own = os.environ.get("XDG_CONFIG_HOME") or Path("~/.config").expanduser()
    for folder in (Path(own), Path("/etc")):
        if (folder / "uv" / "uv.toml").is_file():
            return {"UV_CONFIG_FILE": str(folder / "uv" / "uv.toml")}
    return {"UV_NO_CONFIG": "1"}


def select_locked_packages(lock: str, is_needed: Callable[[str], bool]) -> str:
    """Return the part of a lock file with the packages that are needed, with their versions and hashes."""
    return "".join(found[0] for found in LOCKED.finditer(lock) if is_needed(found[1]))


def installer(python: Path, stages: Stages, of_uv: Path) -> tuple[list[str | Path], dict[str, str]] | None:
    """Return command and variables of uv, from the PATH or else fetched into the environment; None: use pip.

    `of_uv` is the file that locks it.

    Raises:
        InstallError: it cannot be fetched, and pip could fetch nothing either.
    """
    uv: str | Path | None = shutil.which("uv")
    if uv is None and os.environ.get(WITHOUT_UV, "0") in ("", "0"):
        uv = python.with_name("uv")
        fetch: list[str | Path] = [*python_program(python, "pip"), "install", "--no-input", *of_file(of_uv)]
        try:
            stages.run("Fetching the installer (uv)", fetch)
        except InstallError as error:
            if error.is_hopeless:
                raise
            print("softsim: uv cannot be had here; pip does it, more slowly", file=sys.stderr)
            uv = None
    else:
        stages.number += 1
    if uv is None:
        return None
    own = python if not shutil.which("uv") else sys.executable  # an environment that uv made has no pip
    settings = pip_settings(own)
    command: list[str | Path] = [uv, "pip", "install", "--python", python]
    if settings.get("no-index", "").lower() in ("1", "true", "yes", "on"):
        command.append("--no-index")
    return command, uv_variables(settings)


def of_file(requirements: Path) -> list[str | Path]:
    """Return the options that install the packages of a file, if each download has one of its hashes."""
    return ["--require-hashes", "-r", requirements]


def make_environment(root: Path, home: Path, stages: Stages, with_ros: bool) -> None:
    """Build `home/venv` and install the checkout at `root` into it, editable, with its dependencies.

    Every download has a version and a hash in `root/requirements.lock`.
    """
    venv, lock = home / "venv", (root / "requirements.lock").read_text(encoding="utf-8")
    python = venv / "bin" / "python"
    if not python.exists():
        uv = shutil.which("uv")
        maker = [uv, "venv", "--python", sys.executable] if uv else python_program(sys.executable, "venv")
        stages.run(f"Making a Python {platform.python_version()} environment in {venv}", [*maker, venv])
    else:
        stages.number += 1
    needed = {
        "uv": lambda name: name == "uv",
        "tool": lambda name: name == "setuptools",
        "all": lambda name: name != "uv" and (with_ros or not name.startswith("ros-")),
    }
    files = {what: home / f"requirements-{what}.txt" for what in needed}
    for what, is_needed in needed.items():
        files[what].write_text(select_locked_packages(lock, is_needed), encoding="utf-8")
    found = installer(python, stages, files["uv"])
    pip: list[str | Path] = [*python_program(python, "pip"), "install", "--no-input"]
    for title, words in (
        ("Installing the build tool", of_file(files["tool"])),
        (
            "Installing what softsim needs (about 300 MB to fetch)",
            ["--no-build-isolation", *of_file(files["all"])],
        ),
        ("Installing softsim", ["--no-build-isolation", "--no-deps", "-e", root]),
    ):
        command, variables = found or (pip, {})
        try:
            stages.run(title, [*command, *words], variables)
        except InstallError as error:
            if found is None or error.is_hopeless or not python.with_name("pip").exists():
                raise
            print("softsim: uv did not manage; trying pip", file=sys.stderr)
            found, stages.number = None, stages.number - 1
            stages.run(title, [*pip, *words])


def install(root: Path, home: Path, stamp: str) -> None:
    """Bring the environment to `stamp`; do nothing if another process has just done it.

    If creating the environment fails or is interrupted, none is left. If changing it fails, the next start
    creates it again.

    Raises:
        InstallError: with a message on what to do.
    """
    home.mkdir(parents=True, exist_ok=True)
    stamp_file, unfinished, venv = home / "stamp", home / "unfinished", home / "venv"
    with only_one(home):
        made = stamp_file.read_text(encoding="utf-8").rstrip("\n") if stamp_file.exists() else ""
        python_runs = os.access(venv / "bin" / "python", os.X_OK)
        if made == stamp and python_runs:
            return
        same_place = made.split("|")[1:] == stamp.split("|")[1:]
        if not same_place or not python_runs or unfinished.exists():
            shutil.rmtree(venv, ignore_errors=True)
        free, anew = shutil.disk_usage(home).free, not venv.exists()
        if anew and free < NEEDED_BYTES:
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
        try:
            make_environment(root, home, Stages(home / "install.log", TOTAL_STAGES), not missing)
            whole = home / "stamp.new"  # written to another file first, so that a stamp is complete or absent
            whole.write_text(stamp + "\n", encoding="utf-8")
            whole.replace(stamp_file)
        except BaseException:
            if anew:
                shutil.rmtree(venv, ignore_errors=True)
            raise
        unfinished.unlink()


def main() -> int:
    """Run the launcher's entry point; return the exit code."""
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
        print(f"softsim: {error}; {likely_cause(str(error))[0]}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nsoftsim: interrupted; the next start begins again where needed", file=sys.stderr)
        return EXIT_INTERRUPTED
    return 0


if __name__ == "__main__":
    sys.exit(main())
