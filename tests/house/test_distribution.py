"""What PyPI gives: whole, the same bytes at every build, at work where no checkout is known."""

from __future__ import annotations

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from kernel_cache import share_kernels
from node_processes import domain_guards
from waiting import DEADLINE_S, spin_until

from softsim_node import BOOTSTRAP_MARK
from softsim_ros.cli import BROUGHT_BY

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge")
BUILD = """
import sys
out, *kinds = sys.argv[1:]
sys.path.insert(0, "build_backend")
import softsim_build
for kind in kinds:
    getattr(softsim_build, f"build_{kind}")(out)
"""
STARTS_WITHIN_S = 120.0


def known_files(*below: str) -> list[str]:
    """The files that git knows and those it would take."""
    if shutil.which("git") is None or not (REPOSITORY / ".git").exists():
        pytest.skip("no git checkout")
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", *below],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=True,
    )
    return [name for name in listed.stdout.split("\0") if name and (REPOSITORY / name).is_file()]


def build(source: Path, out: Path, *kinds: str) -> Path:
    """Write source archive ("sdist") and wheel of a tree; returns their folder."""
    out.mkdir()
    variables = {name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"}
    done = subprocess.run(
        [sys.executable, "-c", BUILD, out, *kinds],
        cwd=source,
        env=variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built of a clean copy whose files are of now."""
    folder = tmp_path_factory.mktemp("first")
    for name in known_files():
        if not name.startswith(("tests/", "docs/", "ros2_ws/")):
            (folder / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(REPOSITORY / name, folder / "copy" / name)
    return build(folder / "copy", folder / "dist", "sdist", "wheel")


@pytest.mark.slow
@pytest.mark.packaging
def test_two_builds_are_the_same_bytes(dist: Path, tmp_path: Path) -> None:
    copy = dist.parent / "copy"
    (copy / "README.md").touch()
    again = build(copy, tmp_path / "again", "sdist")
    (archive,), (first,) = again.iterdir(), dist.glob("*.tar.gz")
    assert archive.read_bytes() == first.read_bytes()
    with tarfile.open(archive) as packed:
        packed.extractall(tmp_path / "source", filter="data")  # files of another time than in the copy
    (source,) = (tmp_path / "source").iterdir()
    (wheel,) = build(source, tmp_path / "alone", "wheel").iterdir()
    assert wheel.read_bytes() == (dist / wheel.name).read_bytes()


@pytest.mark.slow
@pytest.mark.packaging
def test_the_wheel_holds_every_file_of_the_packages_and_configs(dist: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    code = {name for name in held if name.startswith(PACKAGES)}
    assert code == set(known_files(*PACKAGES))
    share = re.compile(r"softsim-[^/]*\.data/data/share/softsim/")
    configs = {share.sub("", name) for name in held if share.match(name)}
    assert configs == set(known_files("configs"))
    assert {name.split("/")[0] for name in held if not name.startswith("softsim-")} == set(PACKAGES)


@pytest.mark.slow
@pytest.mark.packaging
def test_the_source_archive_has_the_measurements_of_bench(dist: Path) -> None:
    (archive,) = dist.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        names = {name.partition("/")[2] for name in packed.getnames()}
    assert {name for name in names if re.match(r"benchmarks/.*\.pyi?$", name)} == set(
        known_files("benchmarks")
    )


@pytest.fixture(scope="module")
def environment(dist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel and the extra `ros` alone."""
    uv = shutil.which("uv") or str(Path(sys.executable).with_name("uv"))
    if not Path(uv).is_file():
        pytest.skip("no uv, which makes environments in seconds")
    folder = tmp_path_factory.mktemp("empty") / "environment"
    (wheel,) = dist.glob("*.whl")
    subprocess.run([uv, "venv", "-q", "--python", sys.executable, folder], check=True)
    install = [uv, "pip", "install", "-q", "--python", folder / "bin" / "python"]
    what = ["-c", REPOSITORY / "constraints.txt", f"softsim[ros] @ {wheel.as_uri()}"]
    for how in (["--offline"], []):  # what this machine has fetched already, else from the index
        done = subprocess.run([*install, *how, *what], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            break
    else:
        pytest.skip(f"packages cannot be had: {done.stderr.strip().splitlines()[-1]}")
    (packages,) = folder.glob("lib/python3*/site-packages")
    share_kernels(packages)
    return folder


def variables() -> dict[str, str]:
    """The environment's variables without what leads to this checkout or this environment."""
    lost = ("PYTHONPATH", "VIRTUAL_ENV", "AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", BOOTSTRAP_MARK)
    return {name: value for name, value in os.environ.items() if name not in lost}


@pytest.mark.slow
@pytest.mark.packaging
def test_the_first_example_of_the_readme_runs_from_the_wheel(environment: Path, tmp_path: Path) -> None:
    text = (REPOSITORY / "README.md").read_text()
    example = text.split("```python\n")[1].split("```")[0]
    where = "import softsim_core; print(softsim_core.__file__)"
    done = subprocess.run(
        [environment / "bin" / "python", "-c", f"{example}\n{where}"],
        cwd=tmp_path,
        env=variables(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().splitlines()[-1].startswith(str(environment))


@pytest.mark.slow
@pytest.mark.packaging
@pytest.mark.ros
def test_a_robot_is_up_in_any_folder(environment: Path, tmp_path: Path, ros_domain: int) -> None:
    log = tmp_path / "output.txt"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [environment / "bin" / "softsim", "up", "tripod", "--headless"],
            cwd=tmp_path,
            env={**variables(), "PYTHONUNBUFFERED": "1", "XDG_RUNTIME_DIR": str(tmp_path)},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=list(domain_guards),
        )
    try:
        up = lambda: "]: simulating " in log.read_text() or process.poll() is not None  # noqa: E731
        assert spin_until(up, STARTS_WITHIN_S), log.read_text()
        told = "no web page: viser is not installed (pip install 'softsim[viewer]')"
        assert spin_until(lambda: told in log.read_text(), STARTS_WITHIN_S), log.read_text()
        process.send_signal(signal.SIGINT)
        assert process.wait(DEADLINE_S) == 0, log.read_text()
    finally:
        process.kill()


@pytest.mark.slow
@pytest.mark.packaging
def test_what_an_extra_would_bring_is_named_in_a_sentence(environment: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [environment / "bin" / "softsim", "export", "a_bag"],
        cwd=tmp_path,
        env=variables(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr == (
        "softsim: rosbags is not installed; pip install 'softsim[recording]'; see softsim doctor\n"
    )


@pytest.mark.slow
@pytest.mark.packaging
@pytest.mark.parametrize("words", [[], ["--help"], ["--quick", "--nonsense"]])
def test_bench_says_that_it_needs_a_checkout(environment: Path, tmp_path: Path, words: list[str]) -> None:
    done = subprocess.run(
        [environment / "bin" / "softsim", "bench", *words],
        cwd=tmp_path,
        env=variables(),
        capture_output=True,
        text=True,
        check=False,
    )
    (packages,) = environment.glob("lib/python3*/site-packages")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        f"softsim: the measurements of softsim bench are not installed: {packages.resolve()} has no folder"
        " benchmarks; run ./softsim bench in a checkout\n"
    )


def imported() -> Iterator[str]:
    """First names of all that the packages import, but for Python's own modules and their own."""
    for package in PACKAGES:
        for file in (REPOSITORY / package).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.Import):
                    yield from (alias.name.partition(".")[0] for alias in node.names)
                elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                    yield node.module.partition(".")[0]


@pytest.mark.slow
def test_every_package_is_of_the_core_or_an_extra_brings_it() -> None:
    core = {"numpy", "scipy", "numba", "llvmlite", "meshio", "yaml", "ruamel", "serial"}
    core |= {"daqp", "jinja2", "lazy_loader"}
    foreign = set(imported()) - set(sys.stdlib_module_names) - set(PACKAGES)
    assert foreign - core == foreign & set(BROUGHT_BY)


def test_the_extras_that_are_named_are_there() -> None:
    project = (REPOSITORY / "pyproject.toml").read_text().split("[project.optional-dependencies]")[1]
    extras = set(re.findall(r"^(\w+) = \[", project.split("\n[")[0], re.MULTILINE))
    assert set(BROUGHT_BY.values()) <= extras
    (everything,) = re.findall(r'"softsim\[([\w,]+)\]"', project)
    left_out = extras - set(everything.split(","))  # what those need who work on it
    assert left_out == {"all", "test", "colcon", "peers", "docs", "train"}
