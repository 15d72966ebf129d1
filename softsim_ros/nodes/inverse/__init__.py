"""Inverse control as ROS nodes: goals of the effector are the input, joint commands the output."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
