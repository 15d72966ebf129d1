"""A model that runs beside a robot, corrected by sensors: shape, contact, and whether it is right."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
