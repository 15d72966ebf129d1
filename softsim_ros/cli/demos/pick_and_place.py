"""Pick and place with the gripper on the arm: the plan, and its assessment from topics.

It knows the present and the target positions of the objects, but not that some are heavier or smoother.

Commands are published as one joint trajectory. Poses, contacts and the flange's wrench are received.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from softsim_core.base import Array
from softsim_core.control.inverse import reach
from softsim_core.scene import RobotDescription
from softsim_core.scene.building import build
from softsim_node import EVERY_ONE
from softsim_ros.cli.demos.show import Show, ShownBody, WayPoints
from softsim_ros.client import RobotClient
from softsim_ros.messages import read_contact_cloud

WRIST: Final = "flange_roll"
"""Joint of the arm that moves the flange."""
GRASP_POINT: Final = np.array([0.0025, 0.0, 0.1158])
"""Position between the fingers in the frame that the flange's joint moves, in [m]."""
CLOSED_M: Final = 0.021
"""Pull of the cables in [m] to hold an object."""
AWAY: Final = np.array([0.0, 0.36, 0.0])
"""Displacement from an object's present to its target position, in [m]."""
UP: Final = np.array([0.0, 0.0, 0.10])
"""Displacement from an object to the gripper's position above it, in [m]."""
SAMPLE_S: Final = 0.1
"""Time between way points of the trajectory in [s]."""


class Phase(NamedTuple):
    """A part of the plan: action, object, duration in [s], target position and pull of the cables in [m]."""

    name: str
    object: str
    duration_s: float
    target: Array
    pull: float


def objects_of(robot: RobotDescription) -> dict[str, Array]:
    """Return the objects to move, which are the rigid bodies with mass, and their positions (3,) in [m]."""
    bodies = robot.scene.rigid_bodies
    return {each.name: np.array(each.pose.translation) for each in bodies if each.mass is not None}


def phases_of(robot: RobotDescription) -> list[Phase]:
    """Return all parts of the plan in order."""
    phases = []
    for name, here in objects_of(robot).items():
        there = here + AWAY
        phases += [
            Phase("over", name, 1.5, here + UP, 0.0),
            Phase("lower to", name, 1.0, here, 0.0),
            Phase("close round", name, 0.8, here, CLOSED_M),
            Phase("squeeze", name, 0.3, here, CLOSED_M),
            Phase("lift", name, 1.0, here + UP, CLOSED_M),
            Phase("carry", name, 2.0, there + UP, CLOSED_M),
            Phase("put down", name, 1.0, there, CLOSED_M),
            Phase("let go of", name, 0.8, there, 0.0),
            Phase("leave", name, 0.8, there + UP, 0.0),
        ]
    return phases


def way_of(robot: RobotDescription) -> list[tuple[float, dict[str, float]]]:
    """Return the plan as joint positions in [rad] and [m], by time from its start in [s].

    The point between the fingers moves along straight lines with minimum jerk; the gripper keeps its initial
    orientation.

    Raises:
        NotReachedError: the arm does not reach an object.
    """
    model = build(robot.scene).model
    cables = np.array([not joint.moves_frame for joint in robot.joints])
    state = model.rest_state()
    positions = state.joint_positions.copy()
    origin, rotation = model.joint_frame(robot.joint_names.index(WRIST), state)
    here, pull, time_s, way = origin + rotation @ GRASP_POINT, 0.0, 0.0, []
    for phase in phases_of(robot):
        count = max(1, round(phase.duration_s / SAMPLE_S))
        for k in range(1, count + 1):
            share = k / count
            share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
            point = here + share * (phase.target - here)
            positions = reach(model, WRIST, point - rotation @ GRASP_POINT, rotation, positions)
            positions[cables] = pull + share * (phase.pull - pull)
            way.append(
                (
                    time_s + k / count * phase.duration_s,
                    dict(zip(robot.joint_names, positions.tolist(), strict=True)),
                )
            )
        here, pull, time_s = phase.target, phase.pull, time_s + phase.duration_s
    return way


ALLOWED_MISS_M: Final = 0.015
"""Largest horizontal distance in [m] from the target at which an object may be put down."""
STANDS_M: Final = 0.004
"""Largest height difference in [m] from the start, which shows that an object stands upright on a tray."""
GRAVITY: Final = 9.81


@dataclass
class MeasuredObject:
    """Measurements of an object.

    Attributes:
        start: Initial position, shape (3,) in [m].
        lifted: Largest height above that while it was carried, in [m].
        end: Present position, shape (3,) in [m].
        grip: Largest sum of the finger forces on it, in [N].
        weights: Vertical force that the flange measured while it was carried, in [N].
    """

    start: Array
    lifted: float = 0.0
    end: Array = field(default_factory=lambda: np.full(3, np.nan))
    grip: float = 0.0
    weights: list[float] = field(default_factory=list)

    @property
    def miss(self) -> float:
        """Horizontal distance from its target in [m]."""
        return float(np.linalg.norm((self.end - self.start - AWAY)[:2]))

    @property
    def why_not(self) -> str:
        """Reason why the object is not at its target; an empty string if it is."""
        if self.lifted < 0.5 * float(UP[2]):
            return f"was not lifted ({1e3 * self.lifted:.0f} mm)"
        if not self.miss <= ALLOWED_MISS_M:
            return f"stands {1e3 * self.miss:.0f} mm from its place"
        if not abs(float(self.end[2] - self.start[2])) <= STANDS_M:
            return f"does not stand upright ({1e3 * float(self.end[2] - self.start[2]):+.0f} mm)"
        return ""


class PickAndPlace(Show):
    """Moves objects with the gripper on the arm, and records the topics about them."""

    robot = "pick_and_place"

    def __init__(self, node: Node, client: RobotClient) -> None:
        super().__init__(node, client)
        self._phases, self._way = phases_of(client.robot), way_of(client.robot)
        self.duration_s = sum(each.duration_s for each in self._phases)
        self._empty = 0.0
        self.taken: dict[str, MeasuredObject] = {}
        names = client.robot.scene.body_names
        self._fingers = np.arange(len(client.robot.scene.bodies))
        self._numbers = {name: names.index(name) for name in objects_of(client.robot)}
        node.create_subscription(PointCloud2, "contacts/points", self._on_contacts, EVERY_ONE)
        node.create_subscription(WrenchStamped, "sensors/flange", self._on_wrench, EVERY_ONE)

    @property
    def phase(self) -> str:
        """Present phase of the arm."""
        phase = self._phase
        return "done" if phase is None else f"{phase.name} {phase.object}"

    @property
    def _phase(self) -> Phase | None:
        left = self.elapsed
        for phase in self._phases:
            if left < phase.duration_s:
                return phase
            left -= phase.duration_s
        return None

    def _way_points(self) -> WayPoints:
        return self._way

    def report_results(self) -> tuple[list[str], bool]:
        """Return the measurements as messages, and whether all objects are at their targets."""
        lines = []
        for name, item in self.taken.items():
            weight = np.median(item.weights) - self._empty if item.weights else np.nan
            lines.append(
                f"{name}: {item.why_not or f'{1e3 * item.miss:.1f} mm from its place'}; largest grip force "
                f"{item.grip:.2f} N, weighs {1e3 * weight / GRAVITY:.1f} g at the flange"
            )
        return lines, bool(self.taken) and not any(each.why_not for each in self.taken.values())

    def _observe(self, bodies: Mapping[str, ShownBody]) -> None:
        if self.began is None or not all(name in bodies for name in self._numbers):
            return
        for name in self._numbers:
            here = bodies[name].position
            measured = self.taken.setdefault(name, MeasuredObject(here))
            measured.end = here
            phase = self._phase
            if phase is not None and (phase.name, phase.object) == ("carry", name):
                measured.lifted = max(measured.lifted, float(here[2] - measured.start[2]))

    def _on_contacts(self, message: PointCloud2) -> None:
        rows = read_contact_cloud(message)
        forces = np.stack([rows[f"force_{axis}"] for axis in "xyz"], axis=1)
        sizes = np.linalg.norm(forces, axis=1)
        for name, number in self._numbers.items():
            if name in self.taken:
                one, other = rows["body_a"], rows["body_b"]
                gripped = (one == number) & np.isin(other, self._fingers)
                gripped |= (other == number) & np.isin(one, self._fingers)
                self.taken[name].grip = max(self.taken[name].grip, float(sizes[gripped].sum()))

    def _on_wrench(self, message: WrenchStamped) -> None:
        """Record the weight; the flange always points down, so its z axis is vertical."""
        weight, phase = -float(message.wrench.force.z), self._phase
        if phase is not None and phase.object in self.taken and self.began is not None:
            if phase.name == "carry":
                self.taken[phase.object].weights.append(weight)
            elif phase.name == "over":
                self._empty = weight
