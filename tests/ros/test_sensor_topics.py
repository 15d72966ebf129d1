"""Sensors on their topics: types, values, frames and rates; contacts as points that programs can use."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros]

from geometry_msgs.msg import PoseArray, WrenchStamped  # noqa: E402
from sensor_msgs.msg import FluidPressure, Image, Imu, JointState, PointCloud2  # noqa: E402
from std_msgs.msg import Float64, String  # noqa: E402

from softsim_core import load_scene  # noqa: E402
from softsim_node import LATCHED  # noqa: E402
from softsim_ros.messages import (  # noqa: E402
    read_contact_cloud,
)

SENSORS = {
    "skin": "sensor_msgs/msg/Image",
    "press": "geometry_msgs/msg/WrenchStamped",
    "bend": "std_msgs/msg/Float64",
    "tip_imu": "sensor_msgs/msg/Imu",
    "dots": "geometry_msgs/msg/PoseArray",
    "tendon": "sensor_msgs/msg/JointState",
}
AREA = 0.015 * 0.015
"""Of the tactile array in [m^2]."""


@pytest.fixture(scope="module")
def finger(start_robot: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The finger in the namespace of the tests' client, without noise but for the IMU's, seen by a camera."""
    file = tmp_path_factory.mktemp("scene") / "finger.yaml"
    file.write_text(
        f"extends: {load_scene('sensed_finger').source}\nname: tripod\nsensors:\n"
        "- {name: skin, noise: 0.0}\n- {name: press, force_noise: 0.0, moment_noise: 0.0}\n"
        "- {name: dots, dropout: 0.4}\n- {name: tendon, length_noise: 0.0, tension_noise: 0.0}\n"
    )
    return start_robot(robot=str(file), publish_clock=True, speed=0.5)


def offered(robot: Any) -> dict[str, list[str]]:
    """Types of what the simulator publishes below `sensors/`, by name."""
    found = robot.client.offered("simulator", "/tripod").items()
    return {topic.removeprefix("/tripod/sensors/"): types for topic, types in found if "/sensors/" in topic}


def seconds(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


@pytest.mark.slow
def test_every_kind_has_its_standard_message(finger: Any, spin_until: Any) -> None:
    collect = finger.client.collect
    skin, press = collect(Image, "sensors/skin"), collect(WrenchStamped, "sensors/press")
    imu, tendon = collect(Imu, "sensors/tip_imu"), collect(JointState, "sensors/tendon")
    dots, bend = collect(PoseArray, "sensors/dots"), collect(Float64, "sensors/bend")
    states, points = collect(JointState, "joint_states"), collect(PointCloud2, "contacts/points")
    structure, pulled = collect(String, "scene/structure", LATCHED), collect(PointCloud2, "cables/tensions")
    assert spin_until(lambda: offered(finger) == {name: [kind] for name, kind in SENSORS.items()})
    finger.command([0.010])
    assert spin_until(lambda: press and press[-1].wrench.force.z < -0.2)
    for messages in (skin, press, imu, tendon, dots, bend, points):
        messages.clear()
    assert spin_until(lambda: min(map(len, (skin, press, imu, tendon, dots, bend, points))) > 16)

    assert (skin[0].height, skin[0].width, skin[0].encoding, skin[0].step) == (5, 5, "32FC1", 20)
    skins, forces = ({seconds(each): each for each in messages} for messages in (skin, press))
    newest = max(skins.keys() & forces.keys())  # a message may be lost
    pressures = np.frombuffer(skins[newest].data, dtype="<f4")
    assert pressures.min() >= 0.0
    force = forces[newest].wrench.force
    assert 0.5 < pressures.mean() * AREA / abs(force.z) < 1.05  # the rest presses beside the array
    assert press[0].header.frame_id == "tripod/effector"
    assert imu[0].header.frame_id == "tripod/tip_imu"
    assert (imu[0].orientation_covariance[0], imu[0].angular_velocity_covariance[4]) == (-1.0, 0.005**2)
    gravity = imu[-1].linear_acceleration
    assert np.linalg.norm([gravity.x, gravity.y, gravity.z]) == pytest.approx(9.81, abs=0.5)
    assert tendon[-1].name == ["cable"]
    moments = {seconds(each): each for each in states}, {seconds(each): each for each in tendon}
    common = moments[0].keys() & moments[1].keys()
    assert common
    for moment in common:
        joints, cable = (each[moment] for each in moments)
        assert cable.effort[0] == pytest.approx(joints.effort[0], rel=1e-12)
    efforts = {seconds(each): each.effort[0] for each in states}
    clouds = [each for each in pulled if seconds(each) in efforts]
    assert clouds
    for each in clouds:  # a cable without friction has one tension
        rows = np.frombuffer(each.data, dtype=[("place", "<f4", 3), ("tension", "<f4"), ("joint", "<i4")])
        np.testing.assert_allclose(rows["tension"], efforts[seconds(each)], rtol=1e-5)
        assert len(rows) > 1
        assert not rows["joint"].any()
    assert 1e-4 < bend[-1].data < 0.02
    assert dots[0].header.frame_id == "world"
    seen = np.array([[pose.position.y for pose in each.poses] for each in dots])
    assert seen.shape[1] == 3
    assert 0.0 < np.isnan(seen).mean() < 1.0
    assert np.nanmedian(seen[:, 0]) == pytest.approx(-0.025, abs=2e-3)

    contacts = read_contact_cloud(points[-1])
    names = json.loads(structure[-1].data)["body_names"]
    assert {names[number] for number in contacts["body_a"]} == {"finger"}
    assert {names[number] for number in contacts["body_b"]} == {"knob"}
    np.testing.assert_allclose(
        np.linalg.norm([contacts[f"normal_{axis}"] for axis in "xyz"], axis=0), 1.0, rtol=1e-5
    )
    total = np.linalg.norm([contacts[f"force_{axis}"].sum() for axis in "xyz"])
    assert total == pytest.approx(np.linalg.norm([force.x, force.y, force.z]), rel=0.05)


@pytest.mark.slow
def test_rates_are_held_in_simulated_time(finger: Any, spin_until: Any) -> None:
    topics = {"skin": (Image, 0.02), "dots": (PoseArray, 0.04), "press": (WrenchStamped, 0.01)}
    told = {name: finger.client.collect(kind, f"sensors/{name}") for name, (kind, _) in topics.items()}
    assert spin_until(lambda: min(map(len, told.values())) > 15)
    for name, (_, period) in topics.items():
        periods = np.diff([seconds(each) for each in told[name]]) / period
        np.testing.assert_allclose(periods, np.rint(periods), atol=1e-6)
        assert periods.min() == pytest.approx(1.0)  # more where a message was lost


@pytest.mark.slow
def test_another_scene_brings_its_own_sensors(finger: Any, spin_until: Any) -> None:
    assert finger.set_parameters(overrides="sensors: [{name: bend, noise: 0.0}]") == (True, "")
    assert spin_until(lambda: offered(finger).keys() == SENSORS.keys())
    assert finger.set_parameters(robot="inflated_cube") == (True, "")
    assert spin_until(lambda: offered(finger) == {})
    sensor = "sensors: [{name: hollow 1, kind: chamber, joint: air, pressure_noise: 3.0}]"
    assert finger.set_parameters(overrides=sensor) == (True, "")
    kinds = {"hollow_1": ["sensor_msgs/msg/FluidPressure"], "hollow_1/volume": ["std_msgs/msg/Float64"]}
    assert spin_until(lambda: offered(finger) == kinds)
    pressures = finger.client.collect(FluidPressure, "sensors/hollow_1")
    volumes = finger.client.collect(Float64, "sensors/hollow_1/volume")
    assert spin_until(lambda: len(pressures) > 10 and volumes)
    assert np.mean([each.fluid_pressure for each in pressures]) == pytest.approx(101_325.0, abs=10.0)
    assert pressures[-1].variance == 9.0
    assert volumes[-1].data == pytest.approx(8e-6, rel=0.1)
