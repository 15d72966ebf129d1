"""ROS 2 nodes of the suite and the `softsim` command line."""

# The first import of the suite: softsim_core takes the current folder off the import path.
from softsim_core.base.moved import keep_former_names

keep_former_names(
    {
        "softsim_ros.client.session": "softsim_ros.client.robot_client",
        "softsim_ros.messages.contacts": "softsim_ros.messages.sensors",
        "softsim_ros.state_listener": "softsim_ros.listeners",
    }
)
