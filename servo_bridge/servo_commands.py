"""Commands as a robot's joints have them, checked and put into the order of the servos. No I/O."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from servo_bridge.wording import named
from softsim_core.errors import CommandError
from softsim_core.mechanics.limits import check_command
from softsim_core.mechanics.named_command import check_named_command


class ServoCommands:
    """The joints of a robot and those among them that servos turn.

    Args:
        joint_names: The robot's joints, in the order of commands without names.
        servo_joints: Joint of each servo, in packet order.
    """

    def __init__(self, joint_names: Sequence[str], servo_joints: Sequence[str]) -> None:
        self._joint_names, self._servo_joints = tuple(joint_names), tuple(servo_joints)
        self._order = [self._joint_names.index(name) for name in self._servo_joints]

    def of_all(self, values: Sequence[float]) -> list[float]:
        """Angles of the servos from one position per joint of the robot, in [rad].

        Raises:
            CommandError: wrong length or a value that is not finite.
        """
        checked = check_command(values, self._joint_names)
        return [checked[index] for index in self._order]

    def of_names(self, positions: Mapping[str, float]) -> list[float]:
        """Angles of the servos from positions in [rad] by joint name; names without a servo are ignored.

        Raises:
            CommandError: a servo's joint is missing.
        """
        missing = [name for name in self._servo_joints if name not in positions]
        if missing:
            raise CommandError(
                f"joint states without {named(missing)} refused; they name {named(positions)};"
                " nothing was moved"
            )
        return [positions[name] for name in self._servo_joints]

    def of_some(self, names: Sequence[str], positions: Sequence[float]) -> Mapping[str, float]:
        """Angles by joint of the servos that are named, in [rad]; a NaN stands for no command.

        Raises:
            CommandError: unknown or repeated names, another number of positions, or an infinite one.
        """
        command = check_named_command(names, positions, self._joint_names)
        return {name: command[name] for name in self._servo_joints if name in command}
