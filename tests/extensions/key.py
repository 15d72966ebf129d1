"""The action of key.patch: a robot's file binds it to a key, and a press carries it out."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from softsim_core.scene import load_scene
from softsim_node import GuardedNode, ros_process
from softsim_ros import SpinThread
from softsim_ros.client import RobotClient, RobotSession
from softsim_ros.keys import Keyboard, KeyPress
from softsim_ros.nodes.simulator import Simulator

FINGER = Path("configs", "scenes", "cable_finger.yaml").resolve()

with TemporaryDirectory() as folder:
    file = Path(folder, "stepped.yaml")
    file.write_text(f"extends: {FINGER}\nname: stepped\nkeys: {{n: {{action: step, help: one step}}}}\n")
    scene = load_scene(file)
messages: list[str] = []
with ros_process(), contextlib.ExitStack() as stack:
    simulator = Simulator(scene)
    stack.callback(simulator.close)
    node = GuardedNode("keys", namespace=simulator.get_namespace())
    stack.callback(node.close)
    client = RobotClient(node, scene)
    keyboard = Keyboard(node, client, messages.append)
    stack.enter_context(SpinThread([simulator]))
    robot = RobotSession(client, stack.enter_context(SpinThread([node])))
    robot.wait_until(lambda state: state.measured is not None, 100.0)
    robot.do(client.simulator.pause, True)
    before = simulator.physics.status.steps
    keyboard.press(KeyPress("n"), time.monotonic())
    robot.wait_until(lambda _: simulator.physics.status.steps > before, 100.0, "a step")
    assert simulator.physics.status.steps == before + 1
assert messages[0].startswith("n: step"), messages
print("works")
