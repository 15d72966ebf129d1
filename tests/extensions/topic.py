"""The topic of topic.patch: a running simulator publishes it to whoever subscribes."""

from __future__ import annotations

import contextlib
import queue

from std_msgs.msg import Float64

from softsim_core.scene import load_scene
from softsim_node import GuardedNode, ros_process
from softsim_ros import SpinThread
from softsim_ros.nodes.simulator import Simulator

heard: queue.SimpleQueue[Float64] = queue.SimpleQueue()
with ros_process(), contextlib.ExitStack() as stack:
    simulator = Simulator(load_scene("cable_finger"))
    stack.callback(simulator.close)
    listener = GuardedNode("listener", namespace=simulator.get_namespace())
    stack.callback(listener.close)
    listener.create_subscription(Float64, "mesh/lowest", heard.put, 1)
    stack.enter_context(SpinThread([simulator]))
    stack.enter_context(SpinThread([listener]))
    lowest = heard.get(timeout=100.0).data
assert -0.02 < lowest < 0.01, lowest
print("works")
