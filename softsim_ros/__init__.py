"""ROS 2 nodes of the project and the `softsim` command line."""

# The first import of the suite: softsim_core takes the current folder off the import path.
from softsim_core.base import keep_former_names  # isort: skip

from lazy_loader import attach_stub

keep_former_names(
    {
        "softsim_ros.client.session": "softsim_ros.client.robot_client",
        "softsim_ros.messages.contacts": "softsim_ros.messages.sensors",
        "softsim_ros.state_listener": "softsim_ros.listeners",
    }
)

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
