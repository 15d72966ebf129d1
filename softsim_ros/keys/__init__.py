"""Keys of all user interfaces: their names, a robot's table of them, and the rules of a press."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
