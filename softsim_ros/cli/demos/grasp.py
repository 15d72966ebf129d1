"""The grasp as a plan with requirements: commands are published on topics, poses received on topics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from rclpy.node import Node

from softsim_core.base import Array
from softsim_ros.cli.demos.show import Show, ShownBody, WayPoints
from softsim_ros.client import RobotClient, RobotState

LOWERED, LIFTED, CLOSED = -0.050, -0.020, 0.012
"""Positions of the slide to grasp and to hold, and pull of the cables, in [m]."""

NEEDED_LIFT, ALLOWED_SLIP = 0.020, 0.002
"""Smallest clearance between cube and floor and largest slip of the cube during the hold, in [m]."""

NEEDED_HOLD_S = 5.0
"""Shortest hold of the cube in [s]."""

CUBE, FLOOR = "cube", "floor"
SETTLE_S = 0.5
"""Time in [s] from the lift to the start of the measurement."""


class WayPoint(NamedTuple):
    """State of the gripper at a time: `time_s` after the start, pull of all cables and height in [m]."""

    phase: str
    time_s: float
    pull: float
    height: float


PLAN = (
    WayPoint("wait", 0.5, 0.0, 0.0),
    WayPoint("lower", 2.0, 0.0, LOWERED),
    WayPoint("close", 3.0, CLOSED, LOWERED),
    WayPoint("squeeze", 3.5, CLOSED, LOWERED),
    WayPoint("lift", 4.5, CLOSED, LIFTED),
    WayPoint("hold", 10.5, CLOSED, LIFTED),
    WayPoint("put down", 12.0, CLOSED, LOWERED),
    WayPoint("open", 13.0, 0.0, LOWERED),
    WayPoint("leave", 14.5, 0.0, 0.0),
    WayPoint("rest", 15.0, 0.0, 0.0),
)


class Sample(NamedTuple):
    """The cube at one time: time in [s], centre in [m] (3,), clearance of its lowest corner in [m]."""

    time_s: float
    centre: Array
    clearance: float


@dataclass(frozen=True)
class GraspResult:
    """Measurements of a grasp.

    Attributes:
        lift: Smallest clearance between cube and floor during the hold in [m].
        slip: Largest motion of the cube's centre during the hold in [m].
        hold_time: Measured duration of the hold in [s].
        returned: Clearance at the end in [m].
        tension: Largest tension of a cable in [N].
    """

    lift: float
    slip: float
    hold_time: float
    returned: float
    tension: float

    @property
    def passed(self) -> bool:
        """Whether the cube was lifted, held and put down as required."""
        return bool(
            self.lift >= NEEDED_LIFT
            and self.slip <= ALLOWED_SLIP
            and self.hold_time >= NEEDED_HOLD_S
            and self.returned < NEEDED_LIFT / 10.0
        )


class Grasp(Show):
    """Lifts a cube with the cable gripper, holds it and puts it down."""

    robot = "cable_gripper"
    duration_s = PLAN[-1].time_s

    def __init__(self, node: Node, client: RobotClient) -> None:
        super().__init__(node, client)
        self.samples: list[Sample] = []
        self.tension = 0.0
        self._cables = [name.endswith("_cable") for name in client.robot.joint_names]
        client.watch(self._on_change)

    @property
    def phase(self) -> str:
        """Present phase of the gripper."""
        return next((point.phase for point in PLAN if self.elapsed < point.time_s), "done")

    def _way_points(self) -> WayPoints:
        names = self._client.robot.joint_names
        return [(point.time_s, {name: _target(name, point) for name in names}) for point in PLAN]

    def result(self) -> GraspResult:
        """Return the measurements up to now."""
        began = self.began or 0.0
        lifted, hold_time = (
            next(point.time_s for point in PLAN if point.phase == phase) for phase in ("lift", "hold")
        )
        hold = [each for each in self.samples if lifted + SETTLE_S <= each.time_s - began <= hold_time]
        if not hold:
            return GraspResult(0.0, np.inf, 0.0, np.inf, self.tension)
        return GraspResult(
            lift=min(each.clearance for each in hold),
            slip=max(float(np.linalg.norm(each.centre - hold[0].centre)) for each in hold),
            hold_time=hold[-1].time_s - hold[0].time_s,
            returned=self.samples[-1].clearance,
            tension=self.tension,
        )

    def report_results(self) -> tuple[list[str], bool]:
        """Return the measurements as messages, and whether they meet the requirements."""
        result = self.result()
        return [
            f"lifted {1e3 * result.lift:.1f} mm clear of the floor (at least {1e3 * NEEDED_LIFT:.0f})",
            f"held {result.hold_time:.1f} s, slipped {1e3 * result.slip:.3f} mm (at most "
            f"{1e3 * ALLOWED_SLIP:.0f}), largest tension {result.tension:.2f} N",
            f"put down, {1e3 * result.returned:.2f} mm above the floor",
        ], result.passed

    def _observe(self, bodies: Mapping[str, ShownBody]) -> None:
        if CUBE in bodies and FLOOR in bodies:
            cube, floor = bodies[CUBE], bodies[FLOOR]
            clearance = float(cube.corners[:, 2].min() - floor.corners[:, 2].max())
            self.samples.append(Sample(self._now, cube.position, clearance))

    def _on_change(self, state: RobotState) -> None:
        pulls = (effort for effort, is_cable in zip(state.efforts, self._cables, strict=False) if is_cable)
        self.tension = max(self.tension, *pulls, 0.0)


def _target(joint: str, point: WayPoint) -> float:
    if joint.endswith("_cable"):
        return point.pull
    return point.height if joint == "vertical" else 0.0
