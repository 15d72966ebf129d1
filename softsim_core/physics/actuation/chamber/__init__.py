"""Chambers: cavities of a body, filled with air or water, commanded by pressure or by volume."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
