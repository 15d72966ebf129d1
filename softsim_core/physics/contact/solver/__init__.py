"""Contact solver: Coulomb friction and bounded rows by Gauss-Seidel, Newton and smoothed projection."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
