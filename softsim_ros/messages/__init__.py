"""Convert NumPy arrays and plain numbers to ROS messages; array fields are filled from buffers."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
