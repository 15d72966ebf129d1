"""A sensor's driver: what a camera says of a marker on the effector, as a topic that softsim excite records.

    python examples/marker_camera.py [ROBOT [NOISE_MM]]

No camera is needed: it looks at the simulated robot and adds noise. In a driver of your own `on_pose` is
where a picture has come in; the message, its stamp and its frame are the same.
"""

from __future__ import annotations

import sys

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from softsim_node import ros_process, serve_callbacks


class MarkerCamera(Node):
    """Publishes `marker` in the namespace of the robot."""

    def __init__(self, robot: str, noise_mm: float) -> None:
        super().__init__("marker_camera", namespace=robot)
        self.noise, self.random = 1e-3 * noise_mm, np.random.default_rng(0)
        self.marker = self.create_publisher(PoseStamped, "marker", 10)
        self.create_subscription(PoseStamped, "effector_pose", self.on_pose, 10)

    def on_pose(self, seen: PoseStamped) -> None:
        """A picture was taken: say where the marker was, in [m], and when."""
        told = PoseStamped()
        told.header.stamp = seen.header.stamp  # of the exposure, not of the moment the picture was understood
        told.header.frame_id = "world"  # the robot's; any other name has softsim fit where the camera stands
        noise = self.noise * self.random.standard_normal(3)
        told.pose.position.x = seen.pose.position.x + noise[0]
        told.pose.position.y = seen.pose.position.y + noise[1]
        told.pose.position.z = seen.pose.position.z + noise[2]
        self.marker.publish(told)


def main(robot: str, noise_mm: float) -> None:
    """Look until Ctrl-C."""
    with ros_process():
        serve_callbacks(MarkerCamera(robot, noise_mm))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "tripod", float(sys.argv[2]) if len(sys.argv) > 2 else 0.2)
