"""./softsim on machines where something is wrong: one clear sentence, and a later start that mends it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from bare_machine import Machine, executable, one_sentence
from waiting import DEADLINE_S, spin_until

pytestmark = pytest.mark.packaging
REPOSITORY = Path(__file__).resolve().parents[2]


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
    (machine.bin / "cp").symlink_to(shutil.which("cp") or "/bin/cp")
    executable(
        machine.folder / "hello",
        """#!/bin/sh
case "$1" in -m) exit 0 ;; esac
shift
echo "hello from $*${PYTHONDONTWRITEBYTECODE:+, slow}"
""",
    )
    executable(
        machine.bin / "uv",
        f"""#!/bin/sh
echo "$@" >>"{machine.folder}/uv.log"
echo "$UV_DEFAULT_INDEX|$UV_INDEX|$UV_FIND_LINKS" >>"{machine.folder}/uv.index"
case "$*" in
venv\\ *) phase=venv ;;
*-tool.txt) phase=tool ;;
*) phase=packages ;;
esac
while [ -e "{machine.folder}/hang-$phase" ]; do sleep 0.05; done
case "$1" in
venv)
    for last in "$@"; do :; done
    mkdir -p "$last/bin"
    cp "{machine.folder}/hello" "$last/bin/python"
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
    assert spin_until(condition)


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


def test_packages_are_compiled_once_whatever_the_shell_says(installable: Machine) -> None:
    assert installable.start("hello", PYTHONDONTWRITEBYTECODE="1").stdout == "hello from hello\n"


def test_first_use_installs_and_later_starts_do_not(installable: Machine) -> None:
    first = installable.start("hello", "a b")
    assert first.returncode == 0, first.stderr
    assert first.stdout == "hello from hello a b\n"
    assert "[5/5]" in first.stderr
    calls = uv_calls(installable)
    later = installable.start("again")
    assert (later.stdout, later.stderr) == ("hello from again\n", "")
    assert uv_calls(installable) == calls


@pytest.mark.slow
def test_new_pins_are_installed(installable: Machine) -> None:
    installable.start("hello")
    calls = uv_calls(installable)
    with (installable.checkout / "requirements.lock").open("a") as pins:
        pins.write("# another pin\n")
    assert installable.start("hello").returncode == 0
    assert uv_calls(installable) > calls


@pytest.mark.slow
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
@pytest.mark.slow
def test_trouble_is_named_and_the_next_start_mends_it(
    installable: Machine, trouble: str, advice: str
) -> None:
    (installable.folder / trouble).touch()
    done = installable.start("hello")
    sentence = one_sentence(done)
    assert advice in sentence
    assert "install.log" in sentence
    assert not (installable.home / "venv").exists()  # nothing half made, and its room is free again
    assert not (installable.home / "stamp").exists()
    (installable.folder / trouble).unlink()
    assert installable.start("hello").stdout == "hello from hello\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.slow
def test_an_interrupted_install_is_mended(installable: Machine, number: signal.Signals) -> None:
    (installable.folder / "hang").touch()
    with installable.start_in_background() as first:
        wait_until(lambda: uv_calls(installable) >= 2)
        os.killpg(first.pid, number)
        _, error = first.communicate(timeout=DEADLINE_S)
    if number is not signal.SIGKILL:
        assert "interrupted; the next start begins again" in error
        assert not (installable.home / "venv").exists()
    (installable.folder / "hang").unlink()
    done = installable.start("hello")
    assert done.stdout == "hello from hello\n", done.stderr


@pytest.mark.parametrize(("phase", "calls"), [("venv", 1), ("tool", 2), ("packages", 3)])
@pytest.mark.slow
def test_ctrl_c_in_any_phase_leaves_nothing_half_made(installable: Machine, phase: str, calls: int) -> None:
    hang = installable.folder / f"hang-{phase}"
    hang.touch()
    with installable.start_in_background() as first:
        wait_until(lambda: uv_calls(installable) == calls)
        os.killpg(first.pid, signal.SIGINT)
        _, error = first.communicate(timeout=DEADLINE_S)
    assert "interrupted; the next start begins again" in error
    assert not {"venv", "stamp", "stamp.new"} & {each.name for each in installable.home.iterdir()}
    hang.unlink()
    done = installable.start("hello")
    assert done.stdout == "hello from hello\n", done.stderr


def test_uv_asks_the_index_that_pip_is_told(installable: Machine) -> None:
    own, more = "file:///nowhere/simple", "file:///nowhere/a file:///nowhere/b"
    done = installable.start("hello", PIP_INDEX_URL=own, PIP_EXTRA_INDEX_URL=more, PIP_FIND_LINKS="/x /y")
    assert done.returncode == 0, done.stderr
    asked = (installable.folder / "uv.index").read_text().splitlines()
    assert asked[1:] == [f"{own}|{more}|/x,/y"] * 3


def test_an_interrupt_while_another_installs_leaves_that_alone(installable: Machine) -> None:
    (installable.folder / "hang").touch()
    with installable.start_in_background() as first:
        wait_until(lambda: uv_calls(installable) >= 2)
        with installable.start_in_background() as second:
            assert second.stderr is not None
            assert "waiting for it" in second.stderr.readline()
            os.killpg(second.pid, signal.SIGINT)
            assert second.wait(DEADLINE_S) in (130, -signal.SIGINT)  # the shell is interrupted, too
        (installable.folder / "hang").unlink()
        assert first.communicate(timeout=DEADLINE_S)[0] == "hello from hello\n"


def test_tab_does_not_install(installable: Machine) -> None:
    done = installable.start("hello", _ARGCOMPLETE="1")
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "")
    assert uv_calls(installable) == 0


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
    assert uv_calls(installable) == 4  # one environment, three installs into it


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
    assert "exit codes:" in with_help.stdout


@pytest.mark.slow
def test_pip_without_a_network(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    closed = "http://127.0.0.1:9"  # the discard port: nobody answers
    done = machine.start(
        "doctor", SOFTSIM_PYTHON=sys.executable, PIP_PROXY=closed, PIP_RETRIES="1", PIP_CONFIG_FILE=os.devnull
    )
    assert "[2/5]" in done.stderr
    assert "cannot be reached" in one_sentence(done)
