"""Studies: many runs of one scene with values that vary, on the cores of a machine or a cluster."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
