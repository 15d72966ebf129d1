"""Packages that only some people need: which extra of the distribution brings the one that is missing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from softsim_core.extras import install_command

_ROS: Final = (
    "rclpy", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "lifecycle_msgs",
    "nav_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "shape_msgs", "std_msgs",
    "std_srvs", "trajectory_msgs", "visualization_msgs",
)  # fmt: skip

BROUGHT_BY: Final[Mapping[str, str]] = {
    **dict.fromkeys(_ROS, "ros"),
    **dict.fromkeys(("viser", "websockets", "imageio", "PIL", "cmap", "msgspec"), "viewer"),
    **dict.fromkeys(("rosbags", "lz4"), "recording"),
    "matplotlib": "report",
    "c3d": "c3d",
    **dict.fromkeys(("pytetwild", "fast_simplification"), "mesh"),
    "urdf_parser_py": "arm",
    "argcomplete": "completion",
    "mujoco": "mujoco",
    "gymnasium": "learn",
    "onnxruntime": "policy",
    **dict.fromkeys(("onnx", "stable_baselines3"), "train"),
    **dict.fromkeys(
        ("dask", "distributed", "bokeh", "cryptography", "zarr", "xarray", "pyarrow", "cma"), "study"
    ),
    "pydrake": "peers",
    "pytest": "test",
}
"""The extra that brings a module, by the module's first name."""

_WHERE: Final = {
    "ros": ", which exists for x86-64 Linux; elsewhere take a ROS 2 Jazzy of the system",
    "study": ", Python 3.11 or newer",
}


def what_is_missing(error: ImportError) -> str | None:
    """Return which package is missing and how to install it, or None where no extra brings it."""
    module = (error.name or "").partition(".")[0]
    extra = BROUGHT_BY.get(module)
    if extra is None:
        return None
    package = f"ROS 2 ({module})" if extra == "ros" else module
    return f"{package} is not installed; {install_command(extra)}{_WHERE.get(extra, '')}"
