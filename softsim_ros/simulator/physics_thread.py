"""The physics in a thread of its own: fixed steps on the steady clock, requests served between steps."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from softsim_core.actuation.trajectory import JointTrajectory
from softsim_core.arrays import Array
from softsim_core.errors import CommandError, SoftSimError, SolverDivergedError
from softsim_core.simulation import Simulation
from softsim_node.ending import ending
from softsim_ros.simulator.contact_meter import ContactQuality
from softsim_ros.simulator.fallback_meter import Fallbacks
from softsim_ros.simulator.pacing import Pacer, RateGate, Speed, SpeedMeter
from softsim_ros.simulator.printed import printed_lines
from softsim_ros.simulator.step_history import StepHistory
from softsim_ros.work_queue import WorkQueue

IDLE_PERIOD_S = 0.1
"""While paused the unchanged state is shown this often, in [s], so that late joiners see it."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class PhysicsStatus:
    """What the thread did lately.

    Attributes:
        speed: Real-time factor, step rate and stage times of the last second or so.
        time_s: Simulated time in [s].
        dt: Time step in [s].
        steps: Steps done since the start of the scene.
        paused: Whether steps are stopped.
        fault: Why the physics stopped by itself; empty while it is well.
        late_s: Wall time in [s] by which simulated time fell behind the asked speed, in all.
        clamped_commands: Commands that were moved to the limits, in all.
        refused_commands: Commands that the simulation refused, in all.
        trajectory: Whether a trajectory is running.
        inverted_elements: Elements that are inside out or flat after the last step.
        contacts: How contacts were solved in the last second or so; None in a scene without.
        fallbacks: Steps of the last second or so that did without a part of their stiffness.
    """

    speed: Speed = field(default_factory=Speed)
    time_s: float = 0.0
    dt: float = 0.0
    steps: int = 0
    paused: bool = False
    fault: str = ""
    late_s: float = 0.0
    clamped_commands: int = 0
    refused_commands: int = 0
    trajectory: bool = False
    inverted_elements: int = 0
    contacts: ContactQuality | None = None
    fallbacks: Fallbacks = field(default_factory=Fallbacks)


class PhysicsThread:
    """Owns a simulation once started: nothing else may touch it, except through `call`.

    Args:
        simulation: What to run.
        on_state: Called in the thread after every step and every request that changed the state; True as
            second argument asks to show the whole state at once. Returns the milliseconds it took.
        on_refusal: Called in the thread with the sentence of a refused command.
        on_fault: Called in the thread with a sentence when the physics stops by itself.
        on_print: Called in the thread with each line that the scene's own code prints.
        speed: Simulated seconds a wall second, >= 0; 0 is as fast as possible.

    Attributes:
        status: What it did lately.
        history: The last steps with the time of each stage.
    """

    def __init__(
        self,
        simulation: Simulation,
        on_state: Callable[[Simulation, bool], float],
        on_refusal: Callable[[str], None],
        on_fault: Callable[[str], None],
        on_print: Callable[[str], None],
        speed: float = 1.0,
    ) -> None:
        self._simulation = simulation
        self._on_state, self._on_refusal = on_state, on_refusal
        self._on_fault, self._on_print = on_fault, on_print
        self._requests = WorkQueue("the physics", "a physics step", lambda: self.is_alive)
        self._command_lock = threading.Lock()
        self._newest: Array | JointTrajectory | None = None
        self._named: dict[str, float] = {}  # positions of some joints, over the newest command
        self._delay = 0.0
        self._trajectory: tuple[JointTrajectory, float, Array] | None = None
        self._speed = speed
        self._paused = self._paused_before_fault = False
        self._fault = ""
        self._clamped = self._refused = 0
        self._left_behind = False
        self._pacer = Pacer()
        self._meter = SpeedMeter(simulation.dt, time.monotonic())
        self._report_gate = RateGate(1.0)
        self._last_speed = Speed()
        self._contacts = self._last_contacts = ContactQuality()
        self._fallbacks = self._last_fallbacks = Fallbacks()
        self.history = StepHistory()
        self.status = PhysicsStatus()
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)

    # --- from any thread ------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin stepping."""
        self._thread.start()

    def close(self) -> None:
        """End after the step in progress and join, see `ending.wait_for`; a second call does nothing."""
        self._requests.ask_to_end()
        self._left_behind = not ending.wait_for(self._thread)

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def command(self, target: Array | JointTrajectory, delay_s: float = 0.0) -> None:
        """Give joint positions, shape (j,), or a trajectory for the next step; the newest of either wins.

        Args:
            target: Where to go.
            delay_s: In how many simulated seconds a trajectory begins; < 0: it has begun already.
        """
        with self._command_lock:
            self._newest, self._delay = target, delay_s
            self._named.clear()

    def command_named(self, positions: Mapping[str, float]) -> None:
        """Give positions of some joints by name for the next step; the others stay where they are told."""
        with self._command_lock:
            self._named.update(positions)

    def call(self, action: Callable[[Simulation], Result], *, shows: bool = True) -> Result:
        """Run an action on the simulation between two steps and wait for its result.

        Args:
            action: Gets the simulation; what it raises is raised here.
            shows: Show the state afterwards, as after a step.

        Raises:
            SoftSimError: the thread has ended, or is stuck in one step for longer than REQUEST_TIMEOUT_S.
        """

        def run() -> Result:
            result = action(self._simulation)
            if shows:
                self._show(whole=True)
            return result

        return self._requests.ask(run)

    def set_speed(self, speed: float) -> None:
        """Simulated seconds a wall second, >= 0; 0 is as fast as possible."""

        def change(_: Simulation) -> None:
            self._speed = speed
            self._pacer.start()

        self.call(change, shows=False)

    def pause(self, paused: bool) -> None:
        """Stop or go on stepping."""

        def change(_: Simulation) -> None:
            self._paused = paused
            self._pacer.start()
            if not paused:
                self._fault = ""

        self.call(change)

    def step_once(self) -> None:
        """Do one step while paused.

        Raises:
            CommandError: it is running.
            SoftSimError: the step failed.
        """

        def step(_: Simulation) -> None:
            if not self._paused:
                raise CommandError("step refused: the simulation is running; pause it first")
            self._fault = ""
            self._step()
            if self._fault:
                raise SoftSimError(self._fault)

        self.call(step, shows=False)

    def reset(self) -> None:
        """Back to the start of the scene; commands and trajectories given before are forgotten."""

        def start_again(simulation: Simulation) -> None:
            self._forget_commands()
            simulation.reset()
            self._fault = ""

        self.call(start_again)

    def restore(self, data: bytes) -> None:
        """Go to a snapshot; commands and trajectories given before are forgotten.

        Raises:
            SnapshotError: not a snapshot of this scene; nothing is changed.
        """

        def go(simulation: Simulation) -> None:
            simulation.restore(data)
            self._forget_commands()
            self._fault = ""

        self.call(go)

    def replace(self, simulation: Simulation, prepare: Callable[[Simulation], None]) -> None:
        """Go on with another simulation, from its start; what stopped the last one is forgotten.

        Args:
            simulation: What to run from now on.
            prepare: Called in the thread with it before its first state is shown.
        """

        def swap(_: Simulation) -> None:
            prepare(simulation)
            self._simulation = simulation
            self._forget_commands()
            self._meter = SpeedMeter(simulation.dt, time.monotonic())
            self._contacts = self._last_contacts = ContactQuality()
            self._fallbacks = self._last_fallbacks = Fallbacks()
            self._pacer.start()
            if self._fault:
                self._fault, self._paused = "", self._paused_before_fault

        self.call(swap)

    def stop(self, sentence: str) -> None:
        """Pause with a fault, such as a scene file that cannot be used."""
        self.call(lambda _: self._stop_on_fault(sentence), shows=False)

    def play_start(self) -> None:
        """Begin the start animation; a running trajectory ends.

        Raises:
            SceneError: the scene has none.
        """

        def begin(simulation: Simulation) -> None:
            simulation.start_animation()
            self._forget_commands()

        self.call(begin, shows=False)

    def press_key(self, key: str) -> None:
        """Hand a key to the scene's own code; what that raises is raised here."""

        def press(simulation: Simulation) -> None:
            with self._listening():
                simulation.press_key(key)

        self.call(press, shows=False)

    # --- in the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        self._show(whole=True)
        delay = 0.0
        while self._requests.serve(delay, lambda: self._paused):
            if self._paused:
                delay = IDLE_PERIOD_S
                self._show(whole=True)
            else:
                self._step()
                period = self._simulation.dt / self._speed if self._speed > 0.0 else 0.0
                delay = self._pacer.wait_s(time.monotonic(), period)

    def _step(self) -> None:
        simulation = self._simulation
        try:
            self._apply_command()
            cpu = time.thread_time()
            with self._listening():
                simulation.step()
            cpu = time.thread_time() - cpu
        except SolverDivergedError as error:
            self._stop_on_fault(f"{error}; paused at the last good state: ease the load or call ~/reset")
        except Exception as error:  # a scene's own controller may raise anything; the node must live on
            self._stop_on_fault(f"step failed: {type(error).__name__}: {error}; paused: call ~/reset")
        else:
            stages = {**simulation.stage_times, "publishing": self._show(whole=False)}
            self._meter.add_step(stages, cpu)
            self._contacts = self._contacts.with_step(simulation.contacts, simulation.scene.contact.tolerance)
            self._fallbacks = self._fallbacks.with_step(simulation.report)
            self.history.add(simulation.step_count, simulation.time, stages)

    def _listening(self) -> AbstractContextManager[None]:
        """What is printed inside is the scene's, where it has code of its own."""
        return printed_lines(self._on_print) if self._simulation.robot.controllers else nullcontext()

    def _stop_on_fault(self, sentence: str) -> None:
        self._forget_commands()
        if not self._fault:
            self._paused_before_fault = self._paused
        self._paused, self._fault = True, sentence
        self._show(whole=True)
        self._on_fault(sentence)

    def _apply_command(self) -> None:
        with self._command_lock:
            newest, self._newest = self._newest, None
            named, self._named, delay = self._named, {}, self._delay
        simulation = self._simulation
        try:
            if named:
                self._trajectory = None
                self._command(self._laid_over(newest, named))
            elif isinstance(newest, JointTrajectory):
                self._trajectory = (newest, simulation.time + delay, simulation.joint_targets)
            elif newest is not None:
                self._trajectory = None
                self._command(newest)
            if self._trajectory is not None:
                trajectory, begin, start = self._trajectory
                elapsed = simulation.time + simulation.dt - begin  # targets hold at the end of the step
                if trajectory.is_over(elapsed):
                    self._trajectory = None
                if elapsed >= 0.0:
                    self._command(trajectory.sample(elapsed, start, simulation.joint_names))
        except CommandError as error:
            self._trajectory = None
            self._refused += 1
            self._on_refusal(str(error))

    def _laid_over(self, newest: Array | JointTrajectory | None, named: Mapping[str, float]) -> Array:
        """Targets of all joints: those named, over the newest command, else over what was told before."""
        simulation = self._simulation
        targets = np.array(newest) if isinstance(newest, np.ndarray) else simulation.joint_targets
        if simulation.enforce_limits:  # a rest pose beyond them is no command of anybody's
            targets[:] = [
                joint.limits.clamp(target)
                for joint, target in zip(simulation.robot.joints, targets, strict=True)
            ]
        for name, position in named.items():
            if name in simulation.joint_names:  # else another scene has come since
                targets[simulation.joint_names.index(name)] = position
        return targets

    def _command(self, values: Array) -> None:
        accepted = self._simulation.command(values)
        self._clamped += not np.array_equal(accepted, values)

    def _forget_commands(self) -> None:
        with self._command_lock:
            self._newest = None
            self._named.clear()
        self._trajectory = None

    def _show(self, *, whole: bool) -> float:
        if self._left_behind:  # those who would be shown it are gone
            return 0.0
        now = time.monotonic()
        if self._report_gate.passes(now):
            self._last_speed = self._meter.take(now)
            self._last_contacts = self._contacts
            self._contacts = ContactQuality(self._contacts.contacts)
            self._last_fallbacks, self._fallbacks = self._fallbacks, Fallbacks()
        simulation = self._simulation
        self.status = PhysicsStatus(
            speed=self._last_speed,
            time_s=simulation.time,
            dt=simulation.dt,
            steps=simulation.step_count,
            paused=self._paused,
            fault=self._fault,
            late_s=self._pacer.late_s,
            clamped_commands=self._clamped,
            refused_commands=self._refused,
            trajectory=self._trajectory is not None,
            inverted_elements=simulation.report.inverted,
            contacts=self._last_contacts if simulation.collision_surfaces else None,
            fallbacks=self._last_fallbacks,
        )
        return self._on_state(simulation, whole)
