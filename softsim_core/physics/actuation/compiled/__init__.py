"""Compiled kernels of actuators: the step evaluates their kinds in its own compiled call."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
