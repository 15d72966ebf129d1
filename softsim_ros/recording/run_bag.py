"""A bag of one run in this process, without nodes: the topics of a recorder, at simulated times."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softsim_core.base import make_folder
from softsim_core.simulation import Simulation

PERIOD_S = 1.0 / 30.0
"""Period in [s] of frames of the moving mesh; joints and effector are written after every step."""


@dataclass(frozen=True, slots=True)
class RunBags:
    """Creates the bag of a run by its number.

    Attributes:
        folder: Folder of the bags, run_000007 and so on; an existing one is replaced.
    """

    folder: Path

    def __call__(self, work: Any, number: int) -> tuple[Callable[[Simulation], None], Callable[[], None]]:
        """Return a function to call after each step, and one that closes the bag."""
        bag = _RunBag(self.folder / f"run_{number:06d}")
        return bag.write_state, bag.close


class _RunBag:
    def __init__(self, folder: Path) -> None:
        self._folder, self._next = folder, 0.0
        self._writer: Any = None
        make_folder(folder.parent)
        shutil.rmtree(folder, ignore_errors=True)

    def write_state(self, simulation: Simulation) -> None:
        """Write the present state; the first call opens the bag and writes the static part, too."""
        from softsim_node import WORLD
        from softsim_ros import messages

        if self._writer is None:
            self._open(simulation)
        stamp, at = messages.time_message(simulation.time), 1 + round(1e9 * simulation.time)
        motion = simulation.joint_positions, simulation.joint_velocities, simulation.joint_efforts
        joint_message = messages.joint_state(stamp, WORLD, simulation.joint_names, *motion)
        self._write("joint_states", "sensor_msgs/msg/JointState", at, joint_message)
        if (pose := simulation.effector_pose) is not None:
            message = messages.pose_stamped(stamp, WORLD, pose.position, pose.quaternion_xyzw)
            self._write("effector_pose", "geometry_msgs/msg/PoseStamped", at, message)
        if simulation.time >= self._next - 1e-9:
            self._next = simulation.time + PERIOD_S
            points, stress = simulation.visual_points(), simulation.visual_values(simulation.von_mises())
            cloud = messages.point_cloud(stamp, WORLD, points, stress)
            self._write("mesh/points", "sensor_msgs/msg/PointCloud2", at, cloud)

    def _open(self, simulation: Simulation) -> None:
        from softsim_ros import messages
        from softsim_ros.recording.bag_writer import BagWriter

        self._namespace = f"/{simulation.robot.name}"
        self._writer = BagWriter(self._folder, {"robot": simulation.robot.name, "namespace": self._namespace})
        mesh = messages.topology(simulation.visual_rest_points, simulation.visual_triangles)
        self._write("mesh/topology", "shape_msgs/msg/Mesh", 1, mesh)

    def _write(self, topic: str, type_name: str, at: int, message: Any) -> None:
        from rclpy.serialization import serialize_message

        full = f"{self._namespace}/{topic}"
        self._writer.add_topic(full, type_name)
        self._writer.write(full, at, serialize_message(message))

    def close(self) -> None:
        """Close the bag."""
        if self._writer is not None:
            self._writer.close()
