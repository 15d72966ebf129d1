"""The plan of `softsim demo pick_and_place`: where the gripper goes, and what its joints do for that.

It knows where the objects stand and where they shall stand; that they are heavier, or smoother, it does not.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.inverse.reach import reach
from softsim_core.scene.builder import build
from softsim_core.scene.robot import RobotDescription

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
