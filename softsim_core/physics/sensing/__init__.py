"""Sensing: the sensors of a scene, each with its own sample rate, noise and seed."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
