"""Subscriptions of the simulator: joint commands, pulls, moved joint bases, states of driven joints."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from geometry_msgs.msg import Wrench, WrenchStamped
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState, MultiDOFJointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from softsim_core.base import MOST_NAMES, Array, CommandError, SoftSimError, names_up_to, shorten
from softsim_core.physics.mechanics import check_command, rotation_of
from softsim_core.simulation import Simulation
from softsim_node import GuardedNode, LiveParameters, ParameterError, RobotFrames, parameter, steady_timer
from softsim_ros.messages import read_base_target
from softsim_ros.nodes.simulator.physics_thread import PhysicsThread
from softsim_ros.nodes.simulator.setpoints import (
    named_command,
    seconds,
    trajectory_command,
    trajectory_delay,
)
from softsim_ros.nodes.simulator.trajectory_action import TrajectoryAction

ROUND_OFF = 1e-9
LOOK_PERIOD_S = 0.1
"""Period in [s] at which the node checks whether a pull has timed out."""


@dataclass(frozen=True, kw_only=True)
class PullSettings:
    """Values of the parameters."""

    pull_timeout: float = parameter(
        0.5, "A pull is let go when it was not sent again for so long", unit="s", within=(0.01, 60.0)
    )
    pull_limit: float = parameter(
        10.0, "Largest force of a pull; a stronger one is shortened", unit="N", within=(0.0, 1.0e6)
    )


class Pulls:
    """Subscribes to `external_wrench` and applies its force to the simulation.

    The newest message replaces earlier ones. Parameters: `pull_timeout` in [s], after which a force that is
    not sent again is released; `pull_limit` in [N], to which a larger force is reduced.
    """

    def __init__(self, node: GuardedNode, physics: PhysicsThread, frames: RobotFrames) -> None:
        self._physics, self._frames = physics, frames
        self._live = LiveParameters(node, PullSettings())
        self._received_at: float | None = None
        node.create_subscription(WrenchStamped, "external_wrench", self._on_wrench, 1)
        steady_timer(node, LOOK_PERIOD_S, self._look)

    def _on_wrench(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        limit = self._live.values.pull_limit

        def pull(simulation: Simulation) -> None:
            if is_turned(message.wrench):
                raise CommandError("pull refused: only forces pull; leave the torque 0; nothing is pulled")
            pulling_force = limited_force((force.x, force.y, force.z), limit)
            frame = message.header.frame_id
            place = simulation.scene.effector or frame if frame == self._frames.effector else frame
            simulation.forces[:] = pulled_nodes(simulation, place, pulling_force)

        if change(self._physics, pull):
            self._received_at = time.monotonic()

    def _look(self) -> None:
        timeout = self._live.values.pull_timeout
        if self._received_at is not None and time.monotonic() - self._received_at > timeout:
            self._received_at = None
            change(self._physics, let_go)


def change(physics: PhysicsThread, action: Callable[[Simulation], None]) -> bool:
    """Change the simulation between two steps; return False if the physics has ended.

    Raises:
        CommandError: the change is refused.
    """
    try:
        physics.call(action, shows=False)
    except CommandError:
        raise
    except SoftSimError:
        return False
    return True


def is_turned(wrench: Wrench) -> bool:
    """Return whether a wrench has a torque beyond the round-off of its force times a lever of 1 m."""
    force, torque = wrench.force, wrench.torque
    turn = math.hypot(torque.x, torque.y, torque.z)
    return math.isnan(turn) or turn > ROUND_OFF * math.hypot(force.x, force.y, force.z)


def let_go(simulation: Simulation) -> None:
    """Release all pulls."""
    simulation.forces[:] = 0.0


def limited_force(force: tuple[float, float, float], limit: float) -> Array:
    """Return a force in [N], shape (3,), reduced to a length of at most `limit`.

    Raises:
        CommandError: it is not finite.
    """
    if not all(map(math.isfinite, force)):
        raise CommandError(f"pull refused: the force must be finite, not {list(force)}; nothing is pulled")
    size = math.hypot(*force)
    return np.array(force) * (min(1.0, limit / size) if size > 0.0 else 1.0)


def pulled_nodes(simulation: Simulation, frame: str, force: Array) -> Array:
    """Distribute a force at one place to the nodes; return nodal forces in [N], shape (n, 3).

    Args:
        simulation: Simulation that has the nodes.
        frame: "mesh_point/INDEX", a vertex of the visible surface as in mesh/points, or the name of a free
            frame, whose nodes share the force.
        force: In [N], shape (3,), in the axes of that frame; for a vertex, in the axes of the world.

    Raises:
        CommandError: there is no such place.
    """
    forces = np.zeros_like(simulation.forces)
    if match := re.fullmatch(r"mesh_point/([0-9]{1,9})", frame):
        index = int(match[1])
        for body in simulation.bodies:
            if index < len(body.surface.points):
                nodes = body.nodes.start + body.embedding.nodes[index]
                np.add.at(forces, nodes, body.embedding.weights[index][:, None] * force)
                return forces
            index -= len(body.surface.points)
    for region in simulation.model.regions:
        if region.frame >= 0 and region.name == frame:
            turn = rotation_of(simulation.frames()[region.name].quaternion_xyzw)
            forces[region.nodes] = turn @ force / len(region.nodes)
            return forces
    points = sum(len(body.surface.points) for body in simulation.bodies)
    raise CommandError(
        f"pull refused: no place {shorten(frame)!r}; known: mesh_point/0 to mesh_point/{points - 1}, "
        f"free frames {names_up_to(MOST_NAMES, simulation.model.frame_names)}; nothing is pulled"
    )


NAMED_DEPTH: Final = 10
"""Length of the queue of commands by name; each may address other joints, so none replaces another."""


class CommandInputs:
    """Subscribes to joint commands and passes them to the physics; the newest command takes effect.

    `base_target` moves the base of a joint in `world`, see messages.base_target.

    Args:
        now_s: Returns the current time in [s], on the clock of the stamps.
        followed: Topic of joint states that joints of the same names follow; empty: none.

    Attributes:
        action: FollowJointTrajectory.
    """

    def __init__(
        self,
        node: GuardedNode,
        physics: PhysicsThread,
        joint_names: Callable[[], Sequence[str]],
        now_s: Callable[[], float],
        followed: str = "",
    ) -> None:
        self._node, self._physics, self._joint_names, self._now_s = node, physics, joint_names, now_s
        node.create_subscription(Float64MultiArray, "position_controller/commands", self._on_positions, 1)
        node.create_subscription(JointState, "joint_commands", self._on_named, NAMED_DEPTH)
        node.create_subscription(JointTrajectoryMessage, "joint_trajectory", self._on_trajectory, 1)
        node.create_subscription(MultiDOFJointState, "base_target", self._on_base_target, 1)
        if followed:
            self._follow(followed)
        self.action = TrajectoryAction(node, physics, now_s)

    def _follow(self, topic: str) -> None:
        if self._node.resolve_topic_name(topic) == self._node.resolve_topic_name("joint_states"):
            raise ParameterError(
                f"parameter follow_joint_states = {topic} is refused: the simulator sends that itself; name "
                "the topic of the arm's driver"
            )
        self._node.create_subscription(JointState, topic, self._on_followed, qos_profile_sensor_data)

    def _on_followed(self, message: JointState) -> None:
        """Pass on positions of the scene's joints; ignore unknown names and values that are not finite."""
        joint_names = self._joint_names()
        positions = {
            name: float(position)
            for name, position in zip(message.name, message.position, strict=False)
            if name in joint_names and math.isfinite(position)
        }
        if positions:
            self._physics.commanded.driven.receive(positions, seconds(message.header.stamp))

    def _on_positions(self, message: Float64MultiArray) -> None:
        self._physics.commanded.command(np.array(check_command(message.data, self._joint_names())))

    def _on_named(self, message: JointState) -> None:
        self._physics.commanded.command_named(named_command(message, self._joint_names(), self._now_s()))

    def _on_trajectory(self, message: JointTrajectoryMessage) -> None:
        delay = trajectory_delay(message, self._now_s())
        self._physics.commanded.command(trajectory_command(message, self._joint_names()), delay)

    def _on_base_target(self, message: MultiDOFJointState) -> None:
        joint, position = read_base_target(message)
        change(self._physics, lambda simulation: simulation.move_base(joint, position))
