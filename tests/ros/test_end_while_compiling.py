"""A request to end does not wait for the compiler: the process leaves it behind, the servos at rest."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from bridge_session import BridgeClient, Stream
from node_processes import NodeProcess, ProcessGroup, spin_until
from waiting import DEADLINE_S

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from std_msgs.msg import Float64MultiArray, String  # noqa: E402

from servo_bridge.emulator import VirtualBoard  # noqa: E402
from softsim_core import Simulation, load_scene  # noqa: E402
from softsim_core.base import SoftSimError  # noqa: E402
from softsim_node import Ending, background  # noqa: E402
from softsim_ros.nodes.simulator import PhysicsThread  # noqa: E402

KERNELS_S = 150.0
REST = (150, 150, 150)

COMPILES_LATER = """
import ctypes
from softsim_core import Controller, Scene, load_scene
from softsim_core.robots import tripod

def create_scene(scene: Scene) -> None:
    scene.name, scene.board = "tripod", load_scene("tripod").board
    scene.add(tripod())
    scene.add(Controller(on_key=compile_kernels))

def compile_kernels(simulation, key):
    print("compiling")
    ctypes.CDLL(None).sleep(3600)  # what the compiler looks like from Python: no interrupt, no lock
"""


@pytest.fixture
def start(tmp_path: Path, ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[ProcessGroup]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    processes = ProcessGroup(tmp_path)
    yield processes
    processes.end()


def end(process: NodeProcess, number: signal.Signals) -> None:
    """Have it end with code 0 and without a traceback."""
    assert process.end(number) == 0, process.output
    assert "Traceback" not in process.output
    assert "rror" not in process.output, process.output


def test_the_first_start_is_ended_while_it_compiles(
    start: ProcessGroup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "kernels"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    process = start("softsim_ros.cli", "run", "simulator")
    assert process.says("begins on the SciPy path while kernels compile", KERNELS_S), process.output
    assert spin_until(lambda: any(cache.rglob("*.nbc")), KERNELS_S)  # the compiler is at the next one
    end(process, signal.SIGINT)
    assert not any(cache.rglob("ready-*"))  # what says that all kernels are compiled


def end_at_random_moments(
    folder: Path, monkeypatch: pytest.MonkeyPatch, count: int, latest_s: float, seed: int = 0
) -> Counter[int]:
    """Start a robot on an empty cache and end it, again and again; none crashes or leaves a process.

    Returns:
        How often each exit code was seen.
    """
    draw = random.Random(count + seed)
    codes = Counter[int]()
    for number in range(count):
        kernels = folder / f"kernels {seed} {number}"
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(kernels))
        words = ("up", "tripod", "--headless", "--no-viewer", "--send")
        up = NodeProcess("softsim_ros.cli", words, folder / f"up {seed} {number}.txt")
        moment = draw.uniform(0.0, latest_s)
        with pytest.raises(subprocess.TimeoutExpired):
            up.process.wait(moment)
        code = up.end(draw.choice([signal.SIGINT, signal.SIGTERM]))
        codes[code] += 1
        # Before Python runs the first line of the suite a signal ends the process as it ends any other, and
        # an interrupt that Python meets in the text of an `exec`, as of dataclasses, it repeats as a signal.
        early = not up.output or "KeyboardInterrupt" in up.output
        allowed = {0, 130, -signal.SIGINT} | ({1, -signal.SIGTERM} if early else set())
        assert code in allowed, (moment, up.state)
        assert early or "Traceback" not in up.output, (moment, up.state)
        assert spin_until(lambda kernels=kernels: not processes_with(str(kernels))), moment
        shutil.rmtree(kernels, ignore_errors=True)
        print(f"{number} after {moment:.1f} s: {code}", flush=True)
    return codes


@contextmanager
def busy_programs(count: int) -> Iterator[None]:
    """Keep processor cores busy with programs that only count."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def processes_with(text: str) -> list[Path]:
    """Processes that were started with a text in their environment, and run still."""
    found = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if text.encode() in environment.read_bytes():
                found.append(environment.parent)
    return found


def test_a_robot_is_ended_at_random_moments_of_its_first_start(
    tmp_path: Path, ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    end_at_random_moments(tmp_path, monkeypatch, 3, 10.0)


@pytest.mark.exhaustive
@pytest.mark.parametrize("busy", [0, 2], ids=["alone", "beside busy programs"])
def test_a_robot_is_ended_at_any_moment_of_its_first_minute(
    tmp_path: Path, ros_domain: int, monkeypatch: pytest.MonkeyPatch, busy: int
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with busy_programs(busy):
        print(end_at_random_moments(tmp_path, monkeypatch, 150, 60.0, busy))


def test_softsim_up_is_ended_at_rest_while_its_physics_compiles(start: ProcessGroup, tmp_path: Path) -> None:
    file = tmp_path / "later.py"
    file.write_text(COMPILES_LATER)
    words = ("--namespace", "tripod", "--headless", "--no-viewer", "--send")
    with VirtualBoard(link=tmp_path / "board") as board:
        up = start("softsim_ros.cli", "up", str(file), *words, "--board", board.port)
        client = BridgeClient(int(os.environ["ROS_DOMAIN_ID"]), start)
        try:
            assert up.says("simulating", KERNELS_S), up.output
            commands = client.publisher(Float64MultiArray, "position_controller/commands")
            stream = Stream(commands, Float64MultiArray(data=[-1.0] * 3))
            try:
                assert board.wait_for(lambda b: b.servo_bytes == (121, 121, 121), DEADLINE_S), up.output
                client.publish("keys", String(data="x"))
                assert up.says("compiling"), up.output
                end(up, signal.SIGINT)
            finally:
                stream.stop()
        finally:
            client.close()
        assert [packet.servo_bytes for packet in board.packets[-3:]] == [REST] * 3


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Ending:
    """A request to end that the physics looks at instead of the process's own."""
    ending = Ending()
    monkeypatch.setattr(background, "ending", ending)
    return ending


def test_a_physics_that_is_stuck_in_a_step_is_left_behind_and_shows_nothing_more(
    asked: Ending, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation = Simulation(load_scene("tripod_step_1"), backend="scipy")
    begun, free = threading.Event(), threading.Event()
    shown: list[Any] = []

    def step(self: Simulation) -> None:
        begun.set()
        assert free.wait(DEADLINE_S)

    monkeypatch.setattr(Simulation, "step", step)
    physics = PhysicsThread(simulation, lambda *_: shown.append(0) or 0.0, *[lambda _: None] * 3)  # type: ignore[func-returns-value]
    physics.start()
    assert begun.wait(DEADLINE_S)
    asked._asked = True
    with pytest.raises(SoftSimError, match="this program ends"):
        physics.reset()
    before = len(shown)
    physics.close()
    assert physics.is_alive
    free.set()
    assert spin_until(lambda: not physics.is_alive)
    assert len(shown) == before
