"""The simulator: the thread that runs the physics, and the ROS node around it."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
