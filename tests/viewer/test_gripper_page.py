"""The cable gripper's page: its fingers, cables and bodies are drawn, and its sliders grasp the cube."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import BrowserPage
from geometry_msgs.msg import PoseArray
from node_processes import Client
from sensor_msgs.msg import JointState

pytestmark = [pytest.mark.ros, pytest.mark.slow]

FINGERS = ("finger_1", "finger_2", "finger_3")
LOWERED, LIFTED, CLOSED = -0.050, -0.020, 0.012
DEADLINE_S = 240.0
"""Contacts are slow on a busy machine."""


@pytest.fixture(scope="module")
def client(ros_domain: int) -> Iterator[Client]:
    """A node of the test in the gripper's namespace."""
    node = Client(ros_domain, "cable_gripper")
    yield node
    node.close()


@pytest.fixture(scope="module")
def page(start_station: Callable[..., tuple[Any, str]], browser: Any) -> Iterator[BrowserPage]:
    _, address = start_station("cable_gripper")
    page = BrowserPage(browser, address)
    for finger in FINGERS:
        page.wait_for_node(f"/bodies/{finger}")
    yield page
    page.close()


def test_fingers_cables_and_rigid_bodies_are_drawn(page: BrowserPage) -> None:
    for number in range(len(FINGERS)):
        page.wait_for_node(f"/cables/line_{number}")
    for body in ("floor", "cube"):
        page.wait_for_node(f"/rigid/{body}/surface")
    for joint in (*(f"{finger}_cable" for finger in FINGERS), "vertical", "sideways"):
        assert page.number(joint).is_visible()
    assert page.errors == []


def test_the_sliders_grasp_and_lift_the_cube(
    page: BrowserPage, client: Client, spin_until: Callable[..., bool]
) -> None:
    states = client.collect(JointState, "joint_states", 5)
    poses = client.collect(PoseArray, "bodies/poses", 5)
    assert spin_until(lambda: states and poses, DEADLINE_S)
    order = states[-1].name

    def at(joint: str, value: float) -> bool:
        """Whether a joint comes to a position in [m]."""
        index = order.index(joint)
        return spin_until(lambda: abs(states[-1].position[index] - value) < 1e-4, DEADLINE_S)

    rest = poses[-1].poses[1].position.z
    opened = page.vertices("/bodies/finger_1")
    page.set_number("vertical", LOWERED)
    assert at("vertical", LOWERED)
    for finger in FINGERS:
        page.set_number(f"{finger}_cable", CLOSED)
        assert at(f"{finger}_cable", CLOSED)
    tensions = [states[-1].effort[order.index(f"{finger}_cable")] for finger in FINGERS]
    assert min(tensions) > 0.1
    page.set_number("vertical", LIFTED)
    assert at("vertical", LIFTED)
    assert spin_until(lambda: poses[-1].poses[1].position.z > rest + 0.02, DEADLINE_S)
    closed = page.vertices("/bodies/finger_1")
    assert max(abs(a - b) for a, b in zip(opened, closed, strict=True)) > 10.0  # mm, on the screen, too
