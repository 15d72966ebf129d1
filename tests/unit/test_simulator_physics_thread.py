"""The physics thread around a real simulation of a small beam: requests, commands, faults, pacing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from softsim_core.actuation.trajectory import JointTrajectory
from softsim_core.errors import CommandError, SceneError, SoftSimError
from softsim_core.scene.robot import Controller, RobotDescription
from softsim_core.simulation import Simulation
from softsim_core.warmup import small_scene
from softsim_ros.simulator.physics_thread import PhysicsThread

DEADLINE_S = 10.0


class Watcher:
    """What a physics thread reported."""

    def __init__(self) -> None:
        self.shown: list[tuple[int, np.ndarray]] = []
        self.refusals: list[str] = []
        self.faults: list[str] = []
        self.printed: list[str] = []
        self._changed = threading.Condition()

    def on_state(self, simulation: Simulation, whole: bool) -> float:
        with self._changed:
            self.shown.append((simulation.step_count, simulation.joint_positions))
            self._changed.notify_all()
        return 0.0

    def wait_for(self, condition: Callable[[], bool]) -> bool:
        with self._changed:
            return self._changed.wait_for(condition, DEADLINE_S)


@pytest.fixture
def watcher() -> Watcher:
    return Watcher()


@pytest.fixture
def start(watcher: Watcher) -> Iterator[Callable[..., PhysicsThread]]:
    threads: list[PhysicsThread] = []

    def starter(
        controller: Controller | None = None, speed: float = 0.0, paused: bool = False
    ) -> PhysicsThread:
        scene = RobotDescription(scene=small_scene(), controllers=(controller,) if controller else ())
        simulation = Simulation(scene, backend="scipy")
        thread = PhysicsThread(
            simulation,
            watcher.on_state,
            watcher.refusals.append,
            watcher.faults.append,
            watcher.printed.append,
            speed,
        )
        threads.append(thread)
        thread.start()
        if paused:
            thread.pause(True)
            thread.reset()
        return thread

    yield starter
    for thread in threads:
        thread.close()
        assert not thread.is_alive


def test_steps_are_shown_one_by_one(start: Callable[..., PhysicsThread], watcher: Watcher) -> None:
    start()
    assert watcher.wait_for(lambda: len(watcher.shown) > 20)
    assert [count for count, _ in watcher.shown[:20]] == list(range(20))


def test_what_the_scene_prints_is_heard(start: Callable[..., PhysicsThread], watcher: Watcher) -> None:
    controller = Controller(
        on_begin=lambda simulation: print("begins", simulation.step_count),
        on_end=lambda simulation: print("ends", simulation.step_count),
        on_key=lambda simulation, key: print("key", key),
    )
    thread = start(controller, paused=True)
    watcher.printed.clear()
    thread.step_once()
    thread.press_key("k")
    assert watcher.printed == ["begins 0", "ends 1", "key k"]


def test_the_newest_command_wins(start: Callable[..., PhysicsThread], watcher: Watcher) -> None:
    thread = start(paused=True)
    for value in (0.1, 0.3, 0.2):
        thread.command(np.array([value]))
    thread.step_once()
    assert watcher.shown[-1][1] == pytest.approx([0.2])
    assert thread.status.steps == 1


def test_a_trajectory_is_sampled_at_the_end_of_each_step(
    start: Callable[..., PhysicsThread], watcher: Watcher
) -> None:
    thread = start(paused=True)
    thread.command(JointTrajectory(["servo"], [0.05], [[0.5]]))
    for _ in range(7):
        thread.step_once()
    after = {count: position[0] for count, position in watcher.shown}  # while paused a state is shown again
    assert [after[count] for count in range(1, 8)] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.5])
    assert not thread.status.trajectory


def test_a_plain_command_cancels_a_trajectory(start: Callable[..., PhysicsThread], watcher: Watcher) -> None:
    thread = start(paused=True)
    thread.command(JointTrajectory(["servo"], [0.05], [[0.5]]))
    thread.step_once()
    assert thread.status.trajectory
    thread.command(np.array([-0.1]))
    for _ in range(3):
        thread.step_once()
    assert watcher.shown[-1][1] == pytest.approx([-0.1])


def test_reset_forgets_what_was_commanded(start: Callable[..., PhysicsThread], watcher: Watcher) -> None:
    thread = start(paused=True)
    thread.command(JointTrajectory(["servo"], [1.0], [[0.5]]))
    thread.step_once()
    thread.command(np.array([0.4]))
    thread.reset()
    thread.step_once()
    assert watcher.shown[-1][1].tolist() == [0.0]


def test_what_a_request_raises_comes_back_to_the_caller(start: Callable[..., PhysicsThread]) -> None:
    thread = start()
    with pytest.raises(SceneError, match="no start animation"):
        thread.play_start()
    with pytest.raises(CommandError, match="the simulation is running; pause it first"):
        thread.step_once()
    with pytest.raises(ZeroDivisionError):
        thread.call(lambda simulation: 1 // 0)
    assert thread.call(lambda simulation: simulation.dt) == 0.01


def test_requests_after_the_end_are_refused(start: Callable[..., PhysicsThread]) -> None:
    thread = start()
    thread.close()
    thread.close()
    with pytest.raises(SoftSimError, match="has ended"):
        thread.call(lambda simulation: None)


def test_a_runaway_pauses_at_the_last_good_state(
    start: Callable[..., PhysicsThread], watcher: Watcher
) -> None:
    def overload(simulation: Simulation) -> None:
        if simulation.step_count == 5:
            simulation.forces[:] = np.nan

    thread = start(Controller(on_begin=overload))
    assert watcher.wait_for(lambda: thread.status.paused)
    assert thread.status.steps == 5
    assert "diverged at step 6" in thread.status.fault
    assert watcher.faults == [thread.status.fault]
    assert thread.call(lambda simulation: bool(np.isfinite(simulation.positions).all()))
    thread.reset()
    assert thread.status.fault == ""
    thread.step_once()
    assert thread.status.steps == 1


def test_a_broken_controller_pauses_and_says_so(
    start: Callable[..., PhysicsThread], watcher: Watcher
) -> None:
    def broken(simulation: Simulation) -> None:
        raise KeyError("gain")

    thread = start(Controller(on_end=broken))
    assert watcher.wait_for(lambda: thread.status.paused)
    assert thread.status.fault.startswith("step failed: KeyError: 'gain'; paused")


def test_slow_steps_slow_the_simulation_down_and_are_counted(
    start: Callable[..., PhysicsThread], watcher: Watcher
) -> None:
    thread = start(speed=1000.0)  # 10 us per step: no step is that fast
    assert watcher.wait_for(lambda: thread.status.late_s > 0.2)
    assert [count for count, _ in watcher.shown] == list(range(len(watcher.shown)))


def test_a_snapshot_taken_between_steps_comes_back(
    start: Callable[..., PhysicsThread], watcher: Watcher
) -> None:
    thread = start(paused=True)
    thread.command(np.array([0.3]))
    thread.step_once()
    data = thread.call(lambda simulation: simulation.snapshot())
    thread.step_once()
    thread.restore(data)
    assert thread.status.steps == 1
    assert thread.call(lambda simulation: simulation.snapshot()) == data
