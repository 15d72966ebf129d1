"""Damaged and foreign files of the kernel cache: never loaded, dropped with one warning, compiled again."""

from __future__ import annotations

import os
import random
import shutil
import stat
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_kernels import SOURCE, loaded

from softsim_core.base import LockError
from softsim_core.physics.kernels import alone

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

from softsim_core.physics.kernels import cache  # noqa: E402
from softsim_core.simulation import warm_up, warmup  # noqa: E402

REGIONS = 8
"""Of a file: a bit is flipped in each."""

STEPS = """
import hashlib
from softsim_core import Simulation, load_scene
simulation = Simulation(load_scene("tripod"), backend="numba")
simulation.command([-0.5, -1.0, -0.7])
for _ in range(5):
    simulation.step()
print(hashlib.sha256(simulation.snapshot()).hexdigest())
"""

Damage = Callable[[bytes, random.Random], bytes]


def flipped(region: int) -> Damage:
    """One bit of a region of the file is another one."""

    def damage(content: bytes, draw: random.Random) -> bytes:
        size = len(content)
        place = draw.randrange(region * size // REGIONS, max((region + 1) * size // REGIONS, 1))
        changed = bytearray(content)
        changed[place] ^= 1 << draw.randrange(8)
        return bytes(changed)

    return damage


DAMAGES: dict[str, Damage] = {
    "empty": lambda content, draw: b"",
    "cut": lambda content, draw: content[: draw.randrange(1, len(content))],
    "junk": lambda content, draw: draw.randbytes(len(content)),
    "a pickle of others": lambda content, draw: b"cos\nabort\n(tR.",
    **{f"a bit of part {region}": flipped(region) for region in range(REGIONS)},
}


def run(code: str, *words: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """The source of a package of three kernels that are in the cache."""
    (tmp_path / "kernels_here.py").write_text(SOURCE)
    loaded(tmp_path).four_times(np.ones(2))
    return tmp_path / "kernels_here.py"


def called(package: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Call the kernels of the package as another process would; what is warned of."""
    monkeypatch.setattr(cache, "_warned", False)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        values = np.ones(2)
        loaded(package.parent).four_times(values)
    assert values.tolist() == [4.0, 4.0]
    return [str(each.message) for each in caught if issubclass(each.category, UserWarning)]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.exhaustive)])
def test_a_damaged_file_is_compiled_again_with_one_warning(
    package: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, every: int
) -> None:
    for name, damage in list(DAMAGES.items())[suffix == "nbc" :: every]:
        files = sorted(package.parent.rglob(f"*.{suffix}"))
        assert len(files) == 2
        for file in files:
            file.write_bytes(damage(file.read_bytes(), random.Random(f"{name} {suffix}")))
        told = called(package, monkeypatch)
        assert len(told) == 1, name
        assert "dropped and compiled again" in told[0]
        assert called(package, monkeypatch) == [], name


@pytest.mark.parametrize("change", ["owner", "group", "everybody", "a folder", "a pipe", "a link to nothing"])
def test_what_others_own_or_may_write_is_not_loaded(
    package: Path, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    file = next(iter(package.parent.rglob("for_python/**/*.nbi")))
    if change == "owner":
        if os.geteuid() != 0:
            pytest.skip("only root gives files away")
        os.chown(file, 12345, -1)
    elif change in ("group", "everybody"):
        file.chmod(0o664 if change == "group" else 0o646)
    else:
        file.unlink()
        {"a folder": file.mkdir, "a pipe": lambda: os.mkfifo(file)}.get(
            change, lambda: file.symlink_to("x")
        )()
    told = called(package, monkeypatch)
    assert len(told) == (change != "a link to nothing")
    if change != "a folder":
        assert called(package, monkeypatch) == []
        assert file.stat().st_uid == os.geteuid()


def test_new_files_are_written_by_nobody_else_whatever_the_umask_is(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in (file for kind in ("nbi", "nbc") for file in package.parent.rglob(f"*.{kind}")):
        file.unlink()
    before = os.umask(0o000)
    try:
        called(package, monkeypatch)
    finally:
        os.umask(before)
    files = [file for kind in ("nbi", "nbc") for file in package.parent.rglob(f"*.{kind}")]
    assert files
    assert not [file for file in files if file.stat().st_mode & cache.OTHERS_MAY_WRITE]


def test_the_file_of_another_kernel_is_not_loaded(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernels = loaded(package.parent)
    kernels.twice(np.ones(2))
    for kind in ("nbi", "nbc"):
        twice, four = (
            next(iter(package.parent.rglob(f"for_python/**/*.{name}-*.{kind}")))
            for name in ("twice", "four_times")
        )
        shutil.copy2(twice, four)
    assert called(package, monkeypatch) == []


def test_a_folder_of_others_is_no_place_for_kernels(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(package.parent / "own"))
    (package.parent / "__pycache__").chmod(0o777)
    assert loaded(package.parent).compiler.cache.is_relative_to(package.parent / "own")


def test_a_disk_that_takes_nothing_stops_no_kernel(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: object, name: str, value: object) -> None:
        raise OSError(28, "No space left on device")

    shutil.rmtree(package.parent / "__pycache__")
    monkeypatch.setattr(cache.CheckedFiles, "_write", full)
    assert called(package, monkeypatch) == []


def test_the_lock_of_those_who_compile_follows_no_link(tmp_path: Path) -> None:
    kept = tmp_path / "kept.txt"
    kept.write_text("precious")
    (tmp_path / "compiling").symlink_to(kept)
    with pytest.raises(LockError, match="compiling"), alone(tmp_path / "compiling"):
        pass
    with alone(tmp_path / "other"):
        assert stat.S_IMODE((tmp_path / "other").stat().st_mode) == 0o600
    assert kept.read_text() == "precious"


def copied_cache(folder: Path) -> list[Path]:
    """A copy of the kernels that are compiled here, for NUMBA_CACHE_DIR; those of Python, smallest first."""
    warm_up()
    for compiler in warmup._compilers():
        assert compiler.cache is not None
        shutil.copytree(compiler.cache, folder / compiler.name, dirs_exist_ok=True)
    return sorted(folder.rglob("for_python/**/*.nb[ci]"), key=lambda file: file.stat().st_size)


def damaged_runs(folder: Path, count: int, draw: random.Random, files: list[Path], at_once: int = 1) -> None:
    """Damage so many files, some before each run: the robot moves by the same bytes every time."""
    expected = run(STEPS, NUMBA_CACHE_DIR=str(folder))
    assert expected.returncode == 0, expected.stderr
    kinds = list(DAMAGES)
    for number in range(0, count, at_once):
        whole = [file for file in files if file.stat().st_size]  # an emptied one may stay so
        damaged = {
            file: kinds[(number + k) % len(kinds)] for k, file in enumerate(draw.sample(whole, at_once))
        }
        for file, name in damaged.items():
            file.write_bytes(DAMAGES[name](file.read_bytes(), draw))
        done = run(STEPS, NUMBA_CACHE_DIR=str(folder))
        assert done.returncode == 0, f"{damaged}\n{done.stderr}"
        assert done.stdout == expected.stdout, damaged
        assert done.stderr.count("Warning: a compiled kernel is dropped") <= 1
        print(f"{number + at_once} of {count}: {damaged}", flush=True)


@pytest.mark.slow
def test_a_robot_with_damaged_kernels_moves_by_the_same_bytes(tmp_path: Path) -> None:
    files = copied_cache(tmp_path)
    damaged_runs(tmp_path, 2, random.Random(1), files[: len(files) // 4])


@pytest.mark.exhaustive
def test_a_robot_moves_by_the_same_bytes_whatever_is_damaged(tmp_path: Path) -> None:
    damaged_runs(tmp_path, 200, random.Random(2), copied_cache(tmp_path), at_once=5)
