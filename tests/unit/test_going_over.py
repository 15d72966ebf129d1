"""A simulation goes over to compiled kernels while it moves: nothing jumps, no step is lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_processes import compiled_kernels
from small_scenes import assert_same, machine
from waiting import spin_until

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

from softsim_core import Simulation, load_scene  # noqa: E402
from softsim_core.base import SceneError  # noqa: E402
from softsim_core.physics.contact import ContactSettings  # noqa: E402
from softsim_core.physics.kernels import alone  # noqa: E402
from softsim_core.simulation import small_scene, touching_scene  # noqa: E402
from softsim_ros.nodes.simulator import PhysicsThread  # noqa: E402

TOLERANCE = 1e-10  # that of test_steppers_agree
REPOSITORY = Path(__file__).resolve().parents[2]
WARM_UP = [sys.executable, "-m", "softsim_core.simulation.warmup", "--beside", "--small"]


def moved(simulation: Simulation, step: int) -> None:
    reach = 0.3 if simulation.robot.name == "tripod" else 0.001
    rest = simulation.model.rest_state().joint_positions
    simulation.command(rest + reach * np.sin(0.2 * step + np.arange(len(rest))))
    simulation.step()


@pytest.mark.parametrize(
    ("make", "tolerance"),
    [
        (lambda: load_scene("tripod"), TOLERANCE),
        (lambda: machine("polar"), TOLERANCE),
        (lambda: replace(touching_scene(), contact=ContactSettings(tolerance=1e-12)), 5e-5),
    ],
    ids=["tripod", "two bodies, every joint", "beam with cable and contact"],
)
@pytest.mark.slow
def test_the_motion_goes_on_as_if_nothing_had_happened(make: Callable[[], Any], tolerance: float) -> None:
    scene = make()
    plain, going = Simulation(scene, backend="scipy"), Simulation(scene, backend="scipy")
    for step in range(40):
        if step == 20:
            commanded, time_s = going.joint_targets, going.time
            going.set_damping(rayleigh_mass=1.5)
            plain.set_damping(rayleigh_mass=1.5)
            before = going.snapshot()
            going.step_by(Simulation(going.robot, backend="numba"))
            assert going.snapshot() == before  # to the last bit
            assert (going.backend, going.step_count, going.time) == ("numba", 20, time_s)
            np.testing.assert_array_equal(going.joint_targets, commanded)
        for each in (plain, going):
            moved(each, step)
        assert_same(going._state, plain._state, tolerance)
    assert plain.backend == "scipy"
    assert going.step_count == 40
    start = Simulation(scene, backend="scipy").positions
    assert np.abs(going.positions - start).max() > 1e-5


def test_another_scene_is_refused() -> None:
    beam = Simulation(small_scene(), backend="scipy")
    with pytest.raises(SceneError, match="of another scene"):
        beam.step_by(Simulation(touching_scene(), backend="scipy"))


class Log:
    def __init__(self) -> None:
        self.lines: list[str] = []
        self.info = self.warning = self.lines.append


@pytest.fixture
def physics(request: pytest.FixtureRequest) -> Any:
    """The Tripod in its start animation on the SciPy path, in a physics thread; keeps every step's state."""
    simulation = Simulation(load_scene("tripod"), backend="scipy")
    states: dict[int, np.ndarray] = {}

    def keep(run: Simulation, _: bool) -> float:
        states[run.step_count] = run.positions
        return 0.0

    thread = PhysicsThread(simulation, keep, *[lambda _: None] * 3)
    thread.states = states  # type: ignore[attr-defined]
    thread.start()
    yield thread
    thread.close()


@pytest.mark.slow
def test_a_running_robot_goes_over_between_two_steps(physics: Any) -> None:
    from softsim_ros.nodes.simulator import CompiledLater

    compiled_kernels()
    log = Log()
    later = CompiledLater(physics, None, log)
    assert spin_until(lambda: physics.status.steps > 20)
    later.start()
    assert spin_until(lambda: physics.status.backend == "numba" and log.lines), log.lines
    (line,) = log.lines
    first = int(line.split("from step ")[1].split()[0])
    assert spin_until(lambda: physics.status.steps > first + 50)
    later.close()
    physics.close()
    steps = sorted(physics.states)
    assert steps == list(range(len(steps)))  # none is lost
    alone = Simulation(load_scene("tripod"), backend="scipy")
    for step in range(1, first + 50):
        alone.step()
        scale = np.abs(alone.positions).max()
        np.testing.assert_allclose(physics.states[step], alone.positions, rtol=0, atol=TOLERANCE * scale)


@pytest.mark.exhaustive  # compiles for a minute
def test_a_scene_s_own_kernels_are_all_that_a_person_needs(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(REPOSITORY)}
    own = [
        sys.executable,
        "-m",
        "softsim_core.simulation.warmup",
        "--only",
        "--scene",
        str(load_scene("tripod").source),
    ]
    subprocess.run(own, env=environment, check=True)
    compiled = set(tmp_path.rglob("*.nbc"))
    assert compiled
    assert not list(tmp_path.rglob("ready-*"))
    code = (
        "from softsim_core import Simulation, load_scene\n"
        "run = Simulation(load_scene('tripod'), backend='numba')\n"
        "kept = run.snapshot()\n"
        "run.start_animation()\n"
        "run.set_damping(rayleigh_mass=1.0)\n"
        "run.base_shift = 0.001\n"
        "for step in range(20):\n"
        "    run.command([-0.01 * step] * 3)\n"
        "    run.forces = 0.001 + run.forces\n"
        "    run.step()\n"
        "run.von_mises(), run.frames(), run.joint_efforts\n"
        "run.restore(kept)\n"
        "run.step()\n"
    )
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    assert set(tmp_path.rglob("*.nbc")) == compiled  # nothing of it compiles while the robot moves


@pytest.mark.slow
def test_the_swap_loads_and_compiles_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot would wait for it; all of it is loaded beside the physics thread."""
    from numba.core.caching import Cache

    from softsim_ros.nodes.simulator import scene_files

    compiled_kernels()
    running = Simulation(load_scene("tripod"), backend="scipy")
    running.step()
    loaded = scene_files._build_with_kernels(running)
    looked_up: list[Any] = []
    load = Cache.load_overload

    def load_and_note(cache: Any, signature: Any, context: Any) -> Any:
        looked_up.append(signature)
        return load(cache, signature, context)

    monkeypatch.setattr(Cache, "load_overload", load_and_note)  # asked before each load and each compilation
    running.step_by(loaded)
    running.step()
    assert running.backend == "numba"
    assert looked_up == []


@pytest.mark.slow
def test_what_kernels_need_is_imported_before_the_robot_moves() -> None:
    """An import beside it shares Python's lock with its steps; in a new process, as the simulator is."""
    compiled_kernels()
    code = (
        "import sys\n"
        "from softsim_core import Simulation, load_scene\n"
        "from softsim_core.simulation import get_ready_to_load\n"
        "from softsim_ros.nodes.simulator import scene_files\n"
        "counts = [len(sys.modules)]\n"
        "get_ready_to_load()\n"
        "counts.append(len(sys.modules))\n"
        "running = Simulation(load_scene('tripod'), backend='scipy')\n"
        "running.step()\n"
        "counts.append(len(sys.modules))\n"
        "assert scene_files._build_with_kernels(running).compiled\n"
        "counts.append(len(sys.modules))\n"
        "print(counts[1] - counts[0], counts[3] - counts[2])\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    before, beside = map(int, run.stdout.split())
    assert 10 * beside < before, run.stderr


@pytest.mark.slow
def test_what_cannot_be_compiled_is_said_and_the_scipy_path_goes_on(physics: Any) -> None:
    from softsim_ros.nodes.simulator import CompiledLater

    log = Log()
    later = CompiledLater(physics, None, log)
    later._stages = [["--nonsense"]]
    later.start()
    assert spin_until(lambda: log.lines)
    assert "kernels were not compiled" in log.lines[0]
    assert "--nonsense" in log.lines[0]
    steps = physics.status.steps
    assert spin_until(lambda: physics.status.steps > steps + 5)
    assert physics.status.backend == "scipy"
    later.close()


@pytest.mark.slow
def test_a_scene_whose_file_is_gone_goes_over_once_all_kernels_stand(physics: Any, tmp_path: Path) -> None:
    from softsim_ros.nodes.simulator import CompiledLater

    compiled_kernels()
    log = Log()
    later = CompiledLater(physics, tmp_path / "gone.yaml", log)
    later.start()
    assert spin_until(lambda: physics.status.backend == "numba"), log.lines
    assert "gone.yaml: no such file" in log.lines[0]
    later.close()


@pytest.mark.slow
def test_the_end_does_not_wait_for_the_compiler(
    physics: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from softsim_ros.nodes.simulator import CompiledLater

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    later = CompiledLater(physics, None, Log())
    later.start()
    assert spin_until(lambda: any(tmp_path.rglob("*.nbc")), 150.0)
    child = later._child
    assert child is not None
    later.close()
    assert child.returncode == -signal.SIGKILL  # not at the end of its work
    assert physics.status.backend == "scipy"
    kept = set(tmp_path.rglob("*.nbc"))
    assert not list(tmp_path.rglob("ready-*"))  # the next start goes on from what is kept
    assert kept


@pytest.mark.slow
def test_the_compiler_does_not_outlive_the_robot(tmp_path: Path) -> None:
    code = (
        "import subprocess, time\n"
        f"child = subprocess.Popen({WARM_UP!r}, start_new_session=True)\n"
        "print(child.pid, flush=True); time.sleep(600)"
    )
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(REPOSITORY)}
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=variables) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert b"compiling" in parent.stdout.readline()
        parent.kill()
        parent.stdout.close()

    def is_gone() -> bool:
        try:
            return Path(f"/proc/{child}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
        except OSError:
            return True

    assert spin_until(is_gone)


def test_of_two_that_compile_one_waits(tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    order: list[str] = []
    file = tmp_path / "compiling"

    def wait() -> None:
        with alone(file):
            order.append("second")

    thread = threading.Thread(target=wait)
    with alone(file):
        thread.start()
        with file.open() as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        order.append("first")
    thread.join()
    assert order == ["first", "second"]
