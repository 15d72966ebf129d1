"""Commands that start a robot, or one node of it: `up`, `run`."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
