"""What every ROS process of the suite shares: its environment, its parameters, its start and its end."""

from softsim_core.base import keep_former_names  # isort: skip

from lazy_loader import attach_stub

keep_former_names(
    {
        "softsim_node.spinning": "softsim_node.process",
    }
)

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
