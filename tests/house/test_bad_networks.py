"""./softsim with the real installers: an index that stalls or breaks off, a disk that fills up, no uv."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from bare_machine import Machine, one_sentence
from package_index import CUT, GONE, STALL, PackageIndex, wheel
from waiting import DEADLINE_S

pytestmark = [pytest.mark.slow, pytest.mark.packaging]

PROJECT = """[build-system]
requires = []
build-backend = "backend"
backend-path = ["."]
[project]
name = "softsim"
version = "1.0"
dynamic = ["dependencies", "optional-dependencies"]
"""
BACKEND = """import pathlib, shutil
def build_editable(folder, config_settings=None, metadata_directory=None):
    name = "softsim-1.0-py3-none-any.whl"
    shutil.copy(pathlib.Path(__file__).with_name("whole.whl"), pathlib.Path(folder, name))
    return name
"""
HELLO = "#!python\nimport many, sys\nprint('hello from', *sys.argv[1:])\n"
FILES = 400
"""Of the package that softsim needs here: enough to fill a small disk."""


@pytest.fixture
def index() -> Iterator[PackageIndex]:
    many = {"many/__init__.py": "", **{f"many/data_{each}.txt": "x" * 200 for each in range(FILES)}}
    packages = {"setuptools": wheel("setuptools", {"setuptools.py": ""}), "many": wheel("many", many)}
    with PackageIndex(packages).serving() as serving:
        yield serving


@pytest.fixture(params=["uv", "pip"])
def newcomer(request: pytest.FixtureRequest, tmp_path: Path, index: PackageIndex) -> Machine:
    """A machine with a Python and a checkout of a few files; with uv on its PATH, or without any."""
    machine = Machine(tmp_path)
    machine.installer = request.param
    (machine.checkout / "pyproject.toml").write_text(PROJECT)
    (machine.checkout / "backend.py").write_text(BACKEND)
    lock = "".join(
        f"{name}==1.0 \\\n    --hash=sha256:{hashlib.sha256(index.packages.get(name, b'')).hexdigest()}\n"
        for name in (*index.packages, "uv")
    )
    (machine.checkout / "requirements.lock").write_text(lock)
    whole = wheel("softsim", {"softsim-1.0.data/scripts/softsim": HELLO}, ("many",))
    (machine.checkout / "whole.whl").write_bytes(whole)
    here = Path(sys.base_prefix) / "bin" / f"python3.{sys.version_info.minor}"
    (machine.bin / here.name).symlink_to(here)
    uv = shutil.which("uv") or str(Path(sys.executable).with_name("uv"))
    if request.param == "uv":
        if not Path(uv).is_file():
            pytest.skip("no uv")
        (machine.bin / "uv").symlink_to(uv)
    machine.variables |= {
        "PIP_CONFIG_FILE": os.devnull,
        "PIP_INDEX_URL": index.address,
        "PIP_DEFAULT_TIMEOUT": str(round(DEADLINE_S)),
        "PIP_RETRIES": "0",
        "UV_HTTP_RETRIES": "0",
        "UV_CACHE_DIR": str(tmp_path / "cache"),
        "PIP_CACHE_DIR": str(tmp_path / "pip_cache"),
    }
    return machine


def nothing_is_half_made(machine: Machine) -> None:
    assert not (machine.home / "venv").exists()
    assert not (machine.home / "stamp").exists()


def test_a_network_that_is_slow_or_gone_in_the_middle(newcomer: Machine, index: PackageIndex) -> None:
    for trouble in (STALL, CUT) if newcomer.installer == "uv" else (CUT,):
        index.trouble["many"] = trouble
        done = newcomer.start("hello", **({"PIP_DEFAULT_TIMEOUT": "1"} if trouble == STALL else {}))
        sentence = {"uv": "cannot be reached, or breaks off; connect to the network", "pip": "came damaged"}
        assert sentence[newcomer.installer] in one_sentence(done), (trouble, done.stderr)
        nothing_is_half_made(newcomer)
    index.trouble["many"] = STALL
    index.stalled.clear()
    with newcomer.start_in_background() as first:
        assert index.stalled.wait(DEADLINE_S)
        os.killpg(first.pid, signal.SIGINT)
        _, error = first.communicate(timeout=DEADLINE_S)
    assert "interrupted; the next start begins again" in error
    nothing_is_half_made(newcomer)
    index.trouble.clear()
    done = newcomer.start("hello", "again")
    assert done.stdout == "hello from hello again\n", done.stderr
    assert ("uv cannot be had here; pip does it" in done.stderr) == (newcomer.installer == "pip")
    assert any(path.startswith("/simple/uv") for path in index.asked) == (newcomer.installer == "pip")


@pytest.mark.parametrize("newcomer", ["uv"], indirect=True)
def test_a_disk_that_fills_up(newcomer: Machine, index: PackageIndex, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size=4g,nr_inodes={FILES // 2}", "tmpfs", disk]
    if os.getuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no small disk can be mounted here")
    try:
        newcomer.home = disk / "home"
        done = newcomer.start("hello", SOFTSIM_HOME=str(newcomer.home))
        assert "the disk is full; free about 1.5 GB" in one_sentence(done), done.stderr
        nothing_is_half_made(newcomer)
        subprocess.run(["mount", "-o", "remount,nr_inodes=100000", disk], check=True)
        done = newcomer.start("hello", SOFTSIM_HOME=str(newcomer.home))
        assert done.stdout == "hello from hello\n", done.stderr
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("newcomer", ["uv"], indirect=True)
def test_a_package_that_the_index_has_not(newcomer: Machine, index: PackageIndex) -> None:
    index.trouble["many"] = GONE
    assert "offers no build of a pinned package" in one_sentence(newcomer.start("hello"))
    nothing_is_half_made(newcomer)


@pytest.mark.parametrize("exchanged", ["setuptools", "many"])
def test_a_package_that_was_exchanged_is_not_installed(
    newcomer: Machine, index: PackageIndex, exchanged: str
) -> None:
    index.packages[exchanged] = wheel(exchanged, {f"{exchanged}/__init__.py": "print('harm')"})
    done = newcomer.start("hello")
    assert "is not the one that requirements.lock describes, and was not installed" in one_sentence(done)
    assert "harm" not in done.stdout
    nothing_is_half_made(newcomer)


def test_a_package_that_nothing_describes_is_not_installed(newcomer: Machine, index: PackageIndex) -> None:
    more = wheel("more", {"more.py": ""})
    index.packages |= {"more": more, "many": wheel("many", {"many.py": ""}, ("more",))}
    digest = hashlib.sha256(index.packages["many"]).hexdigest()
    lock = newcomer.checkout / "requirements.lock"
    lock.write_text(re.sub(r"(many==1.0 .*\n.*sha256:)\w+", rf"\g<1>{digest}", lock.read_text()))
    assert "is not the one that requirements.lock describes" in one_sentence(newcomer.start("hello"))
    assert not any(path.startswith("/files/more") for path in index.asked)
    nothing_is_half_made(newcomer)
