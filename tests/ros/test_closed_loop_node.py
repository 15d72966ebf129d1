"""The closed loop over its topics: it closes around a plate, survives a broken sensor, and logs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import PoseStamped, Vector3Stamped  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402

from softsim_core.base import ConfigError  # noqa: E402
from softsim_core.control.inverse import (  # noqa: E402
    TiltController,
    read_closed_loop_log,
    tilt_rotation,
    tilts_of,
)
from softsim_core.physics.mechanics import quaternion_of, rotation_of  # noqa: E402
from softsim_core.scene import load_scene  # noqa: E402
from softsim_node import STATE_QOS  # noqa: E402
from softsim_ros import SpinThread, StateListener  # noqa: E402
from softsim_ros.keys import KeyPress  # noqa: E402
from softsim_ros.messages import pose_stamped, time_message  # noqa: E402
from softsim_ros.nodes.inverse import ClosedLoop  # noqa: E402
from softsim_ros.nodes.teleop import Teleop  # noqa: E402


class Plate:
    """A plate with an IMU that follows goals late, too weakly and askew: answers each goal with a measure."""

    def __init__(self, client: Any, publish_imu: bool) -> None:
        self.tilts, self.goals, self._imu = np.zeros(2), [], publish_imu
        self._seen: list[Any] = []
        kind, topic = (Imu, "imu") if publish_imu else (PoseStamped, "effector_pose")
        self._publisher = client.node.create_publisher(kind, topic, 1)
        self.broken = False
        self._subscription = client.node.create_subscription(PoseStamped, "effector_goal", self._on_goal, 1)
        self._node = client.node

    def _on_goal(self, message: PoseStamped) -> None:
        self.goals.append(message)
        turn = message.pose.orientation
        goal = tilts_of(rotation_of(np.array([turn.x, turn.y, turn.z, turn.w])))
        self.tilts = self.tilts + 0.2 * (0.8 * np.array(goal[:2]) + [0.05, -0.03] - self.tilts)
        self._seen.append(self.tilts)
        self.measure()

    def rests_at(self, tilts: list[float]) -> bool:
        """Whether it has been there for a hundred goals."""
        return len(self._seen) > 100 and np.abs(np.array(self._seen[-100:]) - tilts).max() < 1e-3

    def measure(self) -> None:
        quaternion = quaternion_of(tilt_rotation(*self.tilts)) * (math.nan if self.broken else 1.0)
        pose = pose_stamped(time_message(0.0), "world", (0.0, 0.0, 0.05), quaternion)
        self._publisher.publish(Imu(orientation=pose.pose.orientation) if self._imu else pose)

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_publisher(self._publisher)


@pytest.fixture
def start_loop(ros_domain: int, client: Any) -> Iterator[Callable[..., tuple[ClosedLoop, Plate]]]:
    context = Context()
    context.init(args=[], domain_id=ros_domain)
    opened: list[tuple[ClosedLoop, SpinThread, Plate]] = []

    def start(**parameters: Any) -> tuple[ClosedLoop, Plate]:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        loop = ClosedLoop("tripod", context=context, parameter_overrides=overrides)
        thread = SpinThread([loop], context)
        thread.__enter__()
        plate = Plate(client, parameters.get("measure", "imu") == "imu")
        opened.append((loop, thread, plate))
        return loop, plate

    yield start
    for loop, thread, plate in opened:
        thread.close()
        loop.close()
        plate.close()
    context.try_shutdown()


def enable(client: Any, on: bool) -> str:
    answer = client.call(SetBool, "closed_loop/enable", SetBool.Request(data=on))
    assert answer.success
    return str(answer.message)


def refer(client: Any, x: float, y: float) -> None:
    message = Vector3Stamped()
    message.header.frame_id = "world"
    message.vector.x, message.vector.y = x, y
    client.publish("tilt_reference", message)


def keep_measuring(plate: Plate, spin_until: Any, until: Callable[[], Any]) -> bool:
    def measure_and_look() -> Any:
        plate.measure()
        return until()

    return bool(spin_until(measure_and_look))


@pytest.mark.slow
@pytest.mark.parametrize("measure", ["imu", "effector_pose"])
def test_it_closes_around_a_plate(
    start_loop: Any, client: Any, spin_until: Any, tmp_path: Path, measure: str
) -> None:
    file = tmp_path / "log.csv"
    loop, plate = start_loop(log_file=str(file), measure=measure, rate=200.0)
    assert enable(client, True) == f"waiting for {measure}"
    refer(client, 0.2, -0.1)
    assert keep_measuring(plate, spin_until, lambda: plate.goals)
    assert spin_until(lambda: plate.rests_at([0.2, -0.1])), plate.tilts
    assert plate.goals[-1].pose.position.z == pytest.approx(0.05)
    assert enable(client, False) == "off: no goals are given"
    loop._log.flush()
    record = read_closed_loop_log(file)
    assert len(record.time) > 100
    assert record.measure[-1] == pytest.approx([-0.1, 0.2], abs=2e-3)  # its x axis is our y, its z our x
    controller = TiltController()
    rows = zip(record.reference, record.measure, record.elapsed, strict=True)
    assert np.array_equal([controller.update(*row) for row in rows], record.command)


@pytest.mark.slow
def test_a_broken_sensor_holds_the_command(start_loop: Any, client: Any, spin_until: Any) -> None:
    loop, plate = start_loop(measure_timeout=0.1, enabled=True)
    refer(client, 0.1, 0.0)
    assert keep_measuring(plate, spin_until, lambda: plate.goals)
    assert spin_until(lambda: abs(plate.tilts[0] - 0.1) < 1e-2)
    plate.broken = True
    assert spin_until(lambda: loop._said.startswith("imu is not used, the old measure is kept"))
    assert spin_until(lambda: loop._step.holds)
    assert loop._said.startswith(("imu is not used, the old measure is kept", "holding: nothing"))
    held = loop._step.command.tolist()
    count = len(plate.goals)
    assert spin_until(lambda: len(plate.goals) > count + 20)
    assert loop._step.command.tolist() == held
    plate.broken = False
    assert keep_measuring(plate, spin_until, lambda: not loop._step.holds and loop._said == "")


def loop_reference(loop: ClosedLoop) -> Any:
    return pytest.approx(tuple(loop._loop.reference))


@pytest.mark.slow
def test_references_that_are_refused(start_loop: Any, client: Any, spin_until: Any) -> None:
    loop, plate = start_loop(enabled=True)
    refer(client, 0.1, 0.05)
    assert spin_until(lambda: loop._loop.reference.tolist() == [0.1, 0.05])
    refer(client, math.nan, 0.0)
    moon = pose_stamped(time_message(0.0), "moon", (0.0, 0.0, 0.06), (0.0, 0.0, 0.0, 1.0))
    client.publish("effector_reference", moon)
    good = pose_stamped(time_message(0.0), "world", (0.0, 0.0, 0.06), quaternion_of(tilt_rotation(0.2, 0.1)))
    assert loop._loop.reference.tolist() == [0.1, 0.05]
    client.publish("effector_reference", good)
    assert spin_until(lambda: loop._loop.reference == pytest.approx([0.2, 0.1]))
    told = {name: StateListener(client.node, f"closed_loop/{name}") for name in ("enabled", "reference")}
    assert spin_until(lambda: told["enabled"].value is True and told["reference"].value is not None)
    assert spin_until(lambda: (told["reference"].value.x, told["reference"].value.y) == loop_reference(loop))
    assert keep_measuring(plate, spin_until, lambda: plate.goals)
    assert plate.goals[-1].pose.position.z == pytest.approx(0.06)


@pytest.mark.slow
def test_keys_of_the_teleop_turn_the_reference(
    start_loop: Any, ros_domain: int, client: Any, spin_until: Any
) -> None:
    loop, _ = start_loop(enabled=True)
    refer(client, 0.05, 0.0)
    assert spin_until(lambda: loop._loop.reference.tolist() == [0.05, 0.0])
    context = Context()
    context.init(args=[], domain_id=ros_domain)
    teleop = Teleop(load_scene("tripod"), context=context)
    try:
        with SpinThread([teleop], context):
            enabled = client.node.create_publisher(Bool, "inverse_controller/enabled", STATE_QOS)
            enabled.publish(Bool(data=True))
            assert spin_until(lambda: teleop.client.state.inverse and teleop.client.state.tilt is not None)
            assert spin_until(lambda: loop.count_publishers("tilt_reference") > 1)  # client and teleop
            for name in ("up", "plus"):
                teleop.keyboard.press(KeyPress(name), time.monotonic())
            assert spin_until(lambda: loop._loop.reference[1] == 0.1)
            client.node.destroy_publisher(enabled)
            assert spin_until(lambda: not teleop.client.state.inverse)
    finally:
        teleop.close()
        context.try_shutdown()


def test_gains_change_while_it_runs(start_loop: Any) -> None:
    loop, _ = start_loop()
    assert loop.set_parameters([Parameter("kp", value=0.0), Parameter("saturation", value=0.3)])[0].successful
    assert loop.set_parameters_atomically([Parameter("ki", value=1.0)]).successful
    gains = loop._loop.controller.gains
    assert (gains.integral, gains.saturation) == (1.0, 0.3)
    refused = loop.set_parameters([Parameter("rate", value=10.0)])[0]
    assert not refused.successful
    assert "read-only" in refused.reason


def test_a_log_in_no_folder(start_loop: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written: No such file or directory; name another file"):
        start_loop(log_file=str(tmp_path / "nowhere" / "log.csv"))
