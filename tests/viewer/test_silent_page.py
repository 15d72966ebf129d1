"""A page that nobody uses commands nothing, whatever the robot does and however its controls follow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import BrowserPage
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.msg import ParameterEvent
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool

pytestmark = [pytest.mark.ros, pytest.mark.slow]

BODY = "/bodies/silicone"
TABS = ("Drive", "View", "Tune", "Plots", "Timing", "Log", "Scene")
SETTLE_MS = 1500
"""Longer than a control that was touched waits before it follows, and than a poll of the parameters."""


class Witness:
    """Two browsers at one robot, and everything that a page could command."""

    def __init__(self, robot: Any, pages: list[BrowserPage], spin_until: Callable[..., bool]) -> None:
        self.robot, self.pages, self._spin_until = robot, pages, spin_until
        collect = robot.client.collect
        self.commands = collect(Float64MultiArray, "position_controller/commands", 500)
        self.goals = collect(PoseStamped, "effector_goal", 500)
        self.poses = collect(PoseStamped, "effector_pose", 5)
        self._events = collect(ParameterEvent, "/parameter_events", 500)
        self._others = [collect(WrenchStamped, "external_wrench", 50), collect(String, "keys", 50)]
        self.sent: list[tuple[float, ...]] = []
        self._random = np.random.default_rng(5)

    def command(self) -> None:
        """Another program moves the joints; the many digits of its values are not those of a slider."""
        values = (-1.2 + 0.2 * self._random.uniform(-1.0, 1.0, 3)).tolist()
        self.sent.append(tuple(values))
        self.robot.command(values)
        self.pause(100)

    def pause(self, milliseconds: float = SETTLE_MS) -> None:
        self.pages[0].page.wait_for_timeout(milliseconds)

    def browse(self) -> None:
        """Every tab of every page, while commands go on."""
        for name in TABS:
            for page in self.pages:
                page.tab(name)
                self.command()

    def tuned(self) -> list[tuple[str, float]]:
        """Parameters of the simulator that were changed, with their values."""
        events = [event for event in self._events if event.node == "/tripod/simulator"]
        return [(p.name, p.value.double_value) for event in events for p in event.changed_parameters]

    def until(self, condition: Callable[[], Any]) -> bool:
        return self._spin_until(condition)

    def assert_silence(self, *tuned: tuple[str, float]) -> None:
        """Nothing but what the other program has sent, and parameters that it has set."""
        assert self.until(lambda: len(self.commands) >= len(self.sent))
        self.pause()
        assert [tuple(command.data) for command in self.commands] == self.sent
        assert self.tuned() == list(tuned)
        assert [*map(len, self._others)] == [0, 0]


@pytest.fixture(scope="module")
def pages(station: tuple[Any, str], browser: Any) -> Iterator[list[BrowserPage]]:
    found = [BrowserPage(browser, station[1]) for _ in range(2)]
    for page in found:
        page.wait_for_node(BODY)
    yield found
    for page in found:
        page.close()


@pytest.fixture
def witness(station: tuple[Any, str], pages: list[BrowserPage], spin_until: Callable[..., bool]) -> Witness:
    return Witness(station[0], pages, spin_until)


def test_a_page_lets_the_start_animation_and_other_programs_drive(witness: Witness) -> None:
    first, second = witness.pages
    assert witness.robot.trigger("start")[0]
    for name in TABS:
        first.tab(name)
        second.tab(name)
    witness.pause()
    witness.assert_silence()
    witness.browse()
    first.tab("Drive")
    second.tab("Drive")
    first.number("servo_1").focus()  # a number that changes while it is being looked at
    second.page.get_by_role("slider").first.focus()
    witness.command()
    witness.pause()
    first.number("servo_1").blur()
    witness.command()
    second.page.get_by_role("slider").first.blur()
    assert witness.robot.trigger("start")[0]
    witness.pause()
    first.page.reload()
    first.wait_for_node(BODY)
    witness.browse()
    assert witness.goals == []
    witness.assert_silence()


def test_a_page_lets_other_programs_tune_and_load(witness: Witness) -> None:
    first, second = witness.pages
    first.tab("Tune")
    second.tab("Tune")
    robot, label = witness.robot, "Young modulus of silicone [kPa]"
    young = robot.get_parameter("young_modulus")
    tuned = [("young_modulus", 123456.7), ("speed", 0.9001), ("speed", 1.0), ("young_modulus", young)]
    for name, value in tuned:
        first.number(label).focus()
        assert robot.set_parameters(**{name: value}) == (True, "")
        witness.pause()
        first.number(label).blur()
    shown = second.number(label)
    assert witness.until(lambda: float(shown.input_value()) == pytest.approx(young / 1e3))
    assert robot.trigger("reload")[0]
    first.wait_for_node(BODY)
    witness.browse()
    assert witness.goals == []
    witness.assert_silence(*tuned)


def test_a_page_lets_other_programs_give_goals(witness: Witness) -> None:
    client = witness.robot.client
    assert client.call(SetBool, "inverse_controller/enable", SetBool.Request(data=True)).success
    try:
        for page in witness.pages:
            page.wait_for_node("/goal/ball")
        assert witness.until(lambda: witness.poses)
        given = witness.poses[-1]
        heights = [given.pose.position.z + 1e-4 * step for step in range(5)]
        for height in heights:
            given.pose.position.z = height
            client.publish("effector_goal", given)
            witness.pause(300)
        assert witness.until(lambda: len(witness.goals) >= len(heights))
        for name in TABS:
            for page in witness.pages:
                page.tab(name)
        witness.pause()
        assert [goal.pose.position.z for goal in witness.goals] == heights
    finally:
        assert client.call(SetBool, "inverse_controller/enable", SetBool.Request(data=False)).success
