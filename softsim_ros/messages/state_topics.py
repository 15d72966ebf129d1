"""The latched topics by which the suite's nodes say their state: names below the namespace, and types.

Common messages carry them, so that a graph may mix apt's ROS 2 with the PyPI wheels; see docs/interfaces.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from geometry_msgs.msg import Vector3
from lifecycle_msgs.msg import State
from std_msgs.msg import Bool, String

STATE_TOPICS: Final[Mapping[str, type]] = {
    "simulator/paused": Bool,
    "simulator/faulted": Bool,
    "servo_bridge/state": State,
    "servo_bridge/connected": Bool,
    "servo_bridge/sending": Bool,
    "servo_bridge/e_stop_latched": Bool,
    "servo_bridge/commanded_by": String,
    "inverse_controller/enabled": Bool,
    "path_follower/enabled": Bool,
    "path_follower/playing": Bool,
    "path_follower/paused": Bool,
    "path_follower/file": String,
    "closed_loop/enabled": Bool,
    "closed_loop/reference": Vector3,
    "policy/enabled": Bool,
    "observer/touched": Bool,
    "observer/verdict": String,
    "recorder/enabled": Bool,
    "replay/paused": Bool,
}
"""Message class by topic; each has one publisher, the node in its name."""
