"""Measure the speed of a simulation step; `softsim bench` runs these functions. Nothing here prints."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
