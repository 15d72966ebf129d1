"""Conversions from NumPy arrays and plain numbers to ROS messages; array fields are filled from buffers."""

from softsim_ros.messages.base_targets import base_target, read_base_target
from softsim_ros.messages.buffers import message_array
from softsim_ros.messages.colours import stress_colours
from softsim_ros.messages.diagnostics import diagnostic_array, diagnostic_values
from softsim_ros.messages.marker import MarkerTemplate
from softsim_ros.messages.meshes import mesh_checksum, point_cloud, read_point_cloud, topology
from softsim_ros.messages.moving_markers import MovingMarkers
from softsim_ros.messages.profiles import read_step_profile, step_profile
from softsim_ros.messages.states import (
    clock,
    fluid_pressure,
    header,
    joint_state,
    pose,
    pose_stamped,
    time_message,
    transform_stamped,
)

__all__ = [
    "MarkerTemplate",
    "MovingMarkers",
    "base_target",
    "clock",
    "diagnostic_array",
    "diagnostic_values",
    "fluid_pressure",
    "header",
    "joint_state",
    "mesh_checksum",
    "message_array",
    "point_cloud",
    "pose",
    "pose_stamped",
    "read_base_target",
    "read_point_cloud",
    "read_step_profile",
    "step_profile",
    "stress_colours",
    "time_message",
    "topology",
    "transform_stamped",
]
