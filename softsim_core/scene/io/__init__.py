"""Scene files: YAML and Python scenes, their keys, where they are found, and their forms as text."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
