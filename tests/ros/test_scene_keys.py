"""Keys reach the functions that a Python scene has hung on them, from the teleop and from any other node."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from terminal_session import TerminalSession

pytest.importorskip("rclpy")

from rcl_interfaces.msg import Log
from sensor_msgs.msg import JointState
from std_msgs.msg import String

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SCENE = """
from softsim_core.robots import servo

def create_scene(scene):
    scene.name = "tripod"
    scene.add(servo("wheel"))

    @scene.on_key
    def turn(simulation, key):
        simulation.command([{"u": 0.3, "n": -0.3}[key]])
        print(f"{key} was pressed")
"""


def pressed(robot: Any, press: Callable[[], None], words: str) -> bool:
    """Press until the scene has said so: a simulator that has just been found may miss the first one."""
    for _ in range(60):
        press()
        if robot.process.says(words, 2.0):
            return True
    return False


def test_keys_call_the_scene_and_a_failing_function_is_one_warning(
    start_robot: Any, spin_until: Callable[..., bool], tmp_path: Path
) -> None:
    file = tmp_path / "own.py"
    file.write_text(SCENE)
    robot = start_robot(robot=str(file))
    states = robot.client.collect(JointState, "joint_states", 5)
    logged = robot.client.collect(Log, "/rosout", 100)
    assert pressed(robot, lambda: robot.client.publish("keys", String(data="u")), "u was pressed")
    assert spin_until(lambda: [m for m in logged if m.msg == "u was pressed"])
    assert {m.name for m in logged if m.msg == "u was pressed"} == {"tripod.simulator.scene"}
    assert spin_until(lambda: states and abs(states[-1].position[0] - 0.3) < 1e-9)
    robot.client.publish("keys", String(data="k"))
    assert robot.warns("controller failed: KeyError: 'k'")
    with TerminalSession(
        [sys.executable, "-m", "softsim_ros.nodes.teleop.teleop_node", "--ros-args", "-p", f"robot:={file}"]
    ) as session:
        session.wait_for("simulator: running at")
        assert pressed(robot, lambda: session.type(b"n"), "n was pressed")
        session.wait_for("scene: n was pressed")
        assert spin_until(lambda: abs(states[-1].position[0] + 0.3) < 1e-9)
        session.type(b"x")
        assert session.wait() == 0
