"""Commands for robots and parts: `scenes`, `new`, `mesh`, `material`, `mjcf`, `urdf`, `workspace`."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
