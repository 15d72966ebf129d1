"""The web viewer: shows a robot's topics in a page and sends its goals, pulls and buttons over ROS."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
