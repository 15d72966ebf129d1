"""The executables of this package, which import their nodes once signals are handled; see `run_module`."""

from __future__ import annotations

from functools import partial

from softsim_node import run_module

simulator = partial(run_module, "softsim_ros.nodes.simulator.simulator_node")
teleop = partial(run_module, "softsim_ros.nodes.teleop.teleop_node")
inverse_controller = partial(run_module, "softsim_ros.nodes.inverse.inverse_node")
path_follower = partial(run_module, "softsim_ros.nodes.inverse.path_follower_node")
closed_loop = partial(run_module, "softsim_ros.nodes.inverse.closed_loop_node")
observer = partial(run_module, "softsim_ros.nodes.observer.observer_node")
policy = partial(run_module, "softsim_ros.nodes.policy.policy_node")
recorder = partial(run_module, "softsim_ros.recording.recorder_node")
viewer = partial(run_module, "softsim_ros.nodes.viewer.viewer_node")
