"""A model's robot is told from another one by what a model is made of."""

from __future__ import annotations

import json
from typing import Any

import pytest

pytest.importorskip("rclpy")

from std_msgs.msg import String

from softsim_core.scene import load_scene
from softsim_core.scene.io import write_description
from softsim_ros.nodes.inverse import SimulatedRobot


class Heard:
    """A simulated robot that hears what it is told here."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.refused: list[str] = []
        self._generation = 0
        SimulatedRobot(self, self.said.append, self.refused.append)  # type: ignore[arg-type]

    def create_subscription(self, _type: Any, topic: str, callback: Any, _qos: Any) -> None:
        assert topic == "scene/structure"
        self._callback = callback

    def hear(self, name: str) -> None:
        robot = load_scene(name)
        self._generation += 1
        empty: dict[str, Any] = {key: [] for key in ("frames", "bodies", "regions", "scenes")}
        places = {"": [str(robot.source), 1]}
        told = {"generation": self._generation, "description": write_description(robot), "overrides": ""}
        self._callback(String(data=json.dumps({**told, **empty, "places": places})))


@pytest.fixture
def heard() -> Heard:
    return Heard()


@pytest.mark.parametrize("other", ["tripod_mid", "tripod_quadratic", "pneu_finger", "tripod_step_1"])
def test_another_robot_is_said_once_and_so_is_its_way_back(heard: Heard, other: str) -> None:
    for name in ("tripod", "tripod", other, other):
        heard.hear(name)
    assert len(heard.said) == 1
    assert f"another robot now ({other})" in heard.said[0]
    heard.hear("tripod")
    assert heard.said[1:] == [""]


def test_what_it_touches_and_what_was_heard_of_first_change_nothing(heard: Heard) -> None:
    heard.hear("tripod_mid")  # beside a model of the low one
    heard.hear("tripod_mid")
    assert heard.said == []
    beside = Heard()
    beside.hear("tripod")
    beside.hear("tripod_maze")  # the same robot below a plate and a ball
    assert beside.said == []


def test_a_message_of_something_else_is_refused_and_changes_nothing(heard: Heard) -> None:
    heard.hear("tripod")
    heard._callback(String(data="{}"))
    assert len(heard.refused) == 1
    assert heard.said == []
