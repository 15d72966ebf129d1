"""Sensing: what the sensors of a scene measure, each at its own rate, with noise from a seed of its own."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
