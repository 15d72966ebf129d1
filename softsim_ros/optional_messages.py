"""Message packages that not every installation of ROS 2 has; this module checks which are installed.

They come with apt's ROS 2; PyPI has none of them.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any, Final

OPTIONAL: Final = {
    "tf2_msgs": "transforms on /tf",
    "control_msgs": "the action follow_joint_trajectory of the simulator",
    "simulation_interfaces": "the standard services of the simulator",
}
"""Features that the project offers if a package is installed."""


def optional_module(name: str) -> ModuleType | None:
    """Return a module such as "tf2_msgs.msg" of one of OPTIONAL; None if the package is not installed.

    Raises:
        ImportError: the package is installed, but broken.
    """
    package = name.partition(".")[0]
    if package not in OPTIONAL:
        raise ValueError(f"{package} is none of {', '.join(OPTIONAL)}")
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        return None


def optional_type(module: str, name: str) -> Any | None:
    """Return a message, service or action of an optional package, such as ("tf2_msgs.msg", "TFMessage").

    Return None if the package is not installed, or its release does not have it.
    """
    found = optional_module(module)
    return None if found is None else getattr(found, name, None)
