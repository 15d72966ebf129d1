"""Pick and place by the gripper on the arm, and what topics tell of it.

Commands go out as one joint trajectory; poses, contacts and the flange's wrench come in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from softsim_core.arrays import Array
from softsim_ros.cli.demos.demo import LEAD_S
from softsim_ros.cli.demos.pick_plan import AWAY, UP, Phase, objects_of, phases_of, way_of
from softsim_ros.cli.demos.shown_bodies import ShownBodies, ShownBody
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.client.services import Done
from softsim_ros.messages.contacts import read_contact_cloud
from softsim_ros.qos import EVERY_ONE

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
