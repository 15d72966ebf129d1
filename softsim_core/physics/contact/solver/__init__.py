"""Forces of contacts with Coulomb friction and of bounded rows: Gauss-Seidel, Newton, smoothed projection."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
