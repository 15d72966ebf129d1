"""Protocols of boards: the extension point for a board of one's own.

Derive a class from `BoardProtocol` and `register` it in the robot's Python file; name it in the robot's board
settings (`BoardDescription(protocol=...)`) or in the bridge's parameter `protocol`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
