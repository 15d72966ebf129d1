"""Run the physics in its own thread: fixed steps on the steady clock, requests served between steps."""

from __future__ import annotations

import io
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any, TypeVar

from softsim_core.base import CommandError, SoftSimError, SolverDivergedError
from softsim_core.simulation import Simulation
from softsim_node import OwnerThread, in_thread
from softsim_ros.nodes.simulator.monitor import (
    ContactQuality,
    Fallbacks,
    Pacer,
    RateGate,
    Speed,
    SpeedMeter,
    StepHistory,
)
from softsim_ros.nodes.simulator.setpoints import Commanded


class _Lines:
    """Collects text and passes it on in whole lines; empty lines are dropped."""

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
    """Replacement for standard output that captures what some threads print; other threads print as usual."""

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
    """Pass each line that this thread prints inside the context to `on_line`, which must not print itself.

    Empty lines are dropped. Several threads may do so at the same time, each with its own `on_line`.
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
"""Period in [s] at which the unchanged state is published while paused, so that late joiners see it."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class PhysicsStatus:
    """Recent state of the physics thread.

    Attributes:
        speed: Real-time factor, step rate and stage times over about the last second.
        time_s: Simulated time in [s].
        dt: Time step in [s].
        steps: Number of steps since the start of the scene.
        paused: Whether stepping is paused.
        fault: Why the physics stopped by itself; empty if it did not.
        late_s: Total wall time in [s] by which simulated time fell behind the requested speed.
        clamped_commands: Total number of commands that were clamped to the limits.
        refused_commands: Total number of commands that the simulation refused.
        trajectory: Whether a trajectory is running.
        inverted_elements: Number of inverted or flat elements after the last step.
        contacts: Quality of the contact solution over about the last second; None in a scene without contact.
        fallbacks: Steps with reduced stiffness over about the last second.
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


class PhysicsThread(OwnerThread):
    """Thread that owns a simulation once started; other threads may access it only through `call`.

    Args:
        simulation: What to run.
        on_state: Called in the thread after every step and every request that changed the state. If the
            second argument is True, the whole state must be published at once. Returns the time it took in
            [ms].
        on_refusal: Called in the thread with the message of a refused command.
        on_fault: Called in the thread with a message when the physics stops by itself.
        on_print: Called in the thread with each line that the scene's own code prints.
        speed: Simulated seconds per wall second, >= 0; 0 is as fast as possible.

    Attributes:
        commanded: Commands of the joints.
        status: Recent state of the thread.
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
        super().__init__("physics", "the physics", "a physics step")
        self.commanded = Commanded(on_refusal)
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

    # --- from any thread ------------------------------------------------------------------------------

    def close(self) -> bool:
        """Stop after the step in progress and join the thread; return False if it is left behind."""
        self._left_behind = not super().close()
        return not self._left_behind

    def call(self, action: Callable[[Simulation], Result], *, shows: bool = True) -> Result:
        """Run an action on the simulation between two steps and wait for its result.

        Args:
            action: Called with the simulation; its exceptions are raised here.
            shows: Whether to publish the state afterwards, as after a step.

        Raises:
            SoftSimError: the thread has ended, or is stuck in one step for longer than REQUEST_TIMEOUT_S.
        """

        def run() -> Result:
            result = action(self._simulation)
            if shows:
                self._show(whole=True)
            return result

        return self.ask(run)

    @in_thread
    def set_speed(self, speed: float) -> None:
        """Set the speed in simulated seconds per wall second, >= 0; 0 is as fast as possible."""
        self._speed = speed
        self._pacer.start()

    @in_thread
    def pause(self, paused: bool) -> None:
        """Pause or resume stepping; a pause ends a trajectory with a follower, other trajectories wait."""
        self._paused = paused
        self._pacer.start()
        if paused:
            self.commanded.forget("the simulation was paused", lambda follower: follower is not None)
        else:
            self._fault = ""
        self._show(whole=True)

    @in_thread
    def step_once(self) -> None:
        """Advance by one step while paused.

        Raises:
            CommandError: it is running.
            SoftSimError: the step failed.
        """
        if not self._paused:
            raise CommandError("step refused: the simulation is running; pause it first")
        self._fault = ""
        self._step()
        if self._fault:
            raise SoftSimError(self._fault)

    @in_thread
    def reset(self) -> None:
        """Return to the start of the scene and drop all earlier commands and trajectories."""
        self.commanded.forget("the simulation was reset")
        self._simulation.reset()
        self._fault = ""
        self._show(whole=True)

    @in_thread
    def restore(self, data: bytes) -> None:
        """Restore a snapshot and drop all earlier commands and trajectories.

        Raises:
            SnapshotError: not a snapshot of this scene; nothing is changed.
        """
        self._simulation.restore(data)
        self.commanded.forget("a snapshot was loaded")
        self._fault = ""
        self._show(whole=True)

    @in_thread
    def replace(
        self, simulation: Simulation, prepare: Callable[[Simulation], None], *, goes_on: bool = False
    ) -> None:
        """Continue with another simulation from its start; clear the fault that stopped the previous one.

        Args:
            simulation: What to run from now on.
            prepare: Called with it in the thread before its first state is published.
            goes_on: It has the same joints and continues from the state of the previous one, including
                commands.

        Raises:
            SoftSimError: it cannot continue from there; nothing is changed.
        """
        if goes_on:
            simulation.go_on_from(self._simulation)
        prepare(simulation)
        self._simulation = simulation
        if not goes_on:
            self.commanded.forget("another scene was loaded")
            self._meter = SpeedMeter(simulation.dt, time.monotonic())
            self._contacts = self._last_contacts = ContactQuality()
            self._fallbacks = self._last_fallbacks = Fallbacks()
            self._pacer.start()
            if self._fault:
                self._fault, self._paused = "", self._paused_before_fault
        self._show(whole=True)

    @in_thread
    def stop(self, message: str) -> None:
        """Pause with a fault, for example because a scene file cannot be used."""
        self._stop_on_fault(message)

    @in_thread
    def play_start(self) -> None:
        """Start the start animation; a running trajectory ends.

        Raises:
            SceneError: the scene has none.
        """
        self._simulation.start_animation()
        self.commanded.forget("the start animation began")

    @in_thread
    def press_key(self, key: str) -> None:
        """Pass a key to the scene's own code; exceptions of that code are raised here."""
        with self._listening():
            self._simulation.press_key(key)

    # --- in the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        self._show(whole=True)
        delay = 0.0
        while self.serve(delay, lambda: self._paused):
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
            self.commanded.apply(simulation)
            cpu = time.thread_time()
            with self._listening():
                simulation.step()
            cpu = time.thread_time() - cpu
        except SolverDivergedError as error:
            self._stop_on_fault(f"{error}; paused at the last good state: ease the load or call ~/reset")
        except Exception as error:  # a scene's own controller may raise anything; the node must keep running
            self._stop_on_fault(f"step failed: {type(error).__name__}: {error}; paused: call ~/reset")
        else:
            self.commanded.follow(simulation)
            stages = {**simulation.stage_times, "publishing": self._show(whole=False)}
            self._meter.add_step(stages, cpu)
            self._contacts = self._contacts.with_step(
                simulation.contacts, simulation.contact_limits.tolerance
            )
            self._fallbacks = self._fallbacks.with_step(simulation.report)
            self.history.add(simulation.step_count, simulation.time, stages)

    def _listening(self) -> AbstractContextManager[None]:
        """Return a context that captures printed lines if the scene has code of its own."""
        return printed_lines(self._on_print) if self._simulation.robot.controllers else nullcontext()

    def _stop_on_fault(self, message: str) -> None:
        self.commanded.forget(message)
        if not self._fault:
            self._paused_before_fault = self._paused
        self._paused, self._fault = True, message
        self._show(whole=True)
        self._on_fault(message)

    def _show(self, *, whole: bool) -> float:
        if self._left_behind:  # the node that publishes it is gone
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
            clamped_commands=self.commanded.clamped,
            refused_commands=self.commanded.refused,
            trajectory=self.commanded.runs_trajectory,
            inverted_elements=simulation.report.inverted,
            contacts=self._last_contacts if simulation.collision_surfaces else None,
            fallbacks=self._last_fallbacks,
            backend=simulation.backend,
        )
        return self._on_state(simulation, whole)
