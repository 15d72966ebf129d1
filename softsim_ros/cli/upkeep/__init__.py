"""Commands about this machine and this project: `doctor`, `bench`, `test`."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
