"""Compiled cells: their forces and stiffness in vector code, by element and law."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
