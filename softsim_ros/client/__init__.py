"""Clients of a robot's topics and services, without any user interface.

`robot_client.RobotClient` composes one client for each peer: joints, simulator, bridge, inverse control,
closed loop. The terminal, the page, demos and users' scripts each use one; `robot_client.connect` gives a
script one that it can wait with. `state` is pure.
"""

from lazy_loader import attach_stub

from softsim_core.base import find_former_names

_find, __dir__, __all__ = attach_stub(__name__, __file__)
__getattr__ = find_former_names(
    __name__,
    {"held_positions": "stationary_commands", "with_heard_command": "with_received_command"},
    _find,
)
