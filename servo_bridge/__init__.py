"""From joint angles to the serial board of a servo robot, and never beyond its limits."""

# The first import of the suite: softsim_core takes the current folder off the import path.
from softsim_core.base.moved import keep_former_names

keep_former_names(
    {
        "servo_bridge.calibration_file": "servo_bridge.driver.calibration",
        "servo_bridge.servo": "servo_bridge.driver.servo",
        "servo_bridge.virtual_board": "servo_bridge.emulator.virtual_board",
    }
)
