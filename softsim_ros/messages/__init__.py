"""Conversions from NumPy arrays and plain numbers to ROS messages; array fields are filled from buffers."""

from softsim_ros.messages.markers import MarkerTemplate, MovingMarkers
from softsim_ros.messages.meshes import mesh_checksum, point_cloud, read_point_cloud, stress_colours, topology
from softsim_ros.messages.sensors import read_step_profile, step_profile
from softsim_ros.messages.states import (
    base_target,
    clock,
    fluid_pressure,
    header,
    joint_state,
    message_array,
    pose,
    pose_stamped,
    read_base_target,
    time_message,
    transform_stamped,
)
from softsim_ros.messages.types import diagnostic_array, diagnostic_values

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
