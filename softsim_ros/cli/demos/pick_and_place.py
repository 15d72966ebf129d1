"""Pick and place by the gripper on the arm: the plan, and what topics report of it.

It knows where the objects stand and where they shall stand; that they are heavier, or smoother, it does not.

Commands go out as one joint trajectory; poses, contacts and the flange's wrench come in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Final, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from softsim_core.base.arrays import Array
from softsim_core.control.inverse.workspace import reach
from softsim_core.scene.building.builder import build
from softsim_core.scene.robot import RobotDescription
from softsim_node.topics import EVERY_ONE
from softsim_ros.cli.demos.demo import LEAD_S
from softsim_ros.cli.demos.shown_bodies import ShownBodies, ShownBody
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.client.services import Done
from softsim_ros.messages.sensors import read_contact_cloud

WRIST: Final = "flange_roll"
"""Joint of the arm that moves the flange."""
GRASP_POINT: Final = np.array([0.0025, 0.0, 0.1158])
"""Place between the fingers in the frame that the flange's joint moves, in [m]."""
CLOSED_M: Final = 0.021
"""How far the cables are pulled to hold something."""
AWAY: Final = np.array([0.0, 0.36, 0.0])
"""From where an object stands to where it shall stand, in [m]."""
UP: Final = np.array([0.0, 0.0, 0.10])
"""From there to where the gripper passes over it, in [m]."""
SAMPLE_S: Final = 0.1
"""A way point of the trajectory every so many seconds."""


class Phase(NamedTuple):
    """A part of the plan: what is done with which object, how long in [s], where to, pull of cables [m]."""

    name: str
    object: str
    duration_s: float
    target: Array
    pull: float

    @property
    def words(self) -> str:
        """For people."""
        return f"{self.name} {self.object}"


def objects_of(robot: RobotDescription) -> dict[str, Array]:
    """What can be taken: rigid bodies with mass, and where they stand (3,) in [m]."""
    bodies = robot.scene.rigid_bodies
    return {each.name: np.array(each.pose.translation) for each in bodies if each.mass is not None}


def phases_of(robot: RobotDescription) -> list[Phase]:
    """All parts of the plan, one behind the other."""
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
    """The plan as joint positions in [rad] and [m], by time from its start in [s].

    The point between the fingers goes along straight lines with the least jerk; the gripper looks where it
    looks at the start.

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
"""So far from where it shall stand an object may be put down."""
STANDS_M: Final = 0.004
"""So much higher or lower than at the start an object may stand: on a tray, upright."""
GRAVITY: Final = 9.81


@dataclass
class Taken:
    """What was seen of an object.

    Attributes:
        start: Where it stood, shape (3,) in [m].
        lifted: How high it was, beyond that, at most while it was carried, in [m].
        end: Where it stands now.
        grip: Largest sum of the forces of the fingers on it, in [N].
        weights: Force along the vertical that the flange felt while it was carried, in [N].
    """

    start: Array
    lifted: float = 0.0
    end: Array = field(default_factory=lambda: np.full(3, np.nan))
    grip: float = 0.0
    weights: list[float] = field(default_factory=list)

    @property
    def miss(self) -> float:
        """How far it stands from where it shall, across, in [m]."""
        return float(np.linalg.norm((self.end - self.start - AWAY)[:2]))

    @property
    def why_not(self) -> str:
        """Why it is not where it shall be, in words; empty: it is."""
        if self.lifted < 0.5 * float(UP[2]):
            return f"was not lifted ({1e3 * self.lifted:.0f} mm)"
        if not self.miss <= ALLOWED_MISS_M:
            return f"stands {1e3 * self.miss:.0f} mm from its place"
        if not abs(float(self.end[2] - self.start[2])) <= STANDS_M:
            return f"does not stand upright ({1e3 * float(self.end[2] - self.start[2]):+.0f} mm)"
        return ""


class PickAndPlace:
    """Sends the plan once and records what the topics tell of the objects.

    Args:
        node: The node whose executor delivers the messages.
        client: The arm.
    """

    robot: ClassVar[str] = "pick_and_place"

    def __init__(self, node: Node, client: RobotClient) -> None:
        self._client = client
        self._phases, self._way = phases_of(client.robot), way_of(client.robot)
        self.duration_s = sum(each.duration_s for each in self._phases)
        self.began: float | None = None
        self.heard, self._now, self._empty = 0, 0.0, 0.0
        self.taken: dict[str, Taken] = {}
        names = client.robot.scene.body_names
        self._fingers = np.array([k for k, each in enumerate(client.robot.scene.bodies)])
        self._numbers = {name: names.index(name) for name in objects_of(client.robot)}
        ShownBodies(node, self._on_poses)
        node.create_subscription(PointCloud2, "contacts/points", self._on_contacts, EVERY_ONE)
        node.create_subscription(WrenchStamped, "sensors/flange", self._on_wrench, EVERY_ONE)

    @property
    def is_ready(self) -> bool:
        """Whether the simulator is heard and hears."""
        heard = self.heard > 0 and self._client.state.measured is not None
        return heard and self._client.joints.are_followed

    @property
    def elapsed(self) -> float:
        """Simulated seconds since the plan began; < 0 before."""
        return 0.0 if self.began is None else self._now - self.began

    @property
    def phase(self) -> str:
        """What the arm does now."""
        phase = self._phase
        return "done" if phase is None else phase.words

    @property
    def _phase(self) -> Phase | None:
        left = self.elapsed
        for phase in self._phases:
            if left < phase.duration_s:
                return phase
            left -= phase.duration_s
        return None

    def begin(self, done: Done) -> None:
        """Send the plan: one trajectory of all joints."""
        self.began = self._now + LEAD_S
        self._client.joints.follow(self._way, done, begin_s=self.began)

    def told(self) -> tuple[list[str], bool]:
        """What was measured, in sentences, and whether all objects stand where they shall."""
        sentences = []
        for name, seen in self.taken.items():
            weight = np.median(seen.weights) - self._empty if seen.weights else np.nan
            sentences.append(
                f"{name}: {seen.why_not or f'{1e3 * seen.miss:.1f} mm from its place'}; largest grip force "
                f"{seen.grip:.2f} N, weighs {1e3 * weight / GRAVITY:.1f} g at the flange"
            )
        return sentences, bool(self.taken) and not any(each.why_not for each in self.taken.values())

    def _on_poses(self, time_s: float, bodies: Mapping[str, ShownBody]) -> None:
        self.heard, self._now = self.heard + 1, time_s
        if self.began is None or not all(name in bodies for name in self._numbers):
            return
        for name in self._numbers:
            here = bodies[name].position
            seen = self.taken.setdefault(name, Taken(here))
            seen.end = here
            phase = self._phase
            if phase is not None and (phase.name, phase.object) == ("carry", name):
                seen.lifted = max(seen.lifted, float(here[2] - seen.start[2]))

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
        """The flange looks down all the time: its z axis is the vertical."""
        weight, phase = -float(message.wrench.force.z), self._phase
        if phase is not None and phase.object in self.taken and self.began is not None:
            if phase.name == "carry":
                self.taken[phase.object].weights.append(weight)
            elif phase.name == "over":
                self._empty = weight
