"""A machine for ./softsim: a checkout and a PATH that holds nothing but what a test puts there."""

from __future__ import annotations

import shutil
import stat
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
TOOLS = ("sh", "cat", "cksum", "dirname", "readlink", "head", "printf")  # of every POSIX system
NEEDED_FILES = ("softsim", "pyproject.toml", "requirements.lock")


def executable(file: Path, text: str) -> Path:
    file.write_text(text)
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    return file


class Machine:
    """A checkout and a PATH of its own: what it holds is all the launcher can find."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.installer = ""  # a word for the tests
        self.checkout = folder / "check out"  # a blank in the name must not matter
        self.bin = folder / "bin"
        self.home = self.checkout / ".softsim"
        self.bin.mkdir()
        self.checkout.mkdir()
        for name in TOOLS:
            (self.bin / name).symlink_to(shutil.which(name) or f"/bin/{name}")
        for name in NEEDED_FILES:
            shutil.copy2(REPOSITORY / name, self.checkout / name)
        (self.checkout / "softsim_ros" / "cli").mkdir(parents=True)
        shutil.copy2(REPOSITORY / "softsim_ros/cli/install.py", self.checkout / "softsim_ros/cli/install.py")
        self.variables = {"PATH": str(self.bin), "HOME": str(folder)}

    def add_python(
        self, name: str, suits: bool = True, has_venv: bool = True, says: str = "Python 3.12.1"
    ) -> Path:
        """A Python as the launcher meets it: answers its questions, and can be real where it has to work."""
        return executable(
            self.bin / name,
            f"""#!/bin/sh
case "$*" in
*"(3, 10)"*) exit {0 if suits else 1} ;;
*"import ensurepip"*) exit {0 if has_venv else 1} ;;
*%d.%d*) echo 3.12 ;;
-V) echo "{says}" ;;
*) exec {sys.executable} "$@" ;;
esac
""",
        )

    def start(self, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["sh", self.checkout / "softsim", *words],
            env=self.variables | variables,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    def start_in_background(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            ["sh", self.checkout / "softsim", "hello"],
            env=self.variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )


def one_sentence(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 1, done
    assert "Traceback" not in done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("softsim: ")
    return last
