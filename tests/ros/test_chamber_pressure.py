"""Pressures of chambers on their topics, beside the joint states."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros]

from rclpy.validate_topic_name import validate_topic_name  # noqa: E402
from sensor_msgs.msg import FluidPressure, JointState  # noqa: E402

from softsim_core import load_scene  # noqa: E402
from softsim_ros import chamber_topics  # noqa: E402

TOPIC = "/tripod/chambers/air/pressure"
TYPE = "sensor_msgs/msg/FluidPressure"
AIR_AROUND = 90_000.0
JOINT = f"""joints:
  - name: air
    kind: chamber
    limits: {{lower: -2.0e+3, upper: 1.0e+4, speed: 1.0e+4}}
    chamber: {{body: cube, control: pressure, atmosphere: {AIR_AROUND}}}
"""


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["air", "air_0"], ["air", "air_0"]),
        (["air 1", "air-1", "äir"], ["air_1", "air_1_", "chamber__ir"]),
        (["1", "_a", ""], ["chamber_1", "chamber__a", "chamber_"]),
        (["a" * 300, "a" * 301], ["a" * 60, "a" * 60 + "_"]),
    ],
)
def test_every_name_of_a_joint_gives_a_topic_of_its_own(names: list[str], words: list[str]) -> None:
    topics = chamber_topics(names)
    assert topics == [f"chambers/{word}/pressure" for word in words]
    assert all(validate_topic_name(topic) for topic in topics)


@pytest.fixture(scope="module")
def cube(start_robot: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The inflated cube in the namespace of the tests' client, on a mountain."""
    file = tmp_path_factory.mktemp("scene") / "cube.yaml"
    file.write_text(f"extends: {load_scene('inflated_cube').source}\nname: tripod\n{JOINT}")
    return start_robot(robot=str(file))


def offered(robot: Any) -> dict[str, list[str]]:
    """Types of what the simulator publishes about chambers, by topic."""
    found = robot.client.offered("simulator", "/tripod").items()
    return {topic: types for topic, types in found if "chambers/" in topic or TYPE in types}


def by_stamp(messages: list[Any]) -> dict[tuple[int, int], Any]:
    return {(each.header.stamp.sec, each.header.stamp.nanosec): each for each in messages}


@pytest.mark.slow
def test_the_pressure_is_the_effort_and_the_air_around(cube: Any, spin_until: Any) -> None:
    states = cube.client.collect(JointState, "joint_states")
    pressures = cube.client.collect(FluidPressure, TOPIC)
    assert spin_until(lambda: states and pressures)
    cube.command([5000.0])
    assert spin_until(lambda: states[-1].effort[0] == pytest.approx(5000.0))
    pressures.clear()
    assert spin_until(lambda: len(pressures) > 20)
    told = by_stamp(pressures)
    assert spin_until(lambda: told.keys() <= by_stamp(states).keys())  # one with every joint state
    for stamp, message in told.items():
        (effort,) = by_stamp(states)[stamp].effort
        assert message.fluid_pressure == AIR_AROUND + effort
        assert message.variance == 0.0
        assert message.header.frame_id == by_stamp(states)[stamp].header.frame_id == "tripod/base_link"
    assert spin_until(lambda: offered(cube) == {TOPIC: [TYPE]})


@pytest.mark.slow
def test_another_scene_brings_its_own_chambers(cube: Any, spin_until: Any) -> None:
    pressures = cube.client.collect(FluidPressure, TOPIC)
    assert spin_until(lambda: pressures)
    assert cube.set_parameters(robot="tripod") == (True, "")
    assert spin_until(lambda: offered(cube) == {})
    assert spin_until(lambda: cube.client.node.count_publishers(TOPIC) == 0)
    assert cube.set_parameters(robot="inflated_cube") == (True, "")
    assert spin_until(lambda: offered(cube) == {TOPIC: [TYPE]})
    pressures.clear()
    assert spin_until(lambda: pressures)
    assert cube.trigger("reload")[0]
    pressures.clear()
    assert spin_until(lambda: pressures)
    assert cube.client.node.count_publishers(TOPIC) == 1
