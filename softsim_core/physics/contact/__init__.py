"""Contact between surfaces: which may meet, where they come close, and the forces between them."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
