"""The tab of tab.patch: the page has it, and it shows the time of the robot."""

from __future__ import annotations

import contextlib
import socket

from softsim_core.scene import load_scene
from softsim_node import ros_process
from softsim_ros.nodes.viewer import ViewerSettings, viewer_node

with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
with ros_process(), contextlib.ExitStack() as stack:
    viewer = viewer_node.Viewer(load_scene("cable_finger"), ViewerSettings(port=port))
    stack.callback(viewer.close)
    viewer.frame(1.0)
    (tab,) = (each for each in viewer.controls._tabs if type(each).__name__ == "ClockTab")
    shown = tab._time._handle.content
assert "no time yet" in shown, shown
print("works")
