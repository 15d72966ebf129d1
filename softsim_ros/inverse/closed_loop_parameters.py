"""The closed loop's parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from softsim_core.inverse.closed_loop import TiltGains
from softsim_node.parameters import parameter
from softsim_ros.inverse.path_follower_parameters import LEAVE
from softsim_ros.robot_node import RobotSettings

MEASURES: Final = ("imu", "effector_pose")
TASKS: Final = ("height_tilt", "orientation", "pose", LEAVE)
"""Tasks of the inverse controller that turn the plate."""

_LAW: Final = TiltGains()


@dataclass(frozen=True, kw_only=True)
class LoopSettings(RobotSettings):
    """Values of the parameters; `height` begins above the robot's effector at rest."""

    kp: float = parameter(_LAW.proportional, "Proportional gain", within=(0.0, 100.0))
    ki: float = parameter(_LAW.integral, "Integral gain", unit="1/s", within=(0.0, 1000.0))
    anti_windup: float = parameter(_LAW.anti_windup, "Anti-windup gain", unit="1/s", within=(0.0, 1000.0))
    saturation: float = parameter(_LAW.saturation, "Largest tilt of the goal", unit="rad", within=(1e-3, 1.5))
    height: float = parameter(0.0, "Height of the goal", unit="m", within=(-10.0, 10.0))
    rate: float = parameter(50.0, "Steps per second", unit="Hz", within=(1.0, 1000.0), fixed=True)
    measure_timeout: float = parameter(
        0.5, "An older measure holds the command", unit="s", within=(0.01, 60.0)
    )
    measure: str = parameter(MEASURES[0], "Topic of the measured orientation", choices=MEASURES, fixed=True)
    task: str = parameter(
        TASKS[0], "What the inverse controller follows from the start on", choices=TASKS, fixed=True
    )
    log_file: str = parameter(
        "", "File for a row of comma separated values per step; empty: none", fixed=True
    )
    enabled: bool = parameter(False, "Switch the loop on at the start", fixed=True)

    @property
    def gains(self) -> TiltGains:
        """Gains of the control law.

        Raises:
            SoftSimError: they do not fit together.
        """
        return TiltGains(
            proportional=self.kp,
            integral=self.ki,
            anti_windup=self.anti_windup,
            saturation=self.saturation,
        )
