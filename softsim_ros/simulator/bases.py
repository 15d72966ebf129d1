"""Moving a joint's base by hand, from `base_target`."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from sensor_msgs.msg import MultiDOFJointState

from softsim_core.errors import CommandError, SoftSimError
from softsim_ros.messages import read_base_target
from softsim_ros.simulator.physics_thread import PhysicsThread


class BaseTargets:
    """Subscribes to `base_target`: where in `world` the base of a joint goes, see messages.base_target.

    Args:
        node: Owner of the subscription.
        physics: The thread that owns the simulation.
        warn: Told the sentence of a refused message.
    """

    def __init__(self, node: Node, physics: PhysicsThread, warn: Callable[[str], None]) -> None:
        self._physics, self._warn = physics, warn
        node.create_subscription(MultiDOFJointState, "base_target", self._on_target, 1)

    def _on_target(self, message: MultiDOFJointState) -> None:
        try:
            joint, position = read_base_target(message)
            self._physics.call(lambda simulation: simulation.move_base(joint, position), shows=False)
        except CommandError as error:
            self._warn(str(error))
        except SoftSimError:  # the physics has ended
            return
