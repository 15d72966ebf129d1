"""The servo board without hardware: the real firmware in an emulated ATmega328P."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
