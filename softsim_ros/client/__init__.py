"""Clients of a robot's topics and services, without any user interface.

`robot_client.RobotClient` composes one client for each peer: joints, simulator, bridge, inverse control,
closed loop. The terminal, the page, demos and users' scripts each use one; `robot_client.connect` gives a
script one that it can wait with. `state` is pure.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
