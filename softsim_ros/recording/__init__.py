"""Record topics to rosbag2 files (MCAP), and turn them into replays, exports and reports."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
