"""The threads of a step: they change nothing in what comes out, end with their process, survive a fork."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from softsim_core import ConfigError, SceneError, Simulation, SolverSettings, load_scene
from softsim_core.base import usable_cores

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

from softsim_core.physics.linalg import (  # noqa: E402
    divided_factor,
    usable_threads,
)


@pytest.fixture(autouse=True)
def _small_trees_are_divided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(divided_factor, "WORTHWHILE", 0.0)


def moved(name: str, solver: str, threads: int, steps: int = 12) -> Simulation:
    """A scene after some steps in which its joints go to and fro."""
    settings = {"solver": {"linear_solver": solver, "threads": threads}}
    simulation = Simulation(load_scene(name, settings), backend="numba")
    for step in range(steps):
        drive(simulation, step)
    return simulation


def drive(simulation: Simulation, step: int) -> None:
    """One step, on the way to a command near the present one."""
    limits = [joint.limits for joint in simulation.robot.joints]
    middle = np.array([joint.rest for joint in simulation.model.joints])
    reach = np.array([min(each.upper, 1.0) for each in limits]) - middle
    if len(limits):
        simulation.command(middle + 0.4 * reach * np.abs(np.sin(0.4 * step + np.arange(len(limits)))))
    simulation.step()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "solver"),
    [
        ("cable_gripper", "supernodal"),  # cables, contact with friction
        ("cable_gripper", "iterative"),
        ("tripod_ball", "supernodal"),  # servos, a free frame, a rigid body that rolls
    ],
)
def test_states_are_the_same_bit_by_bit(name: str, solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    states = []
    for threads in (1, 2, 3):
        simulation = moved(name, solver, threads)
        states.append(simulation.snapshot())
        if threads == 1:
            start = simulation.snapshot()
            for step in range(12, 16):
                drive(simulation, step)
            further = simulation.snapshot()
    assert states[0] == states[1] == states[2]
    again = moved(name, solver, 2, steps=0)  # a snapshot goes on with another number of threads
    again.restore(start)
    for step in range(12, 16):
        drive(again, step)
    assert again.snapshot() == further
    monkeypatch.setattr(divided_factor, "WORTHWHILE", np.inf)  # one part: sums in another order
    whole = moved(name, solver, 1, steps=16)
    assert np.abs(again.positions - whole.positions).max() < 1e-7


def test_statics_take_the_threads_too() -> None:
    rest = [moved("cable_finger", "auto", threads, steps=0).equilibrium([0.004]) for threads in (1, 2)]
    assert np.array_equal(rest[0].state.positions, rest[1].state.positions)


def test_one_setting_says_how_many(monkeypatch: pytest.MonkeyPatch) -> None:
    for wrong in (0, 65, -1):
        with pytest.raises(SceneError, match="solver: threads must be auto, or 1 to 64"):
            SolverSettings(threads=wrong)
    with pytest.raises(ConfigError, match=r"solver.threads: must be auto or a whole number, not 'many'"):
        load_scene("tripod", {"solver": {"threads": "many"}})
    assert load_scene("tripod", {"solver": {"threads": "auto"}}).scene.solver.threads == "auto"
    for said, meant in (("3", 3), ("2,1", 2), ("", min(usable_cores(), 8)), ("none", min(usable_cores(), 8))):
        monkeypatch.setenv("OMP_NUM_THREADS", said)
        assert usable_threads() == meant


SCRIPT = """
import os, sys, threading
from softsim_core import Simulation, load_scene
from softsim_core.physics.linalg import divided_factor
divided_factor.WORTHWHILE = 0.0
threads = int(sys.argv[1])
simulation = Simulation(load_scene("cable_finger", {"solver": {"threads": threads}}), backend="numba")
simulation.step()
helpers = [each for each in threading.enumerate() if each.name.startswith("softsim helper")]
assert len(helpers) == threads - 1, helpers
"""

ALONE = """
simulation.step()
sys.stdout.write(simulation.snapshot().hex())
"""

FORKING = """
import warnings
warnings.simplefilter("ignore", DeprecationWarning)  # fork() beside threads is what is tried
child = os.fork()
if child:
    simulation.step()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    sys.stdout.write(simulation.snapshot().hex())
else:
    assert threading.active_count() == 1
    simulation.step()
    assert threading.active_count() == 3
    simulation.step()
    sys.exit(0)
"""

INTERRUPTED = """
try:
    print("ready", flush=True)
    while True:
        simulation.step()
except KeyboardInterrupt:
    simulation.step()  # nothing waits for anybody
    print("interrupted", flush=True)
"""


def started(script: str, threads: int = 3) -> subprocess.Popen[str]:
    """A Python process that runs a script from the checkout."""
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT + script, str(threads)],
        cwd=Path(__file__).resolve().parents[2],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_gets_threads_of_its_own_and_all_end() -> None:
    process = started(FORKING)
    out, errors = process.communicate(timeout=300.0)
    assert (process.returncode, errors) == (0, "")
    # Another process as new as that one: Numba links what was loaded first, which may round in another way.
    assert out == started(ALONE, threads=1).communicate(timeout=300.0)[0]


@pytest.mark.slow
def test_an_interrupt_during_a_step_leaves_nothing_behind() -> None:
    process = started(INTERRUPTED)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate(timeout=300.0)
    assert (process.returncode, out, errors) == (0, "interrupted\n", "")
