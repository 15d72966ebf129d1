"""What the installer says about machines and logs."""

from __future__ import annotations

import platform
import shutil
from collections import namedtuple
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
        ("something nobody has seen", "see the lines above"),
    ],
)
def test_the_likely_cause_of_a_failed_install(line: str, advice: str) -> None:
    assert advice in install.likely_cause(f"Collecting numpy\n{line}\n")


def test_too_little_room_is_said_before_anything_is_fetched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**9, 9 * 10**8, 10**8))
    with pytest.raises(install.InstallError, match=r"has 0\.1 GB free .* SOFTSIM_HOME=/other/disk"):
        install.install(tmp_path, tmp_path / "home", "1|2|3")
    assert not (tmp_path / "home" / "venv").exists()
