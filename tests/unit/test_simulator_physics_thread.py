"""The physics thread around a real simulation of a small beam: requests, commands, faults, pacing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from waiting import DEADLINE_S

from softsim_core import load_scene
from softsim_core.base import CommandError, SceneError, SoftSimError
from softsim_core.physics.actuation import JointTrajectory
from softsim_core.scene import Controller, RobotDescription
from softsim_core.simulation import Simulation, small_scene
from softsim_ros.nodes.simulator import Commanded, PhysicsThread, Progress


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
        thread.commanded.command(np.array([value]))
    thread.step_once()
    assert watcher.shown[-1][1] == pytest.approx([0.2])
    assert thread.status.steps == 1


def test_a_trajectory_is_sampled_at_the_end_of_each_step(
    start: Callable[..., PhysicsThread], watcher: Watcher
) -> None:
    thread = start(paused=True)
    thread.commanded.command(JointTrajectory(["servo"], [0.05], [[0.5]]))
    for _ in range(7):
        thread.step_once()
    after = {count: position[0] for count, position in watcher.shown}  # while paused a state is shown again
    assert [after[count] for count in range(1, 8)] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.5])
    assert not thread.status.trajectory


def test_a_plain_command_cancels_a_trajectory(start: Callable[..., PhysicsThread], watcher: Watcher) -> None:
    thread = start(paused=True)
    thread.commanded.command(JointTrajectory(["servo"], [0.05], [[0.5]]))
    thread.step_once()
    assert thread.status.trajectory
    thread.commanded.command(np.array([-0.1]))
    for _ in range(3):
        thread.step_once()
    assert watcher.shown[-1][1] == pytest.approx([-0.1])


class Noting:
    """A follower that writes down what it is told, and ends its trajectory after some steps."""

    def __init__(self, steps: int = 10**6) -> None:
        self.steps = steps
        self.seen: list[tuple[float, float, float]] = []
        self.reasons: list[str] = []

    def follow(self, progress: Progress) -> bool:
        self.seen.append((progress.elapsed, float(progress.desired[0]), float(progress.actual[0])))
        return len(self.seen) >= self.steps

    def give_up(self, reason: str) -> None:
        self.reasons.append(reason)


def test_a_follower_sees_each_step_and_ends_its_trajectory(
    start: Callable[..., PhysicsThread],
) -> None:
    thread, follower = start(paused=True), Noting(steps=7)
    thread.commanded.command(JointTrajectory(["servo"], [0.05], [[0.5]]), 0.0, follower)
    for _ in range(9):
        assert thread.status.trajectory or not follower.seen or len(follower.seen) == 7
        thread.step_once()
    elapsed, desired, actual = np.transpose(follower.seen)
    assert elapsed == pytest.approx(0.01 * np.arange(1, 8))
    assert desired == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.5])
    assert actual == pytest.approx(desired)
    assert follower.reasons == []


@pytest.mark.parametrize("on_its_way", [True, False])
@pytest.mark.parametrize(
    ("end", "reason"),
    [
        (lambda thread, _: thread.commanded.command(np.array([0.1])), "another command took over"),
        (lambda thread, _: thread.commanded.command_named({"servo": 0.1}), "another command took over"),
        (
            lambda thread, _: thread.commanded.command(JointTrajectory(["servo"], [1.0], [[0.1]])),
            "another command took over",
        ),
        (lambda thread, follower: thread.commanded.leave(follower, "nobody wants it"), "nobody wants it"),
        (lambda thread, _: thread.reset(), "the simulation was reset"),
        (lambda thread, _: thread.pause(True), "the simulation was paused"),
        (lambda thread, _: thread.stop("a broken file"), "a broken file"),
    ],
)
def test_a_follower_is_told_once_why_its_trajectory_ended(
    start: Callable[..., PhysicsThread],
    end: Callable[[PhysicsThread, Noting], None],
    reason: str,
    on_its_way: bool,
) -> None:
    thread, follower = start(paused=True), Noting()
    thread.commanded.command(JointTrajectory(["servo"], [1.0], [[0.5]]), 0.0, follower)
    if on_its_way:
        thread.step_once()
    end(thread, follower)
    for _ in range(2):
        thread.step_once()
    assert follower.reasons == [reason]
    assert len(follower.seen) == int(on_its_way)


def test_a_pause_keeps_a_trajectory_that_nobody_follows(
    start: Callable[..., PhysicsThread],
) -> None:
    thread = start(paused=True)
    thread.commanded.command(JointTrajectory(["servo"], [1.0], [[0.5]]))
    thread.step_once()
    thread.pause(True)
    assert thread.status.trajectory


def test_of_a_joint_that_is_told_its_effort_the_effort_is_followed() -> None:
    joints = load_scene("inflated_cube").scene.joints
    told: list[np.ndarray] = []
    follower = Noting()
    simulation = SimpleNamespace(
        joint_names=(joints[0].name,),
        robot=SimpleNamespace(joints=joints),
        time=0.0,
        dt=0.5,
        joint_targets=np.zeros(1),
        joint_positions=np.array([1.0e-6]),
        joint_velocities=np.zeros(1),
        joint_efforts=np.array([400.0]),
        command=lambda values: told.append(values) or values,
    )
    commanded = Commanded(lambda sentence: None)
    commanded.command(JointTrajectory([joints[0].name], [1.0], [[1000.0]]), 0.0, follower)
    commanded.apply(simulation)  # type: ignore[arg-type]
    simulation.time = 0.5
    commanded.follow(simulation)  # type: ignore[arg-type]
    assert told == [pytest.approx([500.0])]
    assert follower.seen == [pytest.approx((0.5, 500.0, 400.0))]


def test_reset_forgets_what_was_commanded(start: Callable[..., PhysicsThread], watcher: Watcher) -> None:
    thread = start(paused=True)
    thread.commanded.command(JointTrajectory(["servo"], [1.0], [[0.5]]))
    thread.step_once()
    thread.commanded.command(np.array([0.4]))
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
    thread.commanded.command(np.array([0.3]))
    thread.step_once()
    data = thread.call(lambda simulation: simulation.snapshot())
    thread.step_once()
    thread.restore(data)
    assert thread.status.steps == 1
    assert thread.call(lambda simulation: simulation.snapshot()) == data
