"""Contact between surfaces: which pairs may meet, where they are close, and the forces between them."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
