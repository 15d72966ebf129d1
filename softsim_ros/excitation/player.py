"""Play motions on a robot through its client, and stop when they are no longer safe, or on request."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from softsim_core.base import Array, SoftSimError
from softsim_core.lab.identification import ExcitationSettings, motion_limits_of, way
from softsim_node import LATCHED, ending
from softsim_ros.client import RobotSession, commandable
from softsim_ros.excitation.readings import Readings
from softsim_ros.excitation.sensors import ExcitationError, Sensor

SILENT_S: Final = 2.0
"""Time in [s] without messages after which a topic counts as dead."""

LOOK_S: Final = 0.003
FIRST_WITHIN_S: Final = 5.0
SHIFTED: Final = 1e-6
KEEPS_UP: Final = 0.95
DEPTH: Final = 500
LATE_S: Final = 5.0
"""Longest delay in [s], in its own time, at which a simulated robot receives the last command of a motion."""
ARRIVED: Final = 1e-6
"""Largest distance from its command, in [rad] or [m], at which a joint has arrived."""


class MeasurementInterruptedError(ExcitationError):
    """The user requested the end."""


class Player:
    """Moves a robot on the usual command topic, with all limits applied.

    Time is that of the robot: for a simulator that of the stamps of its joint states, which stand still with
    it, and for a real robot that of this computer.

    Args:
        session: The robot.
        real: Whether the servo bridge moves the measured robot; otherwise it is simulated.
        settings: Speed of its motions.

    Attributes:
        joints: Commands of the joints as the robot's own topics report them, each of shape (j,).
        real: As given.
    """

    def __init__(self, session: RobotSession, real: bool, settings: ExcitationSettings) -> None:
        self._session, self.real, self._settings = session, real, settings
        self._motion_limits = motion_limits_of(session.client.robot, settings.reach)
        self._period_s = settings.period_s
        self._at: Array | None = None
        self._leaving = self._foreign = False
        self._sent: set[tuple[float, ...]] = set()
        self._readings: tuple[Readings, ...] = ()
        topic = "applied_joint_states" if real else "joint_states"
        node = session.client.node
        self.joints = Readings(topic, self._to_command)
        node.create_subscription(JointState, topic, self.joints, DEPTH)
        node.create_subscription(Float64MultiArray, "position_controller/commands", self._on_command, DEPTH)
        self._shift: float | None = None
        node.create_subscription(Float64, "base_shift", self._on_shift, LATCHED)

    # --- commands of the joints ----------------------------------------------------------------------

    def _on_command(self, message: Float64MultiArray) -> None:
        """Check every command on the topic, including the own ones; the client uses the newest only."""
        if self._sent and tuple(message.data) not in self._sent:
            self._foreign = True

    def _on_shift(self, message: Float64) -> None:
        self._shift = float(message.data)

    @property
    def command(self) -> Array:
        """The newest command, shape (j,)."""
        assert self._at is not None
        return self._at

    def _to_command(self, message: JointState) -> Sequence[float]:
        """Return joint states as a command.

        For a real robot, and for joints that follow exactly, these are the positions; for others the last
        command sent.
        """
        robot, own = self._session.client.robot, self._at
        if len(message.position) != len(message.name) or any(
            name not in message.name for name in robot.joint_names
        ):
            return ()
        positions = []
        for k, joint in enumerate(robot.joints):
            exact = joint.moves_frame and joint.stiffness is None
            if self.real or exact or own is None:
                positions.append(float(message.position[list(message.name).index(joint.name)]))
            else:
                positions.append(float(own[k]))
        return positions

    # --- moving ---------------------------------------------------------------------------------------

    def begin(self, sensors: Sequence[Sensor]) -> None:
        """Wait for the first message of all topics; a simulated robot plays its start animation.

        Raises:
            ExcitationError: a topic has no messages.
            ClientError: the robot refuses.
        """
        self._readings = (self.joints, *(each.readings for each in sensors))
        end = time.monotonic() + FIRST_WITHIN_S
        while silent := [each.topic for each in self._readings if not len(each)]:
            if time.monotonic() > end:
                raise ExcitationError(f"nothing comes on {', '.join(silent)} within {FIRST_WITHIN_S:g} s")
            time.sleep(LOOK_S)
        client = self._session.client
        robot = client.robot
        shifted = self._shift is not None and abs(self._shift - robot.start_shift) < SHIFTED
        if not self.real and robot.start is not None and not shifted:
            self._session.do(client.simulator.start)
            self._session.wait_until_there()
        state = commandable(self._session.state, robot)
        assert state.measured is not None
        limits = [joint.limits for joint in robot.joints]
        self._at = np.clip(state.measured, [each.lower for each in limits], [each.upper for each in limits])

    @property
    def is_slow(self) -> bool:
        """Whether a simulator stamps with the wall clock but runs slower than it."""
        factor, newest = self._session.state.real_time_factor, self.joints.newest
        on_wall = newest is not None and abs(newest - time.time()) < FIRST_WITHIN_S
        return not self.real and on_wall and factor is not None and factor < KEEPS_UP

    @property
    def _now(self) -> float:
        newest = self.joints.newest
        return time.monotonic() if self.real or newest is None else newest

    def wait(self, seconds: float, tick: Callable[[float], None] | None = None) -> None:
        """Let time pass; `tick` is called with the elapsed time.

        Raises:
            ExcitationError: the measurement cannot continue.
        """
        begin = self._now
        while (spent := self._now - begin) < seconds:
            self._check()
            if tick is not None:
                tick(spent)
            time.sleep(LOOK_S)

    def play(self, commands: Array, tick: Callable[[float], None] | None = None) -> None:
        """Send commands (k, j), one per period; late ones are skipped.

        Raises:
            ExcitationError: the measurement cannot continue.
            ClientError: a command is refused.
        """
        begin, sent = self._now, -1
        while sent < len(commands) - 1:
            self._check()
            spent = self._now - begin
            due = min(int(spent / self._period_s), len(commands) - 1)
            if due > sent:
                sent = due
                self._send(commands[due])
            else:
                time.sleep(LOOK_S)
            if tick is not None:
                tick(spent)
        self.wait(self._period_s)

    def go(self, goal: Array) -> None:
        """Go to a pose (j,) with the requested fraction of the limits; raises as `play`.

        For a simulated robot, wait for at most LATE_S until it has received the motion, since on a busy
        computer it may receive it late.
        """
        self.play(way(self.command, goal, self._motion_limits, self._settings.speed, self._period_s))
        begin = self._now
        while not self.real and self._now - begin < LATE_S:
            _, _, commands = self.joints.since(len(self.joints) - 1)
            if np.abs(commands[-1] - self.command).max(initial=0.0) <= ARRIVED:
                break
            self.wait(self._period_s)

    def leave(self) -> str:
        """Go home whatever was requested; return why that failed, or an empty string."""
        self._leaving = True
        if self._at is None:
            return ""
        try:
            self.go(self._motion_limits.home)
        except SoftSimError as error:
            return str(error)
        return ""

    def _send(self, command: Array) -> None:
        self._at = command
        self._sent.add(tuple(command.tolist()))
        self._session.do(self._session.client.joints.command, command.tolist())

    # --- reasons to end -------------------------------------------------------------------------------

    def _check(self) -> None:
        state = self._session.state
        if ending.asked and not self._leaving:
            raise MeasurementInterruptedError("interrupted")
        if state.e_stopped:
            raise ExcitationError(
                "the e-stop is latched: the servos hold still; clear it (servo_bridge/clear_e_stop) when the "
                "robot is safe, then measure again"
            )
        if self.real and state.bridge != "comm":
            raise ExcitationError(f"the servo bridge no longer sends, it is {state.bridge}; its log says why")
        if not self.real and state.stands:
            why = state.fault or f"the simulation is {state.simulator}"
            raise ExcitationError(f"the robot stands still: {why}")
        if self._foreign:
            raise ExcitationError(
                "another node commands the joints (position_controller/commands); a robot that is measured "
                "must not be moved by another program"
            )
        for each in self._readings:
            if time.monotonic() - each.arrived > SILENT_S:
                raise ExcitationError(f"nothing came on {each.topic} for {SILENT_S:g} s")
