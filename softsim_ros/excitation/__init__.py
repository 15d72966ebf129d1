"""Measure a robot through its topics: record its sensors while it moves, as a data set."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
