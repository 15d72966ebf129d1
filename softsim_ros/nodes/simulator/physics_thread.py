"""The physics in a thread of its own: fixed steps on the steady clock, requests served between steps."""

from __future__ import annotations

import io
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any, TypeVar

from softsim_core.base.arrays import Array
from softsim_core.base.errors import CommandError, SoftSimError, SolverDivergedError
from softsim_core.physics.actuation.trajectory import JointTrajectory
from softsim_core.simulation import Simulation
from softsim_node.background import WorkQueue
from softsim_node.ending import ending
from softsim_ros.nodes.simulator.monitor import (
    ContactQuality,
    Fallbacks,
    Pacer,
    RateGate,
    Speed,
    SpeedMeter,
    StepHistory,
)
from softsim_ros.nodes.simulator.setpoints import Commanded, Follower, LedJoints


class _Lines:
    """Hands text on in whole lines."""

    def __init__(self, on_line: Callable[[str], None]) -> None:
        self._on_line, self._rest = on_line, ""

    def write(self, text: str) -> None:
        *lines, self._rest = (self._rest + text).split("\n")
        for line in filter(str.strip, lines):
            self._on_line(line)

    def close(self) -> None:
        if self._rest:
            self.write("\n")


class _ByThread(io.TextIOBase):
    """Stands in for standard output while a thread is listened to."""

    def __init__(self, usual: Any) -> None:
        self.usual, self.lines = usual, dict[int, _Lines]()

    def write(self, text: str) -> int:
        lines = self.lines.get(threading.get_ident())
        if lines is None:
            return int(self.usual.write(text))
        lines.write(text)
        return len(text)

    def flush(self) -> None:
        self.usual.flush()

    def isatty(self) -> bool:
        return bool(self.usual.isatty())

    def fileno(self) -> int:
        return int(self.usual.fileno())


_exchange = threading.Lock()


@contextmanager
def printed_lines(on_line: Callable[[str], None]) -> Iterator[None]:
    """Give each line that this thread prints inside to `on_line`, which must not print itself.

    Empty lines are left out. Threads may do so at the same time, each with its own `on_line`.
    """
    this = threading.get_ident()
    lines = _Lines(on_line)
    with _exchange:
        if not isinstance(sys.stdout, _ByThread):
            sys.stdout = _ByThread(sys.stdout)
        output = sys.stdout
        output.lines[this] = lines
    try:
        yield
    finally:
        lines.close()
        with _exchange:
            del output.lines[this]
            if not output.lines and sys.stdout is output:
                sys.stdout = output.usual


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
        backend: Implementation of the step.
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
    backend: str = ""


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
        self._on_state, self._on_fault, self._on_print = on_state, on_fault, on_print
        self._requests = WorkQueue("the physics", "a physics step", lambda: self.is_alive)
        self._commanded = Commanded(on_refusal)
        self._speed = speed
        self._paused = self._paused_before_fault = False
        self._fault = ""
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

    def command(
        self, target: Array | JointTrajectory, delay_s: float = 0.0, follower: Follower | None = None
    ) -> None:
        """Give joint positions, shape (j,), or a trajectory for the next step; see Commanded."""
        self._commanded.command(target, delay_s, follower)

    @property
    def led(self) -> LedJoints:
        """Joints that somebody else moves."""
        return self._commanded.led

    def command_named(self, positions: Mapping[str, float]) -> None:
        """Give positions of some joints by name for the next step; the others stay where they are told."""
        self._commanded.command_named(positions)

    def leave(self, follower: Follower, reason: str) -> None:
        """End the trajectory of a follower, if it is on its way; the joints stay where they were told."""
        self._commanded.leave(follower, reason)

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
        """Stop or go on stepping; a trajectory that is followed ends with a pause, others wait."""

        def change(_: Simulation) -> None:
            self._paused = paused
            self._pacer.start()
            if paused:
                self._commanded.forget("the simulation was paused", lambda follower: follower is not None)
            else:
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
            self._commanded.forget("the simulation was reset")
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
            self._commanded.forget("a snapshot was loaded")
            self._fault = ""

        self.call(go)

    def replace(
        self, simulation: Simulation, prepare: Callable[[Simulation], None], *, goes_on: bool = False
    ) -> None:
        """Go on with another simulation, from its start; what stopped the last one is forgotten.

        Args:
            simulation: What to run from now on.
            prepare: Called in the thread with it before its first state is shown.
            goes_on: It has the same joints and goes on where the last one is, commands and all.

        Raises:
            SoftSimError: it cannot go on from there; nothing is changed.
        """

        def swap(before: Simulation) -> None:
            if goes_on:
                simulation.go_on_from(before)
            prepare(simulation)
            self._simulation = simulation
            if goes_on:
                return
            self._commanded.forget("another scene was loaded")
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
            self._commanded.forget("the start animation began")

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
            self._commanded.apply(simulation)
            cpu = time.thread_time()
            with self._listening():
                simulation.step()
            cpu = time.thread_time() - cpu
        except SolverDivergedError as error:
            self._stop_on_fault(f"{error}; paused at the last good state: ease the load or call ~/reset")
        except Exception as error:  # a scene's own controller may raise anything; the node must live on
            self._stop_on_fault(f"step failed: {type(error).__name__}: {error}; paused: call ~/reset")
        else:
            self._commanded.follow(simulation)
            stages = {**simulation.stage_times, "publishing": self._show(whole=False)}
            self._meter.add_step(stages, cpu)
            self._contacts = self._contacts.with_step(
                simulation.contacts, simulation.contact_limits.tolerance
            )
            self._fallbacks = self._fallbacks.with_step(simulation.report)
            self.history.add(simulation.step_count, simulation.time, stages)

    def _listening(self) -> AbstractContextManager[None]:
        """What is printed inside is the scene's, where it has code of its own."""
        return printed_lines(self._on_print) if self._simulation.robot.controllers else nullcontext()

    def _stop_on_fault(self, sentence: str) -> None:
        self._commanded.forget(sentence)
        if not self._fault:
            self._paused_before_fault = self._paused
        self._paused, self._fault = True, sentence
        self._show(whole=True)
        self._on_fault(sentence)

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
            clamped_commands=self._commanded.clamped,
            refused_commands=self._commanded.refused,
            trajectory=self._commanded.runs_trajectory,
            inverted_elements=simulation.report.inverted,
            contacts=self._last_contacts if simulation.collision_surfaces else None,
            fallbacks=self._last_fallbacks,
            backend=simulation.backend,
        )
        return self._on_state(simulation, whole)
