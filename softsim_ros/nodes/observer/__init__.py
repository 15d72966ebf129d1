"""The observer node: estimates shape and contacts of a robot from its sensors."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
