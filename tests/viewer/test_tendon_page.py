"""Tendons on the page have the colours of their tensions, with a scale: a real page, without a robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import NODES, BrowserPage
from builtin_interfaces.msg import Time
from tcp_ports import free_port

from softsim_core import Simulation, load_scene
from softsim_ros.messages import tension_cloud
from softsim_ros.nodes.simulator import cable_markers
from softsim_ros.nodes.viewer import (
    GAMMA,
    SLACK_COLOUR,
    TENSION_COLOURS,
    AccessRule,
    GuardedServer,
    Inbox,
    Picture,
    ViewTab,
    round_up,
)

pytestmark = [pytest.mark.ros, pytest.mark.slow]

LINE_COLOURS = f"""(name) => {{
    const found = [];
    const node = {NODES}[name];
    if (node) node.traverse(part => {{
        const colours = part.geometry?.attributes.instanceColorStart;
        for (let k = 0; colours && k < colours.count; k++)
            found.push(colours.getX(k), colours.getY(k), colours.getZ(k));
    }});
    return found;
}}"""
"""Linear red, green, blue in 0..1 of each segment of a line, one after the other."""


class Served:
    """A page of the tendon arm whose messages come from a simulation in this process."""

    def __init__(self) -> None:
        robot = load_scene("tendon_arm")
        self.simulation = Simulation(robot, backend="scipy")
        self.server = GuardedServer(AccessRule("127.0.0.1", free_port(), None), robot.name)
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        node, self.inbox = MagicMock(), Inbox()
        node.create_subscription = lambda _, topic, callback, qos: self.callbacks.update({topic: callback})
        self.picture = Picture(
            node, self.server, self.inbox, MagicMock(), MagicMock(), MagicMock(), lite=True
        )
        self.picture.build(robot)
        self.tab = ViewTab(self.server.gui, self.inbox, self.picture, MagicMock(stiffness=30.0))

    def publish(self) -> None:
        """Obey the page, and show it the state."""
        for action in self.inbox.take():
            action()
        simulation = self.simulation
        cloud = tension_cloud(Time(), "world", simulation.actuators, simulation.joint_names)
        self.callbacks["cables/tensions"](cloud)
        self.picture.draw(0.0)
        self.callbacks["cables"](cable_markers(simulation, Time()))
        self.tab.refresh()


@pytest.fixture
def served() -> Iterator[Served]:
    served = Served()
    yield served
    served.server.stop()


def test_pulled_and_slack_tendons_differ_in_colour(
    served: Served, browser: Any, spin_until: Callable[..., bool]
) -> None:
    simulation, page = served.simulation, BrowserPage(browser, served.server.rule.address)
    simulation.settle([0.008, -0.012, *(0.0,) * 7])
    pulled, slack = (simulation.actuators[k].tensions for k in (0, 1))
    assert pulled.min() > 5.0
    assert slack.max() == 0.0

    def has(tendon: int, *colours: tuple[int, int, int]) -> bool:
        """Whether all segments of a tendon are drawn in one of some colours."""
        served.publish()
        found = np.array(page.page.evaluate(LINE_COLOURS, f"/cables/line_{tendon}")).reshape(-1, 3)
        linear = (np.array(colours) / 255.0) ** GAMMA
        return len(found) > 0 and bool((np.abs(found - linear[:, None]).max(axis=(1, 2)) < 0.01).any())

    served.publish()
    page.wait_for_node("/cables/line_0")
    assert spin_until(lambda: has(0, *TENSION_COLOURS))
    assert spin_until(lambda: has(1, SLACK_COLOUR))
    top = round_up(max(each.tension for each in simulation.actuators))
    page.page.get_by_text(f"{top:g} N", exact=True).wait_for(state="visible")
    page.tick("Tension colours")
    assert spin_until(lambda: has(0, (26, 26, 26)))
    page.page.get_by_text("cable tension").wait_for(state="hidden")
    assert page.errors == []
    page.close()
