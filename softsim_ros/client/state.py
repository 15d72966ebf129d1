"""State of a robot as a client knows it: joints, goal, nodes, reports."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple, TypeAlias

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from softsim_core.scene import RobotDescription
from softsim_node import EVERY_ONE

STALE_AFTER_S: Final = 2.0
"""Age in [s] from which measured positions are too old to base a command on."""

SETTLING_S: Final = 0.5
"""Time in [s] that a joint gets, beyond its travel at top speed, to reach a command."""

REACHED: Final = 0.02
"""Largest distance from its command, in [rad] or [m], at which a joint has arrived.

It is not zero because a compliant servo sags a little.
"""

_REMEMBERED_ECHOES: Final = 32

BridgeState: TypeAlias = Literal["not running", "init", "no-comm", "comm", "finalized", "changing"]


class EffectorPose(NamedTuple):
    """Position in [m] and unit quaternion (x, y, z, w) of the effector, or of its goal, in the world."""

    position: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]


class Tilt(NamedTuple):
    """Reference of the closed loop: tilts about x and y in [rad]."""

    x: float
    y: float


@dataclass(frozen=True, slots=True)
class RobotState:
    """Present state of a robot and its nodes.

    Attributes:
        measured: Measured joint positions in [rad] or [m], joint order; None before the first message.
        measured_at: Time of the newest measurement, steady clock, in [s].
        efforts: Torque in [N m] or force in [N] of each joint, joint order; empty: not reported.
        commanded: Newest command on the topic, of any sender, same shape and unit; None: unknown.
        trusted_until: Time in [s] until which the joints may still be on their way to `commanded`.
        owns_command: Whether this client sent `commanded` and therefore has to repeat it where needed.
        echoes: Own commands that have not returned on the topic yet, oldest first.
        simulator: State that the simulator reports ("running", "paused", "stopped"); empty: none received.
        real_time_factor: Simulated seconds per wall second in [-]; None: none received.
        time_s: Simulated time in [s]; None: none received.
        time_at: Time of that report, steady clock, in [s].
        dt: Time step in [s]; None: none received.
        fault: Fault that the simulator reports; empty if there is none.
        scene_error: The same if a file of the scene is the cause.
        enforce_limits: Whether the simulator enforces joint limits; None: unknown, the robot's file decides.
        inverse: Whether inverse control is on, in which case only it may publish commands.
        inverse_note: Newest report of the inverse controller, such as "unreachable, 3.2 mm away".
        goal: Goal set by this client; None before the first.
        heard_goal: The newest goal on the topic while inverse control is on, of any sender.
        effector: Pose of the effector; None before the first message.
        effector_at: Time of that message, steady clock, in [s].
        tilt: The closed loop's reference while the loop is on; None if it is off.
        bridge: State of the servo bridge.
        e_stopped: Whether the e-stop is latched.
        pulses_us: Pulse widths in [us] that an emulated board measures on its pins; empty: there are none.
        pulses_at: Time of that message, steady clock, in [s]; -inf without an emulated board.
    """

    measured: tuple[float, ...] | None = None
    measured_at: float = -math.inf
    efforts: tuple[float, ...] = ()
    commanded: tuple[float, ...] | None = None
    trusted_until: float = -math.inf
    owns_command: bool = False
    echoes: tuple[tuple[float, ...], ...] = ()
    simulator: str = ""
    real_time_factor: float | None = None
    time_s: float | None = None
    time_at: float = -math.inf
    dt: float | None = None
    fault: str = ""
    scene_error: str = ""
    enforce_limits: bool | None = None
    inverse: bool = False
    inverse_note: str = ""
    goal: EffectorPose | None = None
    heard_goal: EffectorPose | None = None
    effector: EffectorPose | None = None
    effector_at: float = -math.inf
    tilt: Tilt | None = None
    bridge: BridgeState = "not running"
    e_stopped: bool = False
    pulses_us: tuple[float, ...] = ()
    pulses_at: float = -math.inf

    @property
    def stands(self) -> bool:
        """Whether the simulation makes no steps."""
        return self.simulator in ("paused", "stopped")

    @property
    def paused(self) -> bool:
        """Whether the simulation is paused by a request."""
        return self.simulator == "paused"

    def is_fresh(self, now: float) -> bool:
        """Return whether the measured positions are recent enough to base a command on, at `now` in [s]."""
        return self.measured is not None and now - self.measured_at <= STALE_AFTER_S


def with_measurement(
    state: RobotState, positions: Sequence[float], now: float, efforts: Sequence[float] = ()
) -> RobotState:
    """Return the state after a measurement of all joints; one with a non-finite position is ignored."""
    if not all(map(math.isfinite, positions)):
        return state
    return replace(state, measured=tuple(positions), measured_at=now, efforts=tuple(efforts))


def with_received_command(
    state: RobotState, robot: RobotDescription, values: Sequence[float], now: float
) -> RobotState:
    """Return the state after a command on the topic: our own changes nothing, another becomes the newest."""
    command = tuple(values)
    if command in state.echoes:
        return replace(state, echoes=state.echoes[state.echoes.index(command) + 1 :])
    if state.owns_command and command == state.commanded:
        return state  # our own command, repeated
    if len(command) != len(robot.joints) or not all(map(math.isfinite, command)):
        return state  # the simulator refuses it and reports that
    return with_command(state, robot, command, now)


def with_command(
    state: RobotState, robot: RobotDescription, values: tuple[float, ...], now: float, *, own: bool = False
) -> RobotState:
    """Return the state once `values` are commanded; with `own`, they are expected back on the topic."""
    start = commandable(state, robot).measured or values
    travel = max(
        (abs(b - a) / joint.limits.speed for a, b, joint in zip(start, values, robot.joints, strict=True)),
        default=0.0,
    )
    return replace(
        state,
        commanded=values,
        trusted_until=now + travel + SETTLING_S,
        owns_command=own,
        echoes=(*state.echoes, values)[-_REMEMBERED_ECHOES:] if own else state.echoes,
    )


def commandable(state: RobotState, robot: RobotDescription) -> RobotState:
    """Return the state with efforts as measured values where these are commanded (chamber pressures)."""
    if state.measured is None or len(state.efforts) != len(state.measured):
        return state
    values = tuple(
        effort if joint.by_effort else position
        for joint, position, effort in zip(robot.joints, state.measured, state.efforts, strict=True)
    )
    return replace(state, measured=values)


def stationary_commands(state: RobotState, now: float) -> tuple[float, ...]:
    """Return commands for joints that are not to move.

    A joint keeps its command while it may still be moving there, or has arrived. Otherwise something else (a
    trajectory, a reset) moved it, and its present position is returned: an old command must not pull it back.
    """
    assert state.measured is not None
    if state.commanded is None:
        return state.measured
    return tuple(
        command if now <= state.trusted_until or abs(command - position) <= REACHED else position
        for command, position in zip(state.commanded, state.measured, strict=True)
    )


def with_inverse(state: RobotState, enabled: bool) -> RobotState:
    """Return the state once inverse control is on, or off; either way the previous goal is dropped."""
    return replace(state, inverse=enabled, goal=None, heard_goal=None, inverse_note="")


def known_effector(state: RobotState, now: float) -> EffectorPose | None:
    """Return the effector's pose at `now` [s], or None if no recent one has arrived."""
    return state.effector if now - state.effector_at <= STALE_AFTER_S else None


def enforces_limits(state: RobotState, robot: RobotDescription) -> bool:
    """Return whether joint limits are enforced: as the simulator reports, else as the robot's file says."""
    return robot.commands.enforce_limits if state.enforce_limits is None else state.enforce_limits


Watcher = Callable[[RobotState], None]
"""Called with the state after every change, in the thread that serves the node."""


class RobotSnapshot:
    """The robot's description and its newest state.

    Attributes:
        robot: Replaced after the simulator has loaded another scene.
        state: Replaced as a whole, never modified.
        watchers: Called after every change.
    """

    def __init__(self, robot: RobotDescription, say: Callable[[str], None]) -> None:
        self.robot, self.say = robot, say
        self.state = RobotState()
        self.watchers: list[Watcher] = []

    def put(self, state: RobotState) -> None:
        """Replace the state and call the watchers."""
        if state is not self.state:
            self.state = state
            for watcher in self.watchers:
                watcher(state)

    def change(self, **values: Any) -> None:
        """Replace the state by one with other values of some attributes."""
        self.put(replace(self.state, **values))


class Reports:
    """Follows `/diagnostics` for simulator and inverse control of the node's namespace.

    Whether something runs, is on or is paused is not read here; typed topics report that. `on_inverse` is
    called with the report of inverse control.
    """

    def __init__(self, node: Node, snapshot: RobotSnapshot, on_inverse: Callable[[str], None]) -> None:
        self._snapshot, self._on_inverse = snapshot, on_inverse
        space = node.get_namespace().strip("/")
        self._simulator, self._inverse = (
            f"{space}/{name}".lstrip("/") for name in ("simulator", "inverse_controller")
        )
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVERY_ONE)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._simulator:
                self._on_simulator(status)
            elif status.name == self._inverse:
                self._on_inverse(status.message)

    def _on_simulator(self, status: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in status.values}
        fault = status.message if status.level == DiagnosticStatus.ERROR else ""
        self._snapshot.change(
            real_time_factor=_number(values, "real_time_factor"),
            time_s=_number(values, "time_s"),
            time_at=time.monotonic(),
            dt=_number(values, "dt_s"),
            fault=fault,
            scene_error=fault if values.get("scene") == "not loaded" else "",
        )


def _number(values: Mapping[str, str], name: str) -> float | None:
    try:
        return float(values[name])
    except (KeyError, ValueError):
        return None
