"""Finite elements: their definition and a registry; add your own with `register_element`."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
