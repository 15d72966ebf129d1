"""From joint angles to the serial board of a servo robot, and never beyond its limits."""

# The first import of the suite: softsim_core takes the current folder off the import path.
from softsim_core.base import keep_former_names  # isort: skip

from lazy_loader import attach_stub

keep_former_names(
    {
        "servo_bridge.calibration_file": "servo_bridge.driver.calibration",
        "servo_bridge.servo": "servo_bridge.driver.servo",
        "servo_bridge.virtual_board": "servo_bridge.emulator.virtual_board",
    }
)

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
