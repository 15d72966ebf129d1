"""Measurements of `softsim bench`: steps, bridge, page, start, copies. They are not installed."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
