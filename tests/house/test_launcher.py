"""./softsim on machines where something is wrong: one clear sentence, and a later start that mends it."""

from __future__ import annotations

import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from waiting import DEADLINE_S

REPOSITORY = Path(__file__).resolve().parents[2]
TOOLS = ("sh", "cat", "cksum", "dirname", "readlink", "head", "printf")  # of every POSIX system
NEEDED_FILES = ("softsim", "pyproject.toml", "constraints.txt")


def executable(file: Path, text: str) -> Path:
    file.write_text(text)
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    return file


class Machine:
    """A checkout and a PATH of its own: what it holds is all the launcher can find."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
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


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


@pytest.fixture
def installable(machine: Machine) -> Iterator[Machine]:
    """A machine whose uv is a script: its environment only says hello; it waits and fails on request."""
    machine.add_python("python3.12")
    (machine.bin / "mkdir").symlink_to(shutil.which("mkdir") or "/bin/mkdir")
    (machine.bin / "chmod").symlink_to(shutil.which("chmod") or "/bin/chmod")
    (machine.bin / "sleep").symlink_to(shutil.which("sleep") or "/bin/sleep")
    executable(
        machine.bin / "uv",
        f"""#!/bin/sh
echo "$@" >>"{machine.folder}/uv.log"
case "$1" in
venv)
    for last in "$@"; do :; done
    mkdir -p "$last/bin"
    printf '#!/bin/sh\\ncase "$1" in -m) exit 0 ;; esac\\nshift; echo "hello from $*"\\n' >"$last/bin/python"
    chmod +x "$last/bin/python" ;;
pip)
    if [ -e "{machine.folder}/offline" ]; then echo "error sending request for url: dns error"; exit 2; fi
    if [ -e "{machine.folder}/full" ]; then echo "write: No space left on device (os error 28)"; exit 2; fi
    while [ -e "{machine.folder}/hang" ]; do sleep 0.05; done ;;
esac
""",
    )
    yield machine
    (machine.folder / "hang").unlink(missing_ok=True)


def uv_calls(machine: Machine) -> int:
    log = machine.folder / "uv.log"
    return len(log.read_text().splitlines()) if log.exists() else 0


def wait_until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        threading.Event().wait(0.02)


def one_sentence(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 1, done
    assert "Traceback" not in done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("softsim: ")
    return last


def test_without_any_python(machine: Machine) -> None:
    sentence = one_sentence(machine.start("doctor"))
    assert "no python3 was found" in sentence
    assert "sudo apt install python3 python3-venv" in sentence


def test_a_python_that_is_too_old(machine: Machine) -> None:
    old = machine.add_python("python3", suits=False, says="Python 3.8.18")
    sentence = one_sentence(machine.start("doctor", SOFTSIM_PYTHON=str(old)))
    assert "Python 3.8.18" in sentence
    assert "needs CPython 3.10 to 3.13" in sentence


def test_a_python_without_venv(machine: Machine) -> None:
    bare = machine.add_python("python3.12", has_venv=False)
    sentence = one_sentence(machine.start("doctor", SOFTSIM_PYTHON=str(bare)))
    assert sentence.endswith("sudo apt install python3.12-venv")


def test_a_wish_that_is_no_program(machine: Machine) -> None:
    sentence = one_sentence(machine.start("doctor", SOFTSIM_PYTHON="/no/such/python"))
    assert "/no/such/python, which is no program" in sentence


@pytest.mark.parametrize("variable", ["AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH"])
def test_a_sourced_system_ros_is_refused(machine: Machine, variable: str) -> None:
    done = machine.start("doctor", ROS_DISTRO="jazzy", **{variable: "/opt/ros/jazzy/lib"})
    assert "/opt/ros/jazzy) is active in this terminal and cannot be mixed" in one_sentence(done)


def test_first_use_installs_and_later_starts_do_not(installable: Machine) -> None:
    first = installable.start("hello", "a b")
    assert first.returncode == 0, first.stderr
    assert first.stdout == "hello from hello a b\n"
    assert "[4/4]" in first.stderr
    calls = uv_calls(installable)
    began = time.monotonic()
    later = installable.start("again")
    assert time.monotonic() - began < 1.0
    assert (later.stdout, later.stderr) == ("hello from again\n", "")
    assert uv_calls(installable) == calls


def test_new_pins_are_installed(installable: Machine) -> None:
    installable.start("hello")
    calls = uv_calls(installable)
    with (installable.checkout / "constraints.txt").open("a") as pins:
        pins.write("# another pin\n")
    assert installable.start("hello").returncode == 0
    assert uv_calls(installable) > calls


def test_a_moved_checkout_gets_a_new_environment(installable: Machine) -> None:
    installable.start("hello")
    installable.checkout = installable.checkout.rename(installable.folder / "moved")
    done = installable.start("hello")
    assert done.returncode == 0, done.stderr
    assert "making the Python environment in" in done.stderr


@pytest.mark.parametrize(
    ("trouble", "advice"),
    [("offline", "connect to the network"), ("full", "the disk is full; free about 1.5 GB")],
)
def test_trouble_is_named_and_the_next_start_mends_it(
    installable: Machine, trouble: str, advice: str
) -> None:
    (installable.folder / trouble).touch()
    done = installable.start("hello")
    sentence = one_sentence(done)
    assert advice in sentence
    assert "install.log" in sentence
    (installable.folder / trouble).unlink()
    assert installable.start("hello").stdout == "hello from hello\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_install_is_mended(installable: Machine, number: signal.Signals) -> None:
    (installable.folder / "hang").touch()
    with installable.start_in_background() as first:
        wait_until(lambda: uv_calls(installable) >= 2)
        os.killpg(first.pid, number)
        _, error = first.communicate(timeout=DEADLINE_S)
    if number is not signal.SIGKILL:
        assert "interrupted; the next start begins again" in error
    (installable.folder / "hang").unlink()
    done = installable.start("hello")
    assert done.stdout == "hello from hello\n", done.stderr


def test_two_at_once_install_once(installable: Machine) -> None:
    (installable.folder / "hang").touch()
    with installable.start_in_background() as first:
        wait_until(lambda: uv_calls(installable) >= 2)
        with installable.start_in_background() as second:
            assert second.stderr is not None
            said = second.stderr.readline()
            (installable.folder / "hang").unlink()
            outputs = [first.communicate(timeout=DEADLINE_S)[0], second.communicate(timeout=DEADLINE_S)[0]]
    assert "another terminal is making the environment" in said
    assert outputs == ["hello from hello\n", "hello from hello\n"]
    assert uv_calls(installable) == 3  # one environment, two installs into it


def test_help_needs_no_environment() -> None:
    with_help = subprocess.run(
        [REPOSITORY / "softsim", "--help"],
        env=os.environ | {"SOFTSIM_HOME": "/nonexistent", "SOFTSIM_PYTHON": sys.executable},
        capture_output=True,
        text=True,
        check=False,
    )
    assert with_help.returncode == 0, with_help.stderr
    assert "start here: softsim up tripod" in with_help.stdout


@pytest.mark.slow
def test_pip_without_a_network(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    closed = "http://127.0.0.1:9"  # the discard port: nobody answers
    done = machine.start(
        "doctor", SOFTSIM_PYTHON=sys.executable, PIP_PROXY=closed, PIP_RETRIES="1", PIP_CONFIG_FILE=os.devnull
    )
    assert "[2/4]" in done.stderr
    assert "cannot be reached" in one_sentence(done)
