"""The observer over its topics: nearer to the robot than its model, and not led astray by bad messages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402

from softsim_core import Simulation, load_scene  # noqa: E402
from softsim_core.base import ConfigError  # noqa: E402
from softsim_core.control.inverse import place  # noqa: E402
from softsim_node import LATCHED  # noqa: E402
from softsim_ros import SpinThread, StateListener  # noqa: E402
from softsim_ros.messages import (  # noqa: E402
    joint_state,
    pose_stamped,
    read_point_cloud,
    time_message,
)
from softsim_ros.nodes.observer import ObserverNode  # noqa: E402

JOINTS, ZEROS, SHIFT, NOISE_M = np.array([-1.2, -1.3, -1.1]), np.array([0.04, -0.03, 0.02]), 0.035, 5e-5


class Bench:
    """A Tripod whose servos do not stand where they say, at rest, and a camera that sees its effector."""

    def __init__(self, client: Any) -> None:
        self.robot = Simulation(load_scene("tripod").robot_alone())
        self.robot.enforce_limits = False
        place(self.robot, JOINTS + ZEROS, SHIFT)
        self._region = next(each for each in self.robot.model.regions if each.name == "centre").nodes
        self._rng = np.random.default_rng(5)
        make, stamp = client.node.create_publisher, time_message(0.0)
        self._joints = make(JointState, "applied_joint_states", 10)
        self.camera, self.markers = make(PoseStamped, "effector_pose", 5), make(PoseArray, "markers", 5)
        make(Float64, "base_shift", LATCHED).publish(Float64(data=SHIFT))
        names = self.robot.joint_names
        self._told = joint_state(stamp, "tripod/base_link", names, JOINTS, np.zeros(3), np.zeros(3))
        self.seen: list[Any] = []
        client.node.create_subscription(PoseStamped, "observer/effector_pose", self.seen.append, 5)
        self.wrenches: list[Any] = []
        client.node.create_subscription(WrenchStamped, "observer/contact_wrench", self.wrenches.append, 5)
        self.meshes: list[Any] = []
        client.node.create_subscription(PointCloud2, "observer/mesh/points", self.meshes.append, 1)
        self._next = 0.0
        self.sees = True

    def push(self, force: list[float]) -> None:
        self.robot.forces = np.zeros_like(self.robot.forces)
        self.robot.forces[self._region] = np.array(force) / len(self._region)

    def live(self) -> None:
        """Step, and send what is due."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + 0.01
        self.robot.step()
        self._joints.publish(self._told)
        if self.sees:
            self.camera.publish(self.photo())

    def photo(self, frame: str = "world", off: float = 0.0) -> Any:
        pose = self.robot.effector_pose
        assert pose is not None
        place = pose.position + off + NOISE_M * self._rng.standard_normal(3)
        return pose_stamped(time_message(0.0), frame, place, pose.quaternion_xyzw)

    def error(self) -> float:
        """How far the newest observed effector is from the robot's, in [m]."""
        if not self.seen:
            return math.inf
        at, pose = self.seen[-1].pose.position, self.robot.effector_pose
        assert pose is not None
        return float(np.linalg.norm(np.array([at.x, at.y, at.z]) - pose.position))


@pytest.fixture
def observing(ros_domain: int, client: Any) -> Iterator[Callable[..., tuple[ObserverNode, Bench]]]:
    context = Context()
    context.init(args=[], domain_id=ros_domain)
    opened: list[tuple[ObserverNode, SpinThread]] = []

    def start(**parameters: Any) -> tuple[ObserverNode, Bench]:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        node = ObserverNode("tripod", context=context, parameter_overrides=overrides)
        thread = SpinThread([node], context)
        thread.__enter__()
        opened.append((node, thread))
        return node, Bench(client)

    yield start
    for node, thread in opened:
        thread.close()
        node.close()
    context.try_shutdown()


def until(bench: Bench, spin_until: Any, reached: Callable[[], Any]) -> bool:
    def live_and_look() -> Any:
        bench.live()
        return reached()

    return bool(spin_until(live_and_look))


@pytest.mark.slow
def test_it_sees_the_shape_the_contact_and_what_is_no_measurement(
    observing: Any, client: Any, spin_until: Any
) -> None:
    node, bench = observing(position_noise=NOISE_M, sensor_offset=0.0, latency=0.0)
    verdict, touched = (StateListener(client.node, f"observer/{name}") for name in ("verdict", "touched"))
    alone = Simulation(load_scene("tripod").robot_alone())
    place(alone, JOINTS, SHIFT)
    assert node.get_name() == "observer"
    off = np.linalg.norm(alone.effector_pose.position - bench.robot.effector_pose.position)
    assert off > 3e-4
    assert until(bench, spin_until, lambda: verdict.value == "good")
    assert until(bench, spin_until, lambda: bench.error() < off / 10.0)
    assert until(bench, spin_until, lambda: bench.meshes)
    shown = read_point_cloud(bench.meshes[-1])[:, :3]
    error, before = (
        float(np.sqrt(((shape - bench.robot.visual_points()) ** 2).sum(axis=1).mean()))
        for shape in (shown, alone.visual_points())
    )
    assert error < before / 3.0

    bench.camera.publish(bench.photo(frame="camera", off=0.05))  # these change nothing
    bench.camera.publish(bench.photo(off=math.nan))
    bench.camera.publish(bench.photo(off=0.05))
    assert touched.value is False

    bench.push([0.0, 0.0, -0.5])
    assert until(bench, spin_until, lambda: touched.value is True)
    assert until(
        bench, spin_until, lambda: bench.wrenches and abs(bench.wrenches[-1].wrench.force.z + 0.5) < 0.15
    )
    bench.push([0.0, 0.0, 0.0])
    assert until(bench, spin_until, lambda: touched.value is False)

    bench.sees = False
    assert until(bench, spin_until, lambda: verdict.value == "alone")


@pytest.mark.parametrize("text", ["0.01 0.02", "a b c", "nan 0 0"])
def test_places_of_markers_that_are_none_are_refused(observing: Any, text: str) -> None:
    with pytest.raises(ConfigError, match="three numbers in m"):
        observing(marker_places=text)
