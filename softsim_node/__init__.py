"""What every ROS process of the suite shares: its environment, its parameters, its start and its end."""

from softsim_core.base.moved import keep_former_names

keep_former_names(
    {
        "softsim_node.spinning": "softsim_node.process",
    }
)
