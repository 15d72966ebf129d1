"""What the installer says about machines and logs, and with what it installs."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections import namedtuple
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from softsim_ros.cli import install


def machine(
    monkeypatch: pytest.MonkeyPatch, system: str, processor: str, library: tuple[str, str] = ("glibc", "2.36")
) -> None:
    monkeypatch.setattr(platform, "system", lambda: system)
    monkeypatch.setattr(platform, "machine", lambda: processor)
    monkeypatch.setattr(platform, "libc_ver", lambda: library)


@pytest.mark.parametrize(
    ("system", "processor", "library", "reason"),
    [
        ("Linux", "x86_64", ("glibc", "2.28"), None),
        ("Linux", "aarch64", ("glibc", "2.36"), "this is Linux on aarch64"),
        ("Darwin", "arm64", ("", ""), "this is Darwin on arm64"),
        ("Linux", "x86_64", ("glibc", "2.27"), "this system has glibc 2.27"),
        ("Linux", "x86_64", ("", ""), "another C library"),
    ],
)
def test_where_the_ros_wheels_run(
    monkeypatch: pytest.MonkeyPatch, system: str, processor: str, library: tuple[str, str], reason: str | None
) -> None:
    machine(monkeypatch, system, processor, library)
    found = install.ros_wheels_fit()
    assert found is None if reason is None else reason in str(found)


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("OSError: [Errno 28] No space left on device", "the disk is full"),
        (
            "Failed to establish a new connection: Temporary failure in name resolution",
            "connect to the network",
        ),
        ("OSError: [Errno 13] Permission denied: '/opt/x'", "check the owner"),
        ("ERROR: No matching distribution found for numba==0.68.1", "try another one with SOFTSIM_PYTHON"),
        (
            "  x Failed to download `numpy==1.0`\n  Hash mismatch for `numpy==1.0`",
            "requirements.lock describes",
        ),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE", "requirements.lock describes"),
        ("something nobody has seen", "see the lines above"),
    ],
)
def test_the_likely_cause_of_a_failed_install(line: str, advice: str) -> None:
    assert advice in install.likely_cause(f"Collecting numpy\n{line}\n")[0]


def test_too_little_room_is_said_before_anything_is_fetched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**9, 9 * 10**8, 10**8))
    with pytest.raises(install.InstallError, match=r"has 0\.1 GB free .* SOFTSIM_HOME=/other/disk"):
        install.install(tmp_path, tmp_path / "home", "1|2|3")
    assert not (tmp_path / "home" / "venv").exists()


class Recorded:
    """In the place of Stages: keeps the commands; those that hold a word of `fails` fail with its log."""

    def __init__(self, venv: Path, fails: Mapping[str, str]) -> None:
        self.venv, self.fails, self.number = venv, fails, 0
        self.commands: list[str] = []

    def run(
        self, title: str, command: Sequence[str | Path], variables: Mapping[str, str] | None = None
    ) -> None:
        self.number += 1
        line = " ".join(map(str, command)).replace(str(self.venv), "VENV")
        self.commands.append(line)
        for word, log in self.fails.items():
            if word in line:
                raise install.InstallError(log, install.likely_cause(log)[1])
        if " -m venv " in line:
            (self.venv / "bin").mkdir(parents=True)
            for name in ("python", "pip"):
                (self.venv / "bin" / name).touch()


NETWORK = "Failed to establish a new connection: Name or service not known"
NOT_OFFERED = "ERROR: No matching distribution found for uv"
LOCK = """# made by a command
setuptools==1.0 \\
    --hash=sha256:00
numpy==1.0 ; python_full_version < '3.11' \\
    --hash=sha256:01 \\
    --hash=sha256:02
ros-rcl==9.2.8
uv==1.0 \\
    --hash=sha256:03
"""
WITH_UV = [
    "-m venv VENV",
    "pip install --no-input --require-hashes -r HOME/requirements-uv.txt",
    "VENV/bin/uv pip install",
    "VENV/bin/uv pip install",
    "VENV/bin/uv pip install",
]
WITH_PIP = ["VENV/bin/python -I -u -m pip install"] * 3


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a lock, on a machine whose PATH has no program."""
    (tmp_path / "requirements.lock").write_text(LOCK)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setattr(install, "pip_settings", lambda _: {})
    return tmp_path


@pytest.mark.parametrize(
    ("fails", "expected"),
    [
        ({}, WITH_UV),
        ({"-uv.txt": NOT_OFFERED}, [*WITH_UV[:2], *WITH_PIP]),
        ({"bin/uv pip": "error: something odd"}, [*WITH_UV[:3], *WITH_PIP]),
    ],
    ids=["uv is fetched", "uv cannot be had", "uv fails"],
)
def test_uv_installs_and_pip_where_it_cannot(
    checkout: Path, fails: dict[str, str], expected: list[str]
) -> None:
    stages = Recorded(checkout / "venv", fails)
    install.make_environment(checkout, checkout, stages, True)  # type: ignore[arg-type]
    assert len(stages.commands) == len(expected)
    for line, part in zip(stages.commands, expected, strict=True):
        assert part.replace("HOME", str(checkout)) in line
    for line in stages.commands[1:-1]:
        assert f"--require-hashes -r {checkout}/requirements-" in line  # whatever installs
    assert stages.commands[-1].endswith(f"--no-deps -e {checkout}")


@pytest.mark.parametrize("with_ros", [True, False])
def test_what_is_fetched_is_what_the_lock_describes(checkout: Path, with_ros: bool) -> None:
    install.make_environment(checkout, checkout, Recorded(checkout / "venv", {}), with_ros)  # type: ignore[arg-type]
    of = {part: (checkout / f"requirements-{part}.txt").read_text() for part in ("uv", "tool", "all")}
    assert of["uv"] == "uv==1.0 \\\n    --hash=sha256:03\n"
    assert of["tool"] == "setuptools==1.0 \\\n    --hash=sha256:00\n"
    numpy = "numpy==1.0 ; python_full_version < '3.11' \\\n    --hash=sha256:01 \\\n    --hash=sha256:02\n"
    assert of["all"] == of["tool"] + numpy + "ros-rcl==9.2.8\n" * with_ros


@pytest.mark.parametrize("word", ["-uv.txt", "bin/uv pip", "-tool.txt"])
def test_without_a_network_pip_is_not_tried_as_well(checkout: Path, word: str) -> None:
    stages = Recorded(checkout / "venv", {word: NETWORK})
    with pytest.raises(install.InstallError, match="new connection"):
        install.make_environment(checkout, checkout, stages, True)  # type: ignore[arg-type]
    assert word in stages.commands[-1]


def test_a_person_may_do_without_uv(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(install.WITHOUT_UV, "1")
    stages = Recorded(checkout / "venv", {})
    install.make_environment(checkout, checkout, stages, True)  # type: ignore[arg-type]
    assert not any("uv" in line for line in stages.commands)


def test_uv_is_told_what_pip_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pip")
    for name in [*os.environ]:
        if name.startswith(("PIP_", "UV_")) or name in install.OF_UV.values():
            monkeypatch.delenv(name)
    file = tmp_path / "pip.conf"
    file.write_text("[global]\nindex-url = file:///a\nextra-index-url =\n  file:///b\n  file:///c\n")
    monkeypatch.setenv("PIP_CONFIG_FILE", str(file))
    monkeypatch.setenv("PIP_INDEX_URL", "file:///own")  # a variable wins over the file
    monkeypatch.setenv("PIP_FIND_LINKS", "/x /y")
    told = install.uv_variables(install.pip_settings(sys.executable))
    assert {name: value for name, value in told.items() if name.startswith("UV_")} == {
        "UV_DEFAULT_INDEX": "file:///own",
        "UV_INDEX": "file:///b file:///c",
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_FIND_LINKS": "/x,/y",
    }
    monkeypatch.setenv("UV_DEFAULT_INDEX", "file:///mine")  # and what uv is told already over both
    assert "UV_DEFAULT_INDEX" not in install.uv_variables({"index-url": "file:///a"})


def test_without_pip_its_variables_still_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIP_INDEX_URL", "file:///own")
    assert install.pip_settings("/bin/false")["index-url"] == "file:///own"
