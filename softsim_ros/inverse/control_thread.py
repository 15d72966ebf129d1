"""Inverse control in a thread of its own: one tick a model step on the steady clock, only while enabled."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypeVar

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import CommandError, SoftSimError
from softsim_core.inverse.controller import InverseController, InverseReport
from softsim_core.mechanics.pose import Pose
from softsim_core.scene.control import InverseSettings
from softsim_core.scene.joint import JointDescription
from softsim_node.ending import ending
from softsim_ros.inverse.following import Following, has_moved
from softsim_ros.inverse.plant import Feedback, Plant
from softsim_ros.simulator.pacing import Pacer, RateGate, SpeedMeter
from softsim_ros.work_queue import WorkQueue

Mode: TypeAlias = Literal["off", "on", "holding"]
Result = TypeVar("Result")

DISABLED = "goal ignored: inverse control is off; call ~/enable first"


@dataclass(frozen=True)
class ControlStatus:
    """What the thread did lately.

    Attributes:
        mode: "off", "on", or "holding" the command because the robot does not follow.
        sentence: What a person should know; empty where there is nothing.
        fault: Whether it went off by itself.
        report: The newest tick since it was enabled.
        measured: Whether a measured pose corrected the model in that tick.
        rate: Ticks a second, of the last second or so.
        stages_ms: Mean times of that second in [ms].
        late_s: Wall time in [s] given up because ticks took too long, in all.
    """

    mode: Mode = "off"
    sentence: str = ""
    fault: bool = False
    report: InverseReport | None = None
    measured: bool = False
    rate: float = 0.0
    stages_ms: tuple[tuple[str, float], ...] = ()
    late_s: float = 0.0


class ControlThread:
    """Owns an inverse controller once started: nothing else may touch it, except through `call`.

    Args:
        controller: The model and its control law.
        joints: Of the robot, in command order.
        dt: Time from tick to tick in [s].
        publish: Called in the thread with every command, shape (j,), and with the model's pose.
        warn: Called in the thread with one sentence when the robot stops to follow, and when it is back.
        ended: Called in the thread with one sentence when control goes off by itself.
    """

    def __init__(
        self,
        controller: InverseController,
        joints: Sequence[JointDescription],
        dt: float,
        publish: Callable[[Array, Pose], None],
        warn: Callable[[str], None],
        ended: Callable[[str], None],
    ) -> None:
        self._controller, self._joints, self._dt = controller, joints, dt
        self._publish, self._warn, self._ended = publish, warn, ended
        self.plant = Plant()
        self.feedback: Feedback = "none"
        self.settings = controller.settings
        self._goal: Pose | None = None
        self._goal_lock = threading.Lock()
        self._requests = WorkQueue("inverse control", "one tick", lambda: self.is_alive)
        self._pacer, self._gate = Pacer(), RateGate(1.0)
        self._meter = SpeedMeter(dt, time.monotonic())
        self._mode: Mode = "off"
        self._foreign = ""
        self._base_shift = 0.0
        self._following = Following(joints, 0.0)
        self._command: Array | None = None
        self._rate = 0.0
        self._stages_ms: tuple[tuple[str, float], ...] = ()
        self._report: InverseReport | None = None
        self.status = ControlStatus()
        self._thread = threading.Thread(target=self._run, name="inverse control", daemon=True)

    # --- from any thread ------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to serve; control is off."""
        self._thread.start()

    def close(self) -> None:
        """End after the tick in progress and join, see `ending.wait_for`; a second call does nothing."""
        self._requests.ask_to_end()
        ending.wait_for(self._thread)

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def set_goal(self, goal: Pose) -> None:
        """Give a goal for the next tick; the newest wins.

        Raises:
            CommandError: control is off.
        """
        if self._mode == "off":
            raise CommandError(DISABLED)
        with self._goal_lock:
            self._goal = goal

    def call(self, action: Callable[[InverseController], Result]) -> Result:
        """Run an action on the controller between two ticks and wait for its result.

        Args:
            action: Gets the controller; what it raises is raised here.

        Raises:
            SoftSimError: the thread has ended, or is stuck in one tick for longer than REQUEST_TIMEOUT_S.
        """
        return self._requests.ask(lambda: action(self._controller))

    def enable(self, base_shift: float) -> None:
        """Start control from the joints as they are; the goal is where the effector is then.

        Args:
            base_shift: Of the joint bases in [m], where the robot does not say it itself.

        Raises:
            CommandError: no joint states are known, or the robot is not the model's.
            SoftSimError: the model cannot be brought there.
        """

        def begin(controller: InverseController) -> None:
            if self._mode != "off":
                return
            if self._foreign:
                raise CommandError(f"inverse control stays off: {self._foreign}")
            now, plant = time.monotonic(), self.plant
            if plant.joints is None or plant.is_silent(now):
                what = "yet" if plant.joints is None else f"for {now - plant.joints_at:.0f} s"
                raise CommandError(
                    f"not enabled: no joint states received {what}; start the simulator, or on a bare robot "
                    "the servo bridge (it must be sending)"
                )
            self._base_shift = base_shift if plant.base_shift is None else plant.base_shift
            controller.start(plant.joints, self._base_shift)
            with self._goal_lock:
                self._goal = None
            self._command = self._report = None
            self._following = Following(self._joints, time.monotonic())
            self._pacer.start()
            self._meter.take(time.monotonic())
            self._mode = "on"
            self._show()

        self.call(begin)

    def tune(self, settings: InverseSettings) -> None:
        """Take other weights, gains and tolerances; limits stay what they were at start."""

        def change(controller: InverseController) -> None:
            controller.settings = self.settings = settings

        self.call(change)

    def set_foreign(self, sentence: str) -> None:
        """Stay off while the robot is not the one of the model, as a sentence says; empty: it is again."""

        def stay_off(_: InverseController) -> None:
            self._foreign = sentence
            if sentence and self._mode != "off":
                self._end(f"inverse control is off: {sentence}")

        self.call(stay_off)

    def disable(self) -> None:
        """Stop control: nothing is published any more."""
        self.call(lambda _: self._stop(""))

    # --- in the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        delay: float | None = None
        while self._requests.serve(delay, lambda: self._mode):
            if self._mode == "off":
                delay = None
                continue
            delay = self._pacer.wait_s(time.monotonic(), self._dt) if self._try_tick() else None

    def _try_tick(self) -> bool:
        """Tick; False: control went off."""
        try:
            self._tick()
        except SoftSimError as error:
            self._fail(str(error))
        except Exception as error:  # whatever it is, the node must live on and the topic be free
            self._fail(f"{type(error).__name__}: {error}")
        return self._mode != "off"

    def _tick(self) -> None:
        now, plant = time.monotonic(), self.plant
        if has_moved(self._base_shift, plant):
            self._fail("the robot was reset, or its start animation played: its bases have moved")
            return
        trouble = self._following.trouble(plant, self._command, now)
        if bool(trouble) != (self._mode == "holding"):
            self._mode = "holding" if trouble else "on"
            self._warn(trouble or "the robot follows again: inverse control goes on")
        measured = plant.measured_pose(self.feedback, self._model_pose(), now)
        if not trouble:
            with self._goal_lock:
                goal, self._goal = self._goal, None
            if goal is not None:
                self._controller.set_goal(goal)
            report = self._controller.tick(measured)
            self._report, self._command = report, np.asarray(report.command)
            self._meter.add_step({"qp": report.qp_ms, "tick": report.tick_ms})
        if self._report is not None and self._command is not None:
            self._publish(self._command, self._report.model_pose)
        self._show(trouble, measured is not None)

    def _model_pose(self) -> Pose | None:
        return None if self._report is None else self._report.model_pose

    def _fail(self, reason: str) -> None:
        self._end(f"inverse control is off: {reason}; enable it again to go on from there")

    def _end(self, sentence: str) -> None:
        self._stop(sentence)
        self._ended(sentence)

    def _stop(self, sentence: str) -> None:
        self._mode = "off"
        self._show(sentence)

    def _show(self, sentence: str = "", measured: bool = False) -> None:
        now = time.monotonic()
        if self._mode != "off" and self._gate.passes(now):
            speed = self._meter.take(now)
            self._rate, self._stages_ms = speed.steps_per_second, tuple(speed.stages_ms.items())
        report = self._report if self._mode != "off" else None
        self.status = ControlStatus(
            mode=self._mode,
            sentence=sentence or ("" if report is None else report.sentence),
            fault=self._mode == "off" and bool(sentence),
            report=report,
            measured=measured,
            rate=self._rate if self._mode != "off" else 0.0,
            stages_ms=self._stages_ms,
            late_s=self._pacer.late_s,
        )
