"""Descriptions of a robot for ROS: its tree of links and joints, URDF, layouts and configuration files."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
