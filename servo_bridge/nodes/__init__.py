"""The ROS nodes of the bridge and of boards without hardware."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
