"""A maze plan and the closed loop on a simulated Tripod under inverse control, each node a process."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import BUILD_S

pytest.importorskip("rclpy")
pytest.importorskip("daqp")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

from geometry_msgs.msg import PoseStamped, Vector3Stamped  # noqa: E402
from rcl_interfaces.srv import SetParametersAtomically  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

from softsim_core.control.inverse import (  # noqa: E402
    TiltController,
    read_closed_loop_log,
    tilts_of,
)
from softsim_core.physics.mechanics import rotation_of  # noqa: E402

PAIRS = [[-0.3, 0.3], [-0.3, -0.3], [0.3, -0.3], [0.2, 0.1]]


class Plate:
    """The Tripod's effector, seen through its topics."""

    def __init__(self, tripod: Any, spin_until: Callable[..., bool]) -> None:
        self.client, self.spin_until = tripod.client, spin_until
        self.poses: list[PoseStamped] = self.client.collect(PoseStamped, "effector_pose", 1)
        self.states: list[JointState] = self.client.collect(JointState, "joint_states", 1)
        self.tripod = tripod

    @property
    def tilts(self) -> np.ndarray:
        return tilts_in(self.poses[-1])

    def stays_at(self, tilts: list[float]) -> bool:
        """Whether it has been there for a second of the simulation."""
        return len(self.poses) > 100 and all(
            np.abs(tilts_in(each) - tilts).max() < 2e-3 for each in self.poses[-100:]
        )

    def start_pose(self) -> None:
        assert self.tripod.trigger("start")[0]
        assert self.spin_until(lambda: self.states and self.states[-1].position[0] < -1.49)
        assert self.spin_until(lambda: self.poses and np.abs(self.states[-1].velocity).max() < 1e-6)

    def switch(self, service: str, on: bool) -> tuple[bool, str]:
        answer = self.client.call(SetBool, service, SetBool.Request(data=on))
        return answer.success, answer.message


def set_task(plate: Plate, task: str) -> None:
    request = SetParametersAtomically.Request(parameters=[Parameter("task", value=task).to_parameter_msg()])
    service = "inverse_controller/set_parameters_atomically"
    assert plate.client.call(SetParametersAtomically, service, request).result.successful


def tilts_in(message: PoseStamped) -> np.ndarray:
    turn = message.pose.orientation
    return np.array(tilts_of(rotation_of(np.array([turn.x, turn.y, turn.z, turn.w])))[:2])


@pytest.fixture(scope="module")
def controller(start_process: Callable[..., Any], running_tripod: Any) -> Any:
    process = start_process("softsim_ros.nodes.inverse.inverse_node")
    assert process.says("ready to control", BUILD_S), process.output
    return process


@pytest.fixture
def plate(controller: Any, tripod: Any, spin_until: Callable[..., bool]) -> Iterator[Plate]:
    each = Plate(tripod, spin_until)
    each.start_pose()
    assert spin_until(lambda: each.switch("inverse_controller/enable", True)[0])  # it has heard of the joints
    assert each.switch("inverse_controller/enable", False)[0]
    yield each
    assert each.switch("inverse_controller/enable", False)[0]


@pytest.fixture
def start_node(plate: Plate, start_process: Callable[..., Any]) -> Iterator[Callable[..., Any]]:
    """Starts a module beside the controller; a test that fails leaves none to the next one."""
    processes: list[Any] = []

    def start(*arguments: str) -> Any:
        processes.append(start_process(*arguments))
        return processes[-1]

    yield start
    for each in processes:
        if each.process.poll() is None:
            each.end()


@pytest.fixture
def imu(plate: Plate) -> Iterator[None]:
    """A sensor on the plate."""
    node = plate.client.node
    publisher = node.create_publisher(Imu, "imu", 1)

    def measure(message: PoseStamped) -> None:
        publisher.publish(Imu(header=message.header, orientation=message.pose.orientation))

    subscription = node.create_subscription(PoseStamped, "effector_pose", measure, 1)
    yield
    node.destroy_subscription(subscription)
    node.destroy_publisher(publisher)


def test_the_plate_follows_a_maze_plan(plate: Plate, start_node: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    file.write_text(json.dumps({"anglePlanningTable": PAIRS}))
    follower = start_node("softsim_ros.nodes.inverse.path_follower_node", "--ros-args", "-p", f"file:={file}")
    assert follower.says("call path_follower/start"), follower.output
    progress = plate.client.collect(Float64, "path_follower/progress")
    assert plate.client.call(Trigger, "path_follower/start").success
    assert plate.spin_until(lambda: progress and progress[-1].data == 100.0), follower.output
    assert plate.spin_until(lambda: np.abs(plate.tilts - [0.1, 0.2]).max() < 2e-3), plate.tilts
    assert plate.spin_until(lambda: abs(plate.poses[-1].pose.position.z - 0.05) < 2e-4)
    assert follower.end() == 0


@pytest.mark.parametrize("measure", ["effector_pose", "imu"])
def test_the_loop_closes_on_the_robot(
    plate: Plate, imu: None, start_node: Callable[..., Any], tmp_path: Path, measure: str
) -> None:
    file = tmp_path / "log.csv"
    loop = start_node(
        "softsim_ros.nodes.inverse.closed_loop_node",
        *("--ros-args", "-p", f"measure:={measure}", "-p", f"log_file:={file}"),
    )
    assert loop.says(f"measures tilts on {measure}"), loop.output
    set_task(plate, "position")  # the loop sets what it needs
    assert plate.switch("inverse_controller/enable", True)[0]
    assert plate.switch("closed_loop/enable", True)[0]
    reference = Vector3Stamped()
    reference.header.frame_id = "world"
    reference.vector.x, reference.vector.y = 0.15, -0.1
    plate.client.publish("tilt_reference", reference)
    assert plate.spin_until(lambda: plate.stays_at([0.15, -0.1])), plate.tilts
    assert plate.switch("closed_loop/enable", False)[0]
    assert loop.end() == 0
    record = read_closed_loop_log(file)
    assert len(record.time) > 10
    rows = zip(record.reference, record.measure, record.elapsed, strict=True)
    controller = TiltController()
    assert np.array_equal([controller.update(*row) for row in rows], record.command)
