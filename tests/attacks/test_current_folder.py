"""Programs of the suite in a folder full of modules of others, which are never imported."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tcp_ports import free_port
from waiting import DEADLINE_S, spin_until

REPOSITORY = Path(__file__).resolve().parents[2]
STARTED_S = 150.0

MODULE = "open({marker!r}, 'a').write(__name__ + ' in ' + ' '.join(__import__('sys').orig_argv) + '\\n')\n"


PROGRAMS = {
    "two workers of a batch": """
from softsim_core import Batch
from softsim_core.simulation import small_scene
batch = Batch(small_scene(), 2, workers=2, backend="scipy")
batch.step()
batch.close()
""",
    "workers of multiprocessing": """
import multiprocessing, os
from softsim_core.base import use_safe_path
if __name__ == "__main__":
    use_safe_path()
    for method in ("spawn", "forkserver"):
        with multiprocessing.get_context(method).Pool(1) as pool:
            assert pool.apply(os.getpid) != os.getpid()
""",
    "the process that compiles": """
import sys
import numpy as np
sys.path.append({beside!r})
import own_kernels
own_kernels.twice(np.ones(2))
assert not own_kernels.twice.for_python.stats.cache_misses
""",
    "settings of Numba": """
from softsim_core.physics.kernels import why_plain
assert why_plain() is None
import numba
assert not numba.config.CACHE_DIR, numba.config.CACHE_DIR
""",
    "the installer": """
import sys
from pathlib import Path
from softsim_ros.cli import install
install.pip_settings(sys.executable)
command = [*install.python_program(sys.executable, "pip"), "--version"]
install.Stages(Path({beside!r}, "log"), 1).run("pip", command)
""",
}

KERNELS = """
from pathlib import Path
from softsim_core.physics.kernels import Compiler
kernel = Compiler(Path(__file__).parent).kernel


@kernel
def twice(values):
    for i in range(len(values)):
        values[i] *= 2.0
"""


class HostileFolder:
    """A folder that holds a module for each name of the standard library and of all that is installed."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._marker = folder / "downloads", folder / "imported"
        self.folder.mkdir()
        names = set(sys.stdlib_module_names) | set(importlib.metadata.packages_distributions())
        for name in names - set(sys.builtin_module_names):
            if name.isidentifier() and not name.startswith(("softsim", "servo_bridge")):
                (self.folder / f"{name}.py").write_text(MODULE.format(marker=str(self._marker)))
        (self.folder / ".numba_config.yaml").write_text("cache_dir: cache\n")

    @property
    def imported(self) -> list[str]:
        """What was imported from it, and by which program."""
        return self._marker.read_text().splitlines() if self._marker.exists() else []

    def run(self, *command: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a program in the folder, with more variables in its environment."""
        return subprocess.run(
            [str(word) for word in command],
            cwd=self.folder,
            env={**os.environ, **variables},
            capture_output=True,
            text=True,
            timeout=STARTED_S,
            check=False,
        )


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> HostileFolder:
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return HostileFolder(tmp_path)


AS_ON_3_10 = """
from softsim_core.base import processes
processes._OPTION_SINCE, processes.SAFE_PATH = (9, 9), "NOTHING"
"""


def test_the_folder_does_harm(hostile: HostileFolder) -> None:
    """Where Python looks there: else this file would show nothing."""
    hostile.run(sys.executable, "-m", "json.tool", "--help")
    assert hostile.imported


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("python", ["", AS_ON_3_10], ids=["with -P", "without -P"])
def test_no_child_of_a_program_imports_from_the_current_folder(
    hostile: HostileFolder, tmp_path: Path, name: str, python: str
) -> None:
    if "Numba" in name or "compiles" in name:
        pytest.importorskip("numba")
    beside = tmp_path / "beside"
    beside.mkdir()
    (beside / "own_kernels.py").write_text(KERNELS)
    program = beside / "program.py"
    program.write_text(python + PROGRAMS[name].format(beside=str(beside)))
    done = hostile.run(sys.executable, program)
    assert done.returncode == 0, done.stderr
    assert hostile.imported == []


@pytest.mark.slow
@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 imports before any program runs")
@pytest.mark.parametrize(
    "module", ["softsim_core.simulation.warmup", "softsim_ros.cli", "servo_bridge.nodes.bridge_node"]
)
def test_a_module_that_is_run_by_hand_imports_nothing_from_there(hostile: HostileFolder, module: str) -> None:
    if module == "servo_bridge.nodes.bridge_node":
        pytest.importorskip("rclpy")
    done = hostile.run(sys.executable, "-m", module, "--help")
    assert done.returncode == 0, done.stderr
    assert hostile.imported == []


@pytest.mark.slow
@pytest.mark.parametrize("path", ["", ":{beside}", "{beside}:", "{beside}::{beside}"])
def test_the_launcher_imports_nothing_from_there(hostile: HostileFolder, tmp_path: Path, path: str) -> None:
    """With an environment, and without one: then it asks each Python what it can do."""
    launcher = REPOSITORY / "softsim"
    path = path.format(beside=tmp_path / "beside")
    for home in (REPOSITORY / ".softsim", tmp_path / "none"):
        done = hostile.run(
            launcher, "--version", SOFTSIM_HOME=str(home), SOFTSIM_PYTHON=sys.executable, PYTHONPATH=path
        )
        assert done.stdout.startswith("softsim "), done.stderr
    assert hostile.imported == []


@pytest.mark.ros
@pytest.mark.slow
def test_a_robot_with_its_page_imports_nothing_from_there(
    hostile: HostileFolder, tmp_path: Path, ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))  # so that they compile beside it
    program = shutil.which("softsim", path=Path(sys.executable).parent) or ""
    log = tmp_path / "log.txt"
    with log.open("w") as output:
        up = subprocess.Popen(
            [program, "up", "tripod", "--headless", "--port", str(free_port())],
            cwd=hostile.folder,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
        )
        try:
            words = ("begins on the SciPy path", "in a browser")
            assert spin_until(lambda: all(word in log.read_text() for word in words), STARTED_S), (
                log.read_text()
            )
            up.send_signal(signal.SIGINT)
            assert up.wait(DEADLINE_S) == 0, log.read_text()
        finally:
            up.kill()
            up.wait()
    assert hostile.imported == []
