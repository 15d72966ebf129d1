"""Inverse control: effector goals to joint commands, effector paths, the closed loop on tilts."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
