"""Many copies of a scene at once: one model and one plan; each has its state, commands and parameters."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
