"""What the parameters `robot` and `calibration` name: read, or refused in a sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from servo_bridge.wording import shortened
from softsim_core.errors import ConfigError, SoftSimError
from softsim_core.scene.robot import RobotDescription

Loaded = TypeVar("Loaded")


def load_robot(name: str) -> RobotDescription:
    """The robot of a name or file.

    Raises:
        SoftSimError: it cannot be read.
    """
    from softsim_core.scene import load_scene  # costs imports: only when needed

    return read_named("robot", name, lambda: load_scene(name))


def read_named(parameter: str, value: str, read: Callable[[], Loaded]) -> Loaded:
    """What `read` gives; anything that the value makes it raise becomes a sentence about the parameter."""
    try:
        return read()
    except SoftSimError:
        raise
    except Exception as error:  # a user of that name, a name too long, nesting too deep, a robot's own code
        raise ConfigError(
            "servo_bridge",
            f"parameter {parameter}",
            f"{shortened(value)!r} cannot be read ({type(error).__name__}: {shortened(str(error), 100)});"
            " give a name or a readable file",
        ) from error
