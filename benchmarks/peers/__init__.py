"""Other engines that simulate the clamped body; the optional extra `peers` installs them."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
