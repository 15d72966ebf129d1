"""A model and measurements: described data sets, replay of their commands, alignment of sensors, errors."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
