"""Kernels compiled by Numba: the compiler, the process that compiles, and the cache."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
